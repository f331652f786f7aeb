"""Statistics of samples of seeds, and tests of the difference between two of them. Needs SciPy (extra `study`)."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

import numpy as np

from shes.errors import MissingExtraError
from shes.types import F64Array, IntArray

_EXACT = 50  # values of a sample up to which the exact distribution of U takes no time
_DIVISIONS = 10_000  # divisions into two samples up to which all are counted, for a test of means
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
    never 0. Source: Phipson and Smyth (2010).

    Raises:
        MissingExtraError: SciPy is not installed.
        ValueError: A sample has less than two values.
    """
    scale = max(1.0, float(np.abs(np.concatenate([first, second])).max()))

    def difference(one: F64Array, other: F64Array, axis: int) -> F64Array:
        return np.round(np.abs(one.mean(axis=axis) - other.mean(axis=axis)) / scale, _DIGITS)

    found = check_scipy().permutation_test(
        (first, second), difference, vectorized=True, n_resamples=_DIVISIONS, alternative="greater", rng=0
    )
    return float(found.pvalue)


def mann_whitney(first: F64Array, second: F64Array) -> float:
    """Return the two-sided p of a Mann-Whitney U test, the paper's test.

    For samples of at most 50 values, with ties or without, it is exact: twice the share of the divisions of all values
    into two such samples whose U is at least as extreme on the same side. Otherwise it is the normal approximation with
    corrections for ties and continuity. It is 1 if all values are equal.

    Raises:
        MissingExtraError: SciPy is not installed.
    """
    values = np.concatenate([first, second])
    if np.ptp(values) == 0:
        return 1.0
    stats = check_scipy()
    if max(len(first), len(second)) > _EXACT:
        return float(stats.mannwhitneyu(first, second, alternative="two-sided", method="asymptotic").pvalue)
    ranks = (2 * stats.rankdata(values)).astype(int)  # twice the mean ranks of ties are whole
    divisions, found = _rank_sums(ranks, len(first)), ranks[: len(first)].sum()
    return float(min(1.0, 2 * min(divisions[: found + 1].sum(), divisions[found:].sum()) / divisions.sum()))


def _rank_sums(ranks: IntArray, size: int) -> F64Array:
    """Return, for every sum, the number of ways to take `size` of the `ranks` with this sum.

    SciPy counts rank sums without ties alone; with ties it goes through all divisions, seconds for two samples of ten.
    """
    ways = np.zeros((size + 1, ranks.sum() + 1))
    ways[0, 0] = 1
    for rank in ranks:
        ways[1:, rank:] += ways[:-1, :-rank].copy()  # the ways before this rank
    return ways[size]


def superiority(first: F64Array, second: F64Array) -> float:
    """Return the probability that a value of `second` exceeds one of `first`, where ties count one half.

    An effect size: 0.5 is none. Source: Vargha and Delaney (2000), measure A.
    """
    difference = second[:, None] - first[None, :]
    return float((np.sign(difference) + 1).mean() / 2)


def interquartile_mean(values: F64Array) -> tuple[float, float, float]:
    """Return the mean of the middle half of `values`, and its 95 % bootstrap interval. Source: Agarwal et al. (2021).

    A quarter of the values, rounded down to a whole number of them, is left out at each end.
    The interval has percentiles of 2,000 resamples as its bounds, and is too narrow for few values. It is the value
    itself if there is one value, or all are equal.

    Raises:
        MissingExtraError: SciPy is not installed.
    """
    stats = check_scipy()
    mean = float(stats.trim_mean(values, 0.25))
    if np.ptp(values) == 0:
        return mean, mean, mean
    found = stats.bootstrap(
        (values,),
        lambda sample, axis: stats.trim_mean(sample, 0.25, axis=axis),
        n_resamples=2000,
        method="percentile",
        rng=0,
    ).confidence_interval
    return mean, float(found.low), float(found.high)


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Return `p_values` corrected for multiple comparisons; None, a comparison without a test, does not count.

    Source: the step-down method of Holm (1979).
    """
    known = np.array([p for p in p_values if p is not None], dtype=np.float64)
    order = np.argsort(known, kind="stable")
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(1.0, np.maximum.accumulate(known[order] * np.arange(len(order), 0, -1)))
    found = iter(corrected.tolist())
    return [None if p is None else next(found) for p in p_values]
