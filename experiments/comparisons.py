"""Comparisons of variants with the base and with each other, and their statistics, which need SciPy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from experiments.results import PlacedResults, RunResults
from shes.runs.comparison import check_scipy, permutation_test
from shes.runs.tables import Row
from shes.types import F64Array, IntArray
from shes.viewing.curves import confidence_interval

COLUMNS = (
    *("group", "variant", "env", "measure", "seeds", "score_mean", "score_low", "score_high", "score_error"),
    *("score_iqm", "score_iqm_low", "score_iqm_high", "against_group", "against", "difference", "p", "p_holm"),
    *("mann_whitney_p", "superiority", "ratio", "ratio_low", "ratio_high"),
    *(
        f"{budget}_{name}"
        for budget in ("steps", "hours")
        for name in ("span", "score", "score_against", "p", "p_holm")
    ),
    *("env_steps", "primitive_env_steps", "hours", "primitive_hours"),
)
"""Columns of a table of comparisons, see `docs/how-to/paper.md`. A single seed has no errors and tests."""


def compare(results: PlacedResults) -> list[Row]:
    """Return the comparisons of all variants that have results: with the base of their environment, and in pairs."""
    experiment, rows = results.experiment, list[Row]()
    for env in experiment.metrics:
        for group in experiment.groups:
            pairs = list(_pairs(results, env, group))
            found = [_comparison(results, env, own, other) for own, other in pairs]
            for name in ("p", "steps_p", "hours_p"):
                corrected = holm([row.get(name) for row in found])
                found = [{**row, f"{name}_holm": p} for row, p in zip(found, corrected, strict=True)]
            rows += [{name: row.get(name) for name in COLUMNS} for row in found]
    return rows


def _pairs(results: PlacedResults, env: str, group: str) -> Iterator[tuple[tuple[str, str], tuple[str, str] | None]]:
    """Yield group and variant of what is compared, with those of the other one; None for the base itself."""
    experiment = results.experiment
    there = [place[1:] for place in results.places if place[0] == env]
    for own in there:
        if own[0] == group:
            yield own, None if own == experiment.base or experiment.base not in there else experiment.base
    for pair in experiment.pairs:
        if pair.env in ("", env) and pair.second[0] == group and pair.first in there and pair.second in there:
            yield pair.second, pair.first


def _comparison(results: PlacedResults, env: str, own: tuple[str, str], other: tuple[str, str] | None) -> Row:
    """Return the comparison of variant `own` with `other`, without the corrections."""
    experiment, column = results.experiment, results.experiment.metrics[env].column
    values = results.scores((env, *own))
    low, high = confidence_interval(values[:, None])
    iqm, iqm_low, iqm_high = interquartile_mean(values)
    row: Row = {
        "group": own[0],
        "variant": own[1],
        "env": env,
        "measure": column,
        "seeds": len(values),
        "score_mean": float(values.mean()),
        "score_error": float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None,
        "score_low": float(low[0]),
        "score_high": float(high[0]),
        "score_iqm": iqm,
        "score_iqm_low": iqm_low,
        "score_iqm_high": iqm_high,
        **_facts(results.runs[env, *own]),
    }
    if other is None:
        return row
    others = results.scores((env, *other))
    row |= {"against_group": other[0], "against": other[1], "difference": float(values.mean() - others.mean())}
    if min(len(values), len(others)) > 1:
        row |= {
            "p": permutation_test(values, others),
            "mann_whitney_p": mann_whitney(others, values),
            "superiority": superiority(others, values),
        }
    runs, their_runs = results.runs[env, *own], results.runs[env, *other]
    if experiment.has_ratios:
        row |= _ratios(runs, their_runs, column)
    if experiment.has_equal_budgets:
        for name, x, unit in (("steps", "env_steps", 1), ("hours", "seconds", 3600)):
            row |= {f"{name}_{key}": value for key, value in equal_budget(their_runs, runs, x, unit).items()}
    return row


def _facts(runs: Sequence[RunResults]) -> Row:
    """Return the means over the runs of a variant of what else is known of them."""
    rows, firsts = [run.row for run in runs], [run.curve[0] for run in runs if run.curve]
    return {
        "env_steps": _mean(rows, "env_steps"),
        "primitive_env_steps": _mean(firsts, "primitive_env_steps"),
        "hours": _mean(rows, "seconds", unit=3600),
        "primitive_hours": _mean(firsts, "primitive_seconds", unit=3600),
    }


def _ratios(runs: Sequence[RunResults], others: Sequence[RunResults], column: str) -> Row:
    """Return the ratios of a measure by the seeds of both; none if there are none, or one is not positive."""
    ours, theirs = ({run.row["seed"]: run.row[column] for run in side} for side in (runs, others))
    both = [(ours[seed], theirs[seed]) for seed in ours.keys() & theirs.keys()]
    if not both or any(value <= 0 for pair in both for value in pair):
        return {}
    ratios = np.array([one / other for one, other in both])
    mean = float(np.exp(np.log(ratios).mean()))
    return {"ratio": mean, "ratio_low": float(ratios.min()), "ratio_high": float(ratios.max())}


def equal_budget(
    first: Sequence[RunResults], second: Sequence[RunResults], x: str, unit: float = 1
) -> dict[str, float | None]:
    """Compare the test scores of two variants over the span of column `x` that all of their curves have.

    The span ends with the curve whose last evaluation comes first. The training of a transferred primitive counts: as
    long as it takes, the score is 0, the lowest of the tasks with scores. From there to a run's first evaluation it is
    that of this evaluation. The mean over a span also tells apart variants that both end at the highest score. Unlike a
    maximum, it does not rise with the number of evaluations.

    Returns:
        `span` in `unit`, mean `score` of the second variant and `score_against` of the first, and `p`, None if a
        variant has a single run. Empty if a curve has no test scores or no `x`, or begins where another one has ended.
    """
    runs = [*first, *second]
    if any(not run.curve or any(None in (row.get(x), row.get("score_mean")) for row in run.curve) for run in runs):
        return {}
    starts = [float(run.curve[0].get(f"primitive_{x}") or 0) for run in runs]
    at = [start + run.column(x) for start, run in zip(starts, runs, strict=True)]
    span = min(float(each[-1]) for each in at)
    if span <= max(float(each[0]) for each in at):
        return {}
    means = np.array(
        [_mean_until(span, *each) for each in zip(starts, at, (run.column("score_mean") for run in runs), strict=True)]
    )
    theirs, ours = means[: len(first)], means[len(first) :]
    p = permutation_test(theirs, ours) if min(len(theirs), len(ours)) > 1 else None
    return {"span": span / unit, "score": float(ours.mean()), "score_against": float(theirs.mean()), "p": p}


def _mean_until(span: float, start: float, at: F64Array, scores: F64Array) -> float:
    """Return the mean over [0, span] of the line through the `scores` of evaluations at `at`; 0 until `start`."""
    grid = np.unique(np.concatenate([[start], at[at < span], [span]]))
    return float(np.trapezoid(np.interp(grid, at, scores), grid) / span)


def _mean(rows: Sequence[Row], name: str, unit: float = 1) -> float | None:
    """Return the mean of the known values of a column in `unit`; None without any."""
    values = [row[name] for row in rows if row.get(name) is not None]
    return float(np.mean(values)) / unit if values else None


# Statistics of samples of seeds.


def mann_whitney(first: F64Array, second: F64Array) -> float:
    """Return the two-sided p of a Mann-Whitney U test, the paper's test.

    It is exact, with ties or without: twice the share of the divisions of all values into two such samples whose U is
    at least as extreme on the same side, at most 1.
    """
    values = np.concatenate([first, second])
    ranks = (2 * check_scipy().rankdata(values)).astype(int)  # twice the mean ranks of ties are whole
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

    A quarter of the values, rounded down to a whole number of them, is left out at each end. The interval has
    percentiles of 2,000 resamples as its bounds, and is too narrow for few values. It is the value itself if all are
    equal.
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
