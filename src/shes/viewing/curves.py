"""Learning curves of several runs: their values on a common grid, and the confidence interval of their mean."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shes.types import F64Array

_CONFIDENCE = 0.95
_RESAMPLES = 2000


def interpolate(x: Sequence[F64Array], y: Sequence[F64Array]) -> tuple[F64Array, F64Array]:
    """Return the grid that all curves cover [grid], and their linearly interpolated values there [runs, grid].

    `x` are the ascending abscissae of each curve, `y` its values.
    """
    start, end = max(each[0] for each in x), min(each[-1] for each in x)
    every = np.concatenate(x)
    grid = np.unique(every[(every >= start) & (every <= end)])
    return grid, np.stack([np.interp(grid, *curve) for curve in zip(x, y, strict=True)])


def confidence_interval(values: F64Array) -> tuple[F64Array, F64Array]:
    """Return the bounds, each [grid], of the 95 % bootstrap interval of the mean over runs of `values` [runs, grid].

    One matrix product serves the whole grid; `scipy.stats.bootstrap` would store every resample of every curve.
    """
    rng = np.random.default_rng(0)
    runs = len(values)
    shares = rng.multinomial(runs, np.full(runs, 1 / runs), _RESAMPLES) / runs  # share of each run in each resample
    means = shares @ values
    tail = (1 - _CONFIDENCE) / 2
    low, high = np.quantile(means, [tail, 1 - tail], axis=0)
    return low, high
