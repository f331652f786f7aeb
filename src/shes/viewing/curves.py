"""Learning curves of several runs: their mean on a common grid, and the confidence interval of a mean."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import pi, sqrt

import numpy as np

from shes.types import F64Array

Table = Mapping[str, F64Array]
"""Columns of a table by name, with a value per row."""
X_AXES = {
    "env_steps": ("environment steps (millions)", 1e-6),
    "wall_time_s": ("minutes", 1 / 60),
    "generation": ("generation", 1.0),
}
"""Abscissae: column of the tables -> label, and factor of the column's values."""
_CONFIDENCE = 0.95
_LEAST_OVERLAP = 0.5
"""Part of the median length of the runs that all of them must cover for a mean."""


@dataclass(frozen=True, kw_only=True)
class MeanCurve:
    """The mean of curves of several runs with its interval, and the runs that are to be shown singly."""

    grid: F64Array
    """Abscissae [grid]; empty if the runs lie apart, so that there is no mean."""
    values: F64Array
    """Values there [runs, grid]."""
    band: tuple[F64Array, F64Array] | None = None
    """Bounds [grid] of the 95 % interval of the mean of three or more runs; of a single run, two standard errors."""
    singles: tuple[tuple[F64Array, F64Array], ...] = ()
    """Abscissae and values of each of two runs, whose interval says nothing, and of runs that lie apart."""

    @property
    def mean(self) -> F64Array:
        """Mean over runs [grid]."""
        return self.values.mean(axis=0)

    @property
    def is_apart(self) -> bool:
        """Whether the runs overlap too little for a mean."""
        return not len(self.grid)


def mean_curve(*curves: tuple[F64Array, F64Array]) -> MeanCurve:
    """Return the mean of curves where all have values; they are ascending abscissae and values, joined linearly.

    Without a common range of at least half of their median length there is no mean: it would leave out most of what
    the runs did.
    """
    if len(curves) == 1:
        return MeanCurve(grid=curves[0][0], values=curves[0][1][None])
    start, end = max(x[0] for x, _ in curves), min(x[-1] for x, _ in curves)
    if end - start < _LEAST_OVERLAP * np.median([x[-1] - x[0] for x, _ in curves]):
        return MeanCurve(grid=np.empty(0), values=np.empty((len(curves), 0)), singles=curves)
    every = np.concatenate([x for x, _ in curves])
    grid = np.unique(every[(every >= start) & (every <= end)])
    values = np.stack([np.interp(grid, *curve) for curve in curves])
    if len(curves) == 2:
        return MeanCurve(grid=grid, values=values, singles=curves)
    return MeanCurve(grid=grid, values=values, band=confidence_interval(values))


def column_curve(tables: Sequence[Table], column: str, x: str) -> MeanCurve:
    """Return the mean of `column` of the tables of several runs, over `x` of `X_AXES`.

    A single table of evaluations has a band of two standard errors over the episodes on either side.
    """
    curve = mean_curve(*((table[x] * X_AXES[x][1], table[column]) for table in tables))
    spread = column.replace("_mean", "_std")
    if len(tables) > 1 or spread == column or not {spread, "episodes"} <= tables[0].keys():
        return curve
    error = 2 * tables[0][spread] / np.sqrt(tables[0]["episodes"])
    return replace(curve, band=(curve.mean - error, curve.mean + error))


def confidence_interval(values: F64Array) -> tuple[F64Array, F64Array]:
    """Return the bounds, each [grid], of the 95 % t interval of the mean over runs of `values` [runs, grid].

    The interval is the mean itself where all runs agree, and of a single run.
    """
    mean, runs = values.mean(axis=0), len(values)
    if runs == 1:
        return mean, mean
    half = t_quantile(runs - 1) * values.std(axis=0, ddof=1) / sqrt(runs)
    return mean - half, mean + half


@cache
def t_quantile(freedom: int) -> float:
    """Return the t that a variable of Student's distribution exceeds in absolute value with probability 5 %.

    With t = √freedom · tan(angle) the density is proportional to cos(angle) to the power freedom - 1. Its integral is
    the trapezoidal sum, to eight digits; the base installation has no SciPy.
    """
    angles = np.linspace(0, pi / 2, 500_001)
    density = np.cos(angles) ** (freedom - 1)
    integral = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    return float(np.tan(np.interp(_CONFIDENCE * integral[-1], integral, angles)) * sqrt(freedom))
