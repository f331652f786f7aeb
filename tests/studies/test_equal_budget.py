"""Comparisons of learning curves over the steps and the time that both methods have, and of times by their ratios."""

from dataclasses import replace

import pytest

from shes.studies.comparison import compare
from shes.studies.design import Measure, StudyDesign
from shes.studies.equal_budget import compare_curves
from shes.studies.study import Study
from shes.studies.study_tables import Cell, CellResults

pytestmark = pytest.mark.extras


def run(*points, primitive=None, x="env_steps"):
    """Return the results of a run with evaluations at `points` of abscissa and score."""
    before = {} if primitive is None else {f"primitive_{x}": primitive}
    return CellResults(row={}, curve=tuple({x: at, "score_mean": score, **before} for at, score in points))


def test_scores_are_averaged_over_the_steps_that_every_run_has():
    short, long = run((0, 0.0), (100, 1.0)), run((0, 0.0), (50, 1.0), (100, 1.0), (1000, 9.0))
    found = compare_curves([short, short], [long, long], "env_steps")
    assert found.span == 100
    assert found.first == pytest.approx([0.5, 0.5])
    assert found.second == pytest.approx([0.75, 0.75])
    assert found.p == pytest.approx(1 / 3)  # two of the six divisions are as extreme
    between = compare_curves([run((0, 0.0), (75, 1.0))], [long], "env_steps")  # ends between two evaluations
    assert (between.span, *between.second) == pytest.approx((75, (25 + 25) / 75))


def test_the_training_of_a_primitive_counts_and_has_the_score_0():
    alone, after = run((0, 0.0), (100, 1.0)), run((10, 0.2), (60, 1.0), primitive=40)
    found = compare_curves([alone], [after], "env_steps")
    assert found.span == 100
    assert found.second == pytest.approx([(40 * 0.0 + 10 * 0.2 + 50 * 0.6) / 100])
    assert found.p is None  # of a single run
    assert compare_curves([alone], [run((0, 0.2), (60, 1.0), primitive=100)], "env_steps") is None


@pytest.mark.parametrize("other", [CellResults(row={}, curve=()), run((0, None), (9, 1.0)), run((0, 1.0), x="seconds")])
def test_curves_without_test_scores_or_steps_are_not_compared(other):
    assert compare_curves([run((0, 0.0), (100, 1.0))] * 2, [run((0, 0.0), (9, 1.0)), other], "env_steps") is None


def study(variants=("one", "two"), **flags):
    cells = tuple(Cell(group="g", variant=v, env="point-gather", seed=s) for s in (1, 2, 3) for v in variants)
    design = StudyDesign(
        groups={"g": ""}, base=("g", "one"), metrics={"point-gather": Measure("seconds", "seconds")}, **flags
    )
    return Study(cells=cells, design=design)


def test_times_are_compared_seed_by_seed_and_tested_unless_there_is_one_seed():
    made = study(has_ratios=True)
    seconds = {"one": {1: 10.0, 2: 20.0, 3: 40.0}, "two": {1: 5.0, 2: 5.0, 3: 20.0}}
    summaries = {
        cell.name: CellResults(row={**cell.identity, "seconds": seconds[cell.variant][cell.seed]}, curve=())
        for cell in made.cells
    }
    base, other = compare(made, summaries)
    assert base.ratio is None
    # Of the pairs, 20 is above 10 and equal to 20.
    assert (other.mann_whitney_u, other.superiority) == (1.5, pytest.approx(1.5 / 9))
    assert 0 < other.p <= other.p_holm <= 1
    assert 0 < other.mann_whitney_p <= 1
    assert (other.ratio, other.ratio_low, other.ratio_high) == pytest.approx((1 / 16 ** (1 / 3), 0.25, 0.5))
    assert other.texts(made.design)[-1] == "0.40 [0.25, 0.50]"
    del summaries["point-gather/g/two/seed-2"]  # the seeds of both are compared
    assert compare(made, summaries)[1].ratio == pytest.approx(0.5)
    first = {name: found for name, found in summaries.items() if name.endswith("seed-1")}
    alone = compare(made, first)[1]
    assert alone.texts(made.design)[-1] == "0.50"
    assert (alone.ratio, alone.p, alone.p_holm, alone.mann_whitney_p, alone.superiority) == (0.5, *(None,) * 4)


def test_a_comparison_over_equal_budgets_has_both_variants_over_steps_and_hours():
    made = study(("one", "two", "three"), has_equal_budgets=True)
    summaries = {
        cell.name: CellResults(
            row={**cell.identity, "seconds": 7.0},
            curve=tuple(
                {"env_steps": 1e6 * at, "seconds": 3600 * at * speed, "score_mean": at * speed}
                for at in range(1 + ends)
            ),
        )
        for cell in made.cells
        for speed, ends in [(1, 2) if cell.variant == "one" else (2, 4)]
    }
    base, other, third = compare(made, summaries)
    assert (base.steps_span, base.steps_p_holm, base.equal_texts(made.design)) == (None, None, None)
    assert (other.steps_span, other.steps_score, other.steps_score_against) == (2e6, 2.0, 1.0)
    assert (other.hours_span, other.hours_score, other.hours_score_against) == (2.0, 1.0, 1.0)
    assert (other.steps_p, other.hours_p) == (pytest.approx(0.1), 1.0)
    assert (third.steps_p_holm, third.hours_p_holm) == (pytest.approx(0.2), 1.0)
    texts = ("2.00 against 1.00 in 2.00 M, p 0.2000", "1.00 against 1.00 in 2 h 00 min, p 1.0000")
    assert other.equal_texts(made.design)[2:] == texts
    assert replace(other, hours_span=None).equal_texts(made.design)[2:] == (texts[0], "-")
    assert replace(other, steps_span=None).equal_texts(made.design)[2:] == ("-", texts[1])
    short = replace(other, steps_span=2e4, hours_span=4.2 / 3600, steps_p_holm=None, hours_p_holm=None)
    assert short.equal_texts(made.design)[2:] == ("2.00 against 1.00 in 20,000", "1.00 against 1.00 in 4.2 s")
