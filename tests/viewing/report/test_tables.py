"""The tables of a report: results on fresh episodes, and differences of settings."""

import numpy as np
import pytest
from scipy import stats

from shes.runs.evaluate import evaluate
from shes.viewing.report.configuration import changed_settings, differing_settings
from shes.viewing.report.fresh_episodes import HEADINGS, estimate, evaluate_runs, result_rows, wilson
from shes.viewing.report.reading import read_runs
from tests.e2e import runs


def results(read, episodes=4):
    return result_rows(read.groups, evaluate_runs(read.runs, episodes, 1, None, lambda: None))


def test_a_run_has_the_results_that_evaluate_finds(kinds):
    found = evaluate(kinds["first"], episodes=4, num_workers=1)
    (row,) = results(read_runs([kinds["first"]]))
    shown = dict(zip(HEADINGS, row, strict=True))
    assert shown["score"] == estimate(found.scores)
    assert shown["return"] == estimate(found.returns)
    assert shown["success rate"].startswith(f"{found.successes.mean():.2f} [")
    assert shown["steps"] == f"{found.steps.mean():.0f}"


def test_a_group_has_a_row_over_its_runs_and_one_for_each(kinds):
    read = read_runs([kinds["first"], kinds["second"], kinds["flat"]])
    group, first, second, flat = results(read)
    means = [evaluate(kinds[name], episodes=4, num_workers=1).returns.mean() for name in ("first", "second")]
    assert group[0] == read.groups[0].label
    assert group[3] == estimate(np.array(means))
    assert [first[0], second[0], flat[0]] == [str(kinds[name]) for name in ("first", "second", "flat")]
    assert flat[HEADINGS.index("goals reached")] == "-"


def test_a_run_that_cannot_be_evaluated_is_a_note(kinds, run_copy):
    (run_copy / "checkpoints" / "best.npz").write_bytes(b"no")
    read = read_runs([run_copy, kinds["flat"]])
    (row,) = results(read)
    assert row[0] == str(kinds["flat"])
    assert "could not be evaluated" in read.runs[0].notes[0]


def test_an_estimate_is_mean_standard_error_and_interval():
    values = np.random.default_rng(0).normal(3.0, 1.0, 60)
    low, high = stats.norm.interval(0.95, values.mean(), stats.sem(values))
    text = estimate(values)
    assert text.startswith(f"{values.mean():.2f} ± {stats.sem(values):.2f} [")
    ends = [float(word.strip("[],")) for word in text.split()[-2:]]
    assert ends == pytest.approx([low, high], abs=0.06)
    assert estimate(np.array([2.0])) == "2.00"


@pytest.mark.parametrize(("successes", "trials"), [(0, 20), (7, 20), (20, 20), (1, 1)])
def test_the_interval_of_a_rate_is_that_of_scipy(successes, trials):
    expected = stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-4)


def test_the_settings_that_differ_are_listed_with_the_values_of_each_group(kinds):
    read = read_runs([kinds["first"], kinds["second"], kinds["other"]])
    assert differing_settings(read.groups) == {
        "seed": ["5, 6", "5"],
        "generations": ["4, 3", "4"],
        "sigma": ["0.07", "0.5"],
    }
    assert differing_settings(read.groups[1:]) == {}


def test_a_setting_that_a_run_does_not_have_is_a_dash(kinds):
    found = differing_settings(read_runs([kinds["first"], kinds["flat"]]).groups)
    assert found["algorithm"] == ["shes", "es"]
    assert found["controller_interval"] == ["25", "-"]


def test_the_settings_of_a_run_are_compared_with_its_preset(kinds):
    (run,) = read_runs([kinds["other"]]).runs
    changed = changed_settings(run.config)
    assert changed["sigma"] == ("0.5", "0.07")
    assert changed["hidden"] == ("4", "16")
    as_preset = {"preset", "seed", "noise_table_size", "evaluation_interval"}
    assert changed.keys() == (runs.TINY.keys() | {"sigma"}) - as_preset
