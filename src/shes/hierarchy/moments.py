"""Sums over the observations of episodes, for the observation statistics."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from shes.types import F64Array, IntArray

__all__ = ["Moments"]


class Moments:
    """Count, sum and sum of squares of the observations of each of N episodes at one level."""

    def __init__(self, num_episodes: int, size: int, xp: ModuleType = np) -> None:
        """Allocate sums of `size` values for `num_episodes` episodes, as arrays of `xp`."""
        self.count: IntArray = xp.zeros(num_episodes, dtype=np.int64)
        self.total: F64Array = xp.zeros((num_episodes, size))
        self.total_squares: F64Array = xp.zeros((num_episodes, size))

    def add(self, rows: slice | IntArray, observation: F64Array) -> None:
        """Add one observation [rows, O] to each of `rows`."""
        self.count[rows] += 1
        self.total[rows] += observation
        self.total_squares[rows] += observation * observation

    def clear(self, rows: slice | IntArray) -> None:
        """Reset the sums of `rows`."""
        for sums in (self.count, self.total, self.total_squares):
            sums[rows] = 0
