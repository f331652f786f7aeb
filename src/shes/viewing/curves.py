"""Curves of several runs: their values at common places, and how sure their mean is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shes.types import F64Array

__all__ = ["interpolate", "interval"]

_CONFIDENCE = 0.95
_RESAMPLES = 2000


def interpolate(x: Sequence[F64Array], y: Sequence[F64Array]) -> tuple[F64Array, F64Array]:
    """Return all places [grid] that every curve reaches, and the linearly interpolated values there [runs, grid].

    Args:
        x: Places of each curve's points, ascending.
        y: The values there.
    """
    start, end = max(places[0] for places in x), min(places[-1] for places in x)
    every = np.concatenate(x)
    grid = np.unique(every[(every >= start) & (every <= end)])
    return grid, np.stack([np.interp(grid, *curve) for curve in zip(x, y, strict=True)])


def interval(values: F64Array, seed: int = 0) -> tuple[F64Array, F64Array]:
    """Return the 95 % bootstrap interval [grid], [grid] of the mean over runs of `values` [runs, grid].

    One matrix product for all of the grid: `scipy.stats.bootstrap` would hold every resample of every curve.
    """
    rng = np.random.default_rng(seed)
    runs = len(values)
    shares = rng.multinomial(runs, np.full(runs, 1 / runs), _RESAMPLES) / runs  # how often a resample takes each run
    means = shares @ values
    tail = (1 - _CONFIDENCE) / 2
    low, high = np.quantile(means, [tail, 1 - tail], axis=0)
    return low, high
