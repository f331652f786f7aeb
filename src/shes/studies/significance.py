"""Significance tests for the difference between two samples of seeds. Needs SciPy (extra `study`)."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np

from shes.errors import MissingExtraError
from shes.types import F64Array

_DIGITS = 12  # to this many digits, differences of means do not depend on the order of summation


def check_scipy() -> ModuleType:
    """Return `scipy.stats`; raise MissingExtraError if SciPy is not installed."""
    try:
        from scipy import stats
    except ImportError as error:
        raise MissingExtraError(
            f"the statistics of a study need SciPy ({error}). Install it: pip install 'shes[study]'."
        ) from error
    return stats


def permutation_test(first: F64Array, second: F64Array) -> float:
    """Return the two-sided p of the difference of means between two samples.

    p is the share of divisions of all values into two such samples whose difference is at least as large. If there
    are more than 10,000 divisions, it is estimated from as many random ones and the given one, so that it is
    never 0. It is 1 if a sample has a single value. Source: Phipson and Smyth (2010).

    Raises:
        MissingExtraError: SciPy is not installed.
    """
    if min(len(first), len(second)) < 2:
        return 1.0
    scale = max(1.0, float(np.abs(np.concatenate([first, second])).max()))

    def difference(one: F64Array, other: F64Array, axis: int) -> F64Array:
        return np.round(np.abs(one.mean(axis=axis) - other.mean(axis=axis)) / scale, _DIGITS)

    found = check_scipy().permutation_test(
        (first, second), difference, vectorized=True, n_resamples=10_000, alternative="greater", rng=0
    )
    return float(found.pvalue)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return `p_values` corrected for multiple comparisons. Source: the step-down method of Holm (1979)."""
    order = np.argsort(p_values, kind="stable")
    corrected = np.empty(len(order))
    steps = np.asarray(p_values, dtype=np.float64)[order] * np.arange(len(order), 0, -1)
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(steps))
    return corrected.tolist()
