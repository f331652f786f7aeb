"""`shes compare`: runs over episodes, groups of runs over runs."""

import itertools
import json
import shutil
import sys

import numpy as np
import pytest
from scipy import stats

from shes.cli import main
from shes.errors import ConfigError, MissingExtraError
from shes.runs.comparison import check_scipy, compare_runs, mean_difference_interval, permutation_test
from shes.runs.evaluate import evaluate
from tests.e2e import runs


@pytest.fixture(scope="module")
def groups(tmp_path_factory):
    """Two folders of runs that differ in the seed, of different settings. Not to be changed."""
    folder = tmp_path_factory.mktemp("groups")
    for name, sigma in (("a", 0.07), ("b", 0.5)):
        for seed in (1, 2, 3):
            runs.train_tiny(folder / name / f"seed-{seed}", seed=seed, sigma=sigma, generations=1)
    return folder


def test_an_interval_is_that_of_welch():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=5), rng.normal(1, 3, size=9)
    found = stats.ttest_ind(second, first, equal_var=False).confidence_interval()
    assert mean_difference_interval(first, second) == pytest.approx((found.low, found.high))
    assert mean_difference_interval(np.ones(3), np.full(4, 3.0)) == (2, 2)


@pytest.mark.parametrize(
    ("first", "second"), [([1.0, 2.0, 4.0], [3.0, 7.0, 9.0, 9.5]), ([1.0, 1.0], [1.0, 1.0]), (range(5), range(5, 10))]
)
def test_the_permutation_test_of_few_values_is_exact(first, second):
    first, second = np.array(first, float), np.array(second, float)
    values, least = np.concatenate([first, second]), abs(first.mean() - second.mean()) - 1e-12
    splits = [list(split) for split in itertools.combinations(range(len(values)), len(first))]
    found = [abs(values[split].mean() - np.delete(values, split).mean()) >= least for split in splits]
    assert permutation_test(first, second) == pytest.approx(np.mean(found))


def test_the_permutation_test_of_many_values_is_seeded_and_never_zero():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=10), rng.normal(size=10) + 20
    assert permutation_test(first, second) == permutation_test(first, second) > 0
    assert permutation_test(first, second) == pytest.approx(permutation_test(second, first), abs=1e-3)
    assert permutation_test(np.full(5, 0.1), np.full(10, 0.1)) == 1  # whatever the order of summation


def test_without_scipy_nothing_is_compared_and_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(MissingExtraError, match=r"comparing runs needs SciPy \(.*pip install 'shes\[compare\]'"):
        check_scipy()


def test_groups_are_compared_over_runs(groups):
    found = compare_runs(
        groups / "a", groups / "b", episodes=4, num_workers=1, measure="return", seed=7, checkpoint="last"
    )
    means = [
        np.array(
            [
                evaluate(path, episodes=4, num_workers=1, seed=7, checkpoint="last").returns.mean()
                for path in sorted((groups / side).iterdir())
            ]
        )
        for side in ("a", "b")
    ]
    assert (found.unit, found.first_count, found.second_count) == ("runs", 3, 3)
    assert (found.first_mean, found.second_mean) == (means[0].mean(), means[1].mean())
    assert found.difference == pytest.approx(means[1].mean() - means[0].mean())
    assert (found.low, found.high) == mean_difference_interval(*means)
    assert found.low <= found.difference <= found.high
    assert found.p >= 0.1  # the least that 3 and 3 runs can give


def test_single_runs_are_compared_over_episodes(groups):
    found = compare_runs(groups / "a" / "seed-1", groups / "a" / "seed-1", episodes=4, num_workers=1)
    assert (found.unit, found.first_count, found.difference, found.p) == ("episodes", 4, 0, 1)


def test_the_command_prints_a_table_or_json(groups, capsys):
    words = ["compare", str(groups / "a"), str(groups / "b"), "--episodes", "2", "--workers", "1"]
    assert main(words) == 0
    assert "95 % interval [" in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["unit"], found["measure"], found["first_count"]) == ("runs", "score", 3)


def test_what_cannot_be_compared_is_refused(groups, tmp_path):
    one = groups / "a" / "seed-1"
    with pytest.raises(ConfigError, match=r"one run cannot be compared with several: .*a has 3 and .*seed-1 has 1"):
        compare_runs(groups / "a", one)
    with pytest.raises(
        ConfigError, match=r"the runs below .* differ in sigma\. Give the folder of one group, such as .*a"
    ):
        compare_runs(groups, one)
    with pytest.raises(ConfigError, match="is a run of point-gather, ant-walker of ant-flagrun"):
        compare_runs(one, "ant-walker")
    for copy in ("c", "d"):
        shutil.copytree(one, tmp_path / "twice" / copy)
    with pytest.raises(ConfigError, match="have the same seed and settings: they are one run"):
        compare_runs(tmp_path / "twice", groups / "a")
