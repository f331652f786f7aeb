"""Learning curves compared over what both methods have: as many environment steps, or as much time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shes.studies.significance import permutation_test
from shes.studies.study_tables import CellResults
from shes.types import F64Array

_SCORE = "score_mean"


@dataclass(frozen=True, kw_only=True)
class EqualBudget:
    """The mean test score over a span that every run of two variants has, from its first step on."""

    span: float
    """Length of the span, from 0 on, in the unit of the abscissa."""
    first: F64Array
    """Mean test score over the span of each run of the first variant: the area under its curve, over the span."""
    second: F64Array
    p: float
    """Two-sided p of a permutation test of the difference of means."""


def compare_curves(first: Sequence[CellResults], second: Sequence[CellResults], x: str) -> EqualBudget | None:
    """Compare the test scores of two variants over the span of column `x` that all of their runs have.

    The training of a transferred primitive counts: until it ends, the score is that of the run's first evaluation, of
    a controller that has learned for one generation. The mean over a span also tells apart variants that both end at
    the highest score. Unlike a maximum, it does not rise with the number of evaluations.

    Returns:
        The comparison; None if a curve has no test scores or no `x`, or begins where another one has ended.
    """
    sides = [[_curve(run, x) for run in side] for side in (first, second)]
    curves = [each for side in sides for each in side if each is not None]
    if not curves or len(curves) < len(first) + len(second):
        return None
    span = min(float(steps[-1]) for steps, _ in curves)
    if span <= max(float(steps[0]) for steps, _ in curves):
        return None
    one, other = (np.array([_mean(*each, span) for each in side if each is not None]) for side in sides)
    return EqualBudget(span=span, first=one, second=other, p=permutation_test(one, other))


def _curve(run: CellResults, x: str) -> tuple[F64Array, F64Array] | None:
    """Return the abscissae of a run's evaluations, with its primitive's training before them, and the scores."""
    start = f"primitive_{x}"
    if not run.curve or any(row.get(x) is None or row.get(_SCORE) is None for row in run.curve):
        return None
    steps = np.array([row[x] + (row.get(start) or 0) for row in run.curve], dtype=np.float64)
    return steps, np.array([row[_SCORE] for row in run.curve], dtype=np.float64)


def _mean(steps: F64Array, scores: F64Array, span: float) -> float:
    """Return the mean over [0, span] of the line through the points of a curve, continued by its first value."""
    grid = np.unique(np.concatenate([[0.0], steps[steps < span], [span]]))
    return float(np.trapezoid(np.interp(grid, steps, scores), grid) / span)
