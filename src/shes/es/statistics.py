"""Running mean and variance of a policy's observations, for input normalisation.

Source: Salimans et al. 2017, whose code normalises MuJoCo observations in this way, not by virtual batch normalisation.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from shes.types import F64Array, IntArray

MIN_VARIANCE = 0.01
"""Lower limit of the variance: normalisation magnifies no input more than tenfold."""
CLIP = 5.0
"""Normalised observations are clipped to this many standard deviations."""


@dataclass(frozen=True, kw_only=True)
class ObservationStatistics:
    """Number of the observations of one level, their sum [O] and the sum of their squares [O], in float64."""

    count: int
    total: F64Array
    total_squares: F64Array

    @classmethod
    def empty(cls, size: int) -> ObservationStatistics:
        """Return statistics of no observations: mean 0, standard deviation 1."""
        return cls(count=0, total=np.zeros(size), total_squares=np.zeros(size))

    @property
    def mean(self) -> F64Array:
        """Mean [O]."""
        return self.total / max(self.count, 1)

    @property
    def std(self) -> F64Array:
        """Standard deviation [O], at least `sqrt(MIN_VARIANCE)`."""
        if self.count == 0:
            return np.ones_like(self.total)
        return np.sqrt(np.maximum(self.total_squares / self.count - self.mean**2, MIN_VARIANCE))

    def merge(self, count: int, total: F64Array, total_squares: F64Array) -> ObservationStatistics:
        """Return these statistics with `count` more observations, given by their sums [O]."""
        return ObservationStatistics(
            count=self.count + count, total=self.total + total, total_squares=self.total_squares + total_squares
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """Number [K], sum and sum of squares [K, O] of the observations of K episodes at a level; they change in place."""

    count: IntArray
    total: F64Array
    total_squares: F64Array

    @classmethod
    def zeros(cls, num_episodes: int, size: int, xp: ModuleType = np) -> Moments:
        """Return sums over no observations of `size` values, as arrays of `xp`."""
        total, total_squares = xp.zeros((num_episodes, size)), xp.zeros((num_episodes, size))
        return cls(count=xp.zeros(num_episodes, dtype=np.int64), total=total, total_squares=total_squares)

    def add(self, rows: slice | IntArray, observation: F64Array) -> None:
        """Add one observation [rows, O] to each of `rows`."""
        self.count[rows] += 1
        self.total[rows] += observation
        self.total_squares[rows] += observation * observation

    def clear(self, rows: slice | IntArray) -> None:
        """Reset the sums of `rows`."""
        for sums in vars(self).values():
            sums[rows] = 0
