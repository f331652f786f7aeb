"""Comparisons of variants: with the base and in pairs, over equal budgets, of times; and their statistics."""

import math

import numpy as np
import pytest
from scipy import stats

from experiments.comparisons import COLUMNS, compare, equal_budget, holm, interquartile_mean, mann_whitney, superiority
from experiments.design import Measure, Pair, within
from experiments.results import PlacedResults, RunResults
from tests.experiments.tiny import experiment, run


def curve(*points, primitive=None, x="env_steps"):
    """Return the results of a run with evaluations at `points` of abscissa and score."""
    before = {} if primitive is None else {f"primitive_{x}": primitive}
    return RunResults(row={}, curve=[{x: at, "score_mean": score, **before} for at, score in points])


def compared(made, rows, curves=None):
    """Return the comparisons of an experiment by variant and other variant, with these rows of its runs."""
    results = {
        each.name: RunResults(row={**each.identity, **rows(each)}, curve=curves(each) if curves else [])
        for each in made.runs
        if rows(each) is not None
    }
    found = compare(PlacedResults(made, results))
    assert all(tuple(row) == COLUMNS for row in found)
    return {(row["env"], row["variant"], row["against"]): row for row in found}


def test_scores_are_averaged_over_the_steps_that_every_run_has():
    short, long = curve((0, 0.0), (100, 1.0)), curve((0, 0.0), (50, 1.0), (100, 1.0), (1000, 9.0))
    found = equal_budget([short, short], [long, long], "env_steps")
    assert found == pytest.approx({"span": 100, "score": 0.75, "score_against": 0.5, "p": 1 / 3})
    between = equal_budget([curve((0, 0.0), (75, 1.0))], [long], "env_steps", unit=5)  # ends between two evaluations
    assert (between["span"], between["score"], between["p"]) == (15, pytest.approx((25 + 25) / 75), None)


def test_the_training_of_a_primitive_counts_and_has_the_score_0():
    alone, after = curve((0, 0.0), (100, 1.0)), curve((10, 0.2), (60, 1.0), primitive=40)
    found = equal_budget([alone], [after], "env_steps")
    assert (found["span"], found["score"]) == (100, pytest.approx((40 * 0.0 + 10 * 0.2 + 50 * 0.6) / 100))
    assert equal_budget([alone], [curve((0, 0.2), (60, 1.0), primitive=100)], "env_steps") == {}


@pytest.mark.parametrize("other", [curve(), curve((0, None), (9, 1.0)), curve((0, 1.0), x="seconds")])
def test_curves_without_test_scores_or_steps_are_not_compared(other):
    assert equal_budget([curve((0, 0.0), (100, 1.0))] * 2, [curve((0, 0.0), (9, 1.0)), other], "env_steps") == {}


def test_variants_are_compared_with_the_base_and_corrected():
    variants = [("choices", "base"), ("choices", "worse"), ("choices", "same"), ("other", "frozen"), ("other", "free")]
    members = [run(name, seed, group=group) for group, name in variants for seed in range(10)]
    made = experiment(*members, pairs=within("other", ("frozen", "free")))
    bad = ("worse", "frozen")
    found = compared(made, lambda each: {"best_score": 0.1 * (each.seed % 5) - 2 * (each.variant in bad)})
    env = "point-gather"
    assert len(found) == 6
    base, worse = found[env, "base", None], found[env, "worse", "base"]
    assert (base["seeds"], base["score_mean"], base["p"], base["p_holm"]) == (10, pytest.approx(0.2), None, None)
    assert base["score_low"] < 0.2 < base["score_high"]
    assert worse["difference"] == pytest.approx(-2)
    assert (worse["p_holm"], worse["superiority"]) == (pytest.approx(2 * worse["p"]), 0)  # two comparisons of choices
    assert worse["mann_whitney_p"] == pytest.approx(2 / math.comb(20, 10))
    assert (found[env, "same", "base"]["p_holm"], found[env, "free", "base"]["superiority"]) == (1, 0.5)
    free = found[env, "free", "frozen"]
    assert (free["difference"], free["superiority"], free["against_group"]) == (pytest.approx(2), 1, "other")
    assert found[env, "frozen", "base"]["p_holm"] == pytest.approx(3 * found[env, "frozen", "base"]["p"])


def test_a_pair_may_be_for_one_environment_alone():
    envs = ("point-gather", "point-maze")
    members = [run(name, seed, env=env) for env in envs for name in "abc" for seed in (1, 2)]
    pair = Pair(("choices", "b"), ("choices", "c"), "point-maze")
    found = compared(experiment(*members, pairs=(pair,)), lambda each: {"best_score": each.seed})
    assert [env for env in envs if (env, "c", "b") in found] == ["point-maze"]
    assert found["point-maze", "c", "b"]["p"] == 1  # of two seeds, too


def test_without_its_base_a_variant_is_compared_with_none():
    made = experiment(run(), run("other"))
    [row] = compared(made, lambda each: {"best_score": 1.0} if each.variant == "other" else None).values()
    assert (row["variant"], row["against"], row["p"]) == ("other", None, None)
    assert compared(made, lambda _: None) == {}


def test_times_are_compared_seed_by_seed():
    seconds = {"base": {1: 10.0, 2: 20.0, 3: 40.0}, "two": {1: 5.0, 2: 5.0, 3: 20.0}}
    members = [run(name, seed) for name in seconds for seed in (1, 2, 3)]
    made = experiment(*members, metrics={"point-gather": Measure("seconds", "seconds")}, has_ratios=True)

    def found(seeds):
        rows = compared(made, lambda one: {"seconds": seconds[one.variant][one.seed]} if one.seed in seeds else None)
        return rows["point-gather", "two", "base"]

    row = found({1, 2, 3})
    assert (row["ratio"], row["ratio_low"], row["ratio_high"]) == pytest.approx((1 / 16 ** (1 / 3), 0.25, 0.5))
    assert (row["superiority"], 0 < row["p"] <= row["p_holm"] <= 1) == (pytest.approx(1.5 / 9), True)
    alone = found({1})
    assert (alone["ratio"], alone["p"], alone["mann_whitney_p"], alone["superiority"]) == (0.5, None, None, None)


def test_equal_budgets_are_over_steps_and_hours_and_corrected():
    members = [run(name, seed) for name in ("base", "two", "three") for seed in (1, 2, 3)]

    def points(each):
        speed, ends = (1, 2) if each.variant == "base" else (2, 4)
        none = {"primitive_env_steps": None, "primitive_seconds": None}
        of_step = {"env_steps": 1e6, "seconds": 3600 * speed, "score_mean": speed}
        return [{**none, **{name: at * value for name, value in of_step.items()}} for at in range(1 + ends)]

    def row_of(each):
        return {"best_score": 7.0, "seconds": 1800 * each.seed, "env_steps": 100 * each.seed}

    found = compared(experiment(*members, has_equal_budgets=True), row_of, points)
    row = found["point-gather", "two", "base"]
    assert (row["steps_span"], row["steps_score"], row["steps_score_against"]) == (2e6, 2.0, 1.0)
    assert (row["hours_span"], row["hours_score"], row["hours_score_against"]) == (2.0, 1.0, 1.0)
    assert (row["steps_p"], row["hours_p"], row["steps_p_holm"]) == pytest.approx((0.1, 1.0, 0.2))
    assert found["point-gather", "base", None]["steps_span"] is None
    assert (row["hours"], row["env_steps"], row["primitive_hours"]) == (1, 200, None)


# Statistics of samples of seeds, against SciPy, other programs and numbers counted by hand.

# The example of R's wilcox.test has the one-sided p 0.1272. Source: Hollander and Wolfe (1973), page 69.
OF_R = [0.80, 0.83, 1.89, 1.04, 1.45, 1.38, 1.91, 1.64, 0.73, 1.46], [1.15, 0.88, 0.90, 0.74, 1.21]


@pytest.mark.parametrize(
    ("first", "second", "p", "share"),
    [
        ([4, 5, 6], [1, 2, 3], 2 / 20, 0.0),  # the most extreme of the 20 orders
        ([1, 2, 5], [3, 4, 6], 8 / 20, 7 / 9),  # U = 2: 4 of the 20 orders have U <= 2
        (range(10), range(10, 20), 2 / math.comb(20, 10), 1.0),
        ([1, 1], [1, 1], 1.0, 0.5),
        ([0] * 5, [1] * 5, 2 / 252, 1.0),  # ties within the samples: 2 of the 252 divisions part all from all
        ([0, 1], [1, 2], 4 / 6, 7 / 8),  # a tie between them: U = 0.5, as in 2 of the 6 divisions, and none is less
        ([1, 2, 2, 3], [2, 3, 3], 2 * 10 / 35, 9 / 12),  # U = 3: 10 of the 35 divisions have U <= 3
        # The four ones of all are in one sample, as in this share of the divisions.
        ([0] * 10, [0] * 6 + [1] * 4, 2 * math.comb(10, 4) / math.comb(20, 4), 0.7),
        (*OF_R, pytest.approx(2 * 0.1272, abs=1e-4), 0.3),
    ],
)
def test_mann_whitney_and_superiority_counted_by_hand(first, second, p, share):
    first, second = np.array(first, float), np.array(second, float)
    assert superiority(first, second) == pytest.approx(share)
    assert mann_whitney(first, second) == (p if not isinstance(p, float) else pytest.approx(p))


@pytest.mark.parametrize("sizes", [(3, 8), (50, 50)])
def test_mann_whitney_without_ties_agrees_with_scipy(sizes):
    rng = np.random.default_rng(0)
    first, second = (rng.normal(shift, size=size) for shift, size in zip((0, 0.5), sizes, strict=True))
    expected = stats.mannwhitneyu(first, second, method="exact").pvalue
    assert mann_whitney(first, second) == pytest.approx(expected) == mann_whitney(second, first)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([100, 0, 1, 2, 6], 3.0),  # of 1, 2, 6: one value is left out at each end
        ([81, 64, 49, 36, 25, 16, 9, 4, 1, 0], 139 / 6),  # of 4, 9, 16, 25, 36, 49: two at each end
        ([0.3], 0.3),
    ],
)
def test_the_interquartile_mean_agrees_with_a_hand_value(values, expected):
    mean, low, high = interquartile_mean(np.array(values, float))
    assert mean == pytest.approx(expected)
    assert low <= mean <= high


def test_holm_corrects_as_the_textbook_does():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == [1.0, 1.0]
    assert holm([0.5, None, 0.02]) == [0.5, None, 0.04]
    assert holm([]) == []
