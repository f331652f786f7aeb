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
    p: float | None
    """Two-sided p of a permutation test of the difference of means; None if a variant has a single run."""


def compare_curves(first: Sequence[CellResults], second: Sequence[CellResults], x: str) -> EqualBudget | None:
    """Compare the test scores of two variants over the span of column `x` that all of their curves have.

    The span ends with the curve whose last evaluation comes first. The training of a transferred primitive counts: as
    long as it takes, the score is 0, the lowest of the tasks with scores. From there to a run's first evaluation it is
    that of this evaluation. The mean over a span also tells apart variants that both end at the highest score. Unlike a
    maximum, it does not rise with the number of evaluations.

    Returns:
        The comparison; None if a curve has no test scores or no `x`, or begins where another one has ended.
    """
    sides = [[_curve(run, x) for run in side] for side in (first, second)]
    curves = [each for side in sides for each in side if each is not None]
    if not curves or len(curves) < len(first) + len(second):
        return None
    span = min(float(each.at[-1]) for each in curves)
    if span <= max(float(each.at[0]) for each in curves):
        return None
    one, other = (np.array([each.mean(span) for each in side if each is not None]) for side in sides)
    p = permutation_test(one, other) if min(len(one), len(other)) > 1 else None
    return EqualBudget(span=span, first=one, second=other, p=p)


@dataclass(frozen=True)
class _Scores:
    """The test scores of a run."""

    start: float
    """Abscissa at which the training of its primitive ended; 0 without a transferred one."""
    at: F64Array
    """Abscissae of its evaluations."""
    scores: F64Array

    def mean(self, span: float) -> float:
        """Return the mean over [0, span] of the line through the evaluations; 0 until `start`."""
        grid = np.unique(np.concatenate([[self.start], self.at[self.at < span], [span]]))
        return float(np.trapezoid(np.interp(grid, self.at, self.scores), grid) / span)


def _curve(run: CellResults, x: str) -> _Scores | None:
    """Return the test scores of a run over `x`; None if one of them is unknown."""
    if not run.curve or any(row.get(x) is None or row.get(_SCORE) is None for row in run.curve):
        return None
    start = float(run.curve[0].get(f"primitive_{x}") or 0)
    at, scores = (np.array([row[name] for row in run.curve], dtype=np.float64) for name in (x, _SCORE))
    return _Scores(start, start + at, scores)
