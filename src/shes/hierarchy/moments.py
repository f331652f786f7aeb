"""What episodes observe, summed: for the observation statistics."""

from __future__ import annotations

from types import ModuleType

import numpy as np

from shes.types import F64Array, IntArray

__all__ = ["Moments"]


class Moments:
    """Sums of what each of N episodes observed at one level, for `ObservationStatistics`."""

    def __init__(self, num_episodes: int, size: int, xp: ModuleType = np) -> None:
        """Hold sums of `size` values for `num_episodes` episodes, in arrays of `xp`."""
        self.count: IntArray = xp.zeros(num_episodes, dtype=np.int64)
        self.total: F64Array = xp.zeros((num_episodes, size))
        self.total_squares: F64Array = xp.zeros((num_episodes, size))

    def add(self, rows: slice | IntArray, observation: F64Array) -> None:
        """Add one observation [rows, O] to each of `rows`."""
        self.count[rows] += 1
        self.total[rows] += observation
        self.total_squares[rows] += observation * observation

    def clear(self, rows: slice | IntArray) -> None:
        """Forget what `rows` observed."""
        self.count[rows] = 0
        self.total[rows] = 0
        self.total_squares[rows] = 0
