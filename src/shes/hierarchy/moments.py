"""Sums over the observations of episodes, for the observation statistics."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from shes.types import F64Array, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """Sums over the observations of each of K episodes at one level. The arrays change in place."""

    count: IntArray
    """Number of observations [K]."""
    total: F64Array
    """Their sum [K, O]."""
    total_squares: F64Array
    """Sum of their squares [K, O]."""

    @classmethod
    def zeros(cls, num_episodes: int, size: int, xp: ModuleType = np) -> Moments:
        """Return sums over no observations of `size` values, as arrays of `xp`."""
        return cls(
            count=xp.zeros(num_episodes, dtype=np.int64),
            total=xp.zeros((num_episodes, size)),
            total_squares=xp.zeros((num_episodes, size)),
        )

    def add(self, rows: slice | IntArray, observation: F64Array) -> None:
        """Add one observation [rows, O] to each of `rows`."""
        self.count[rows] += 1
        self.total[rows] += observation
        self.total_squares[rows] += observation * observation

    def clear(self, rows: slice | IntArray) -> None:
        """Reset the sums of `rows`."""
        for sums in (self.count, self.total, self.total_squares):
            sums[rows] = 0
