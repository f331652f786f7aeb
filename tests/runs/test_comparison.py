"""`shes compare`: runs over episodes, groups of runs over runs; which runs are repetitions of each other."""

import itertools
import json
import shutil

import numpy as np
import pytest

import shes
from shes.cli import main
from shes.errors import ConfigError
from shes.runs.comparison import compare, mean_difference_interval, permutation_test
from tests.e2e import runs
from tests.messages import raises


def test_an_interval_is_that_of_welch():
    first, second = np.array([1.0, 2.0, 4.0]), np.array([3.0, 7.0, 9.0, 9.5])
    assert mean_difference_interval(first, second) == pytest.approx((0.26255, 9.32078), abs=1e-5)
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


def test_the_p_of_many_values_is_seeded_and_never_zero():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=10), rng.normal(size=10) + 20
    assert permutation_test(first, second) == permutation_test(first, second) > 0
    assert permutation_test(first, second) == pytest.approx(permutation_test(second, first), abs=1e-3)
    assert permutation_test(np.full(5, 0.1), np.full(10, 0.1)) == 1  # whatever the order of summation


def train_on(primitive, path, seed=1, **settings):
    """Train a controller for the primitive of the run at `primitive`."""
    return runs.train_tiny(path, seed=seed, primitive=str(primitive), generations=1, **settings)


@pytest.fixture(scope="module")
def transferred(tmp_path_factory):
    """Folders `gather/a` and `gather/b` of two runs each. Their primitives differ in `sigma`. Not to be changed."""
    folder = tmp_path_factory.mktemp("transferred")
    for name, sigma in (("a", 0.07), ("b", 0.5)):
        for seed in (1, 2):
            primitive = folder / "flagrun" / name / f"seed-{seed}"
            runs.train_tiny(primitive, "point-flagrun", seed=seed, sigma=sigma, generations=1)
            train_on(primitive, folder / "gather" / name / f"seed-{seed}", seed=seed)
    return folder


@pytest.fixture
def compared(transferred):
    """Return a function that compares the runs of a folder with those of `gather/b`; return how many there are."""
    return lambda folder: compare(folder, transferred / "gather" / "b", episodes=2, num_workers=1).first_count


@pytest.fixture
def copied(transferred, tmp_path):
    """A copy of `gather/a`, to be changed."""
    return shutil.copytree(transferred / "gather" / "a", tmp_path / "all")


def test_groups_are_compared_over_runs_single_runs_over_episodes(transferred, capsys):
    sides = [transferred / "gather" / side for side in ("a", "b")]
    given = {"episodes": 3, "num_workers": 1, "seed": 7, "checkpoint": "last"}
    found = compare(*sides, measure="return", **given)
    one, other = (
        np.array([shes.evaluate(path, **given).returns.mean() for path in sorted(side.iterdir())]) for side in sides
    )
    assert (found.unit, found.first_count, found.second_count) == ("runs", 2, 2)
    assert (found.first_mean, found.second_mean) == (one.mean(), other.mean())
    assert found.difference == pytest.approx(other.mean() - one.mean())
    assert (found.low, found.high) == mean_difference_interval(one, other)
    assert found.p >= 1 / 3  # the least that 2 and 2 runs can give
    words = ["compare", *map(str, sides), "--episodes", "3", "--workers", "1", "--seed", "7", "--checkpoint", "last"]
    assert main([*words, "--measure", "return", "--json"]) == 0
    assert json.loads(capsys.readouterr().out).items() >= {"p": found.p, "low": found.low, "unit": "runs"}.items()
    one = sides[0] / "seed-1"
    single = compare(one, one, episodes=4, num_workers=1)
    assert (single.unit, single.first_count, single.difference, single.p) == ("episodes", 4, 0, 1)
    assert main(["compare", str(one), str(one), "--episodes", "2", "--workers", "1"]) == 0
    assert "95 % interval [" in capsys.readouterr().out


def test_what_cannot_be_compared_is_refused(transferred, tmp_path):
    gather, one = transferred / "gather", transferred / "gather" / "a" / "seed-1"
    for copy in ("c", "d"):
        shutil.copytree(one, tmp_path / "twice" / copy)
    for first, second, message in (
        (gather / "a", one, "one run cannot be compared with several: ... a has 2 and ... seed-1 has 1"),
        (gather, one, "runs below ... differ in primitive's sigma. Give the folder of one group, such as ... a"),
        (one, "ant-walker", "is a run of point-gather, ant-walker of ant-flagrun"),
        (tmp_path / "twice", gather / "a", "have the same seed and settings: they are one run"),
    ):
        with raises(ConfigError, message):
            compare(first, second)


# Repetitions: runs on primitives of other runs are if their primitives are.


def test_runs_whose_primitives_differ_by_the_seed_are_alike(transferred, tmp_path, copied, compared):
    primitives = transferred / "flagrun" / "a"
    train_on(primitives / "seed-1", copied / "shared", seed=3)
    train_on(primitives / "seed-2", copied / "same", seed=3)  # of one seed, but of two primitives
    assert compared(copied) == 4
    train_on(f"{primitives / 'seed-1'}@0", copied / "earlier", seed=3)
    with raises(ConfigError, "differ in primitive."):
        compared(copied)
    shutil.rmtree(copied / "earlier")
    longer = shutil.copytree(primitives / "seed-1", tmp_path / "longer")
    shes.resume(longer, generations=2)
    train_on(longer, copied / "on-longer", seed=3)
    with raises(ConfigError, "differ in primitive's generations."):
        compared(copied)


def test_a_chain_of_transfers_is_known_to_its_first_run(transferred, tmp_path, compared):
    for name, seed in (("a", 1), ("a", 2), ("b", 1)):
        first, second = (tmp_path / place / f"{name}-{seed}" for place in ("first", "second"))
        shutil.copytree(transferred / "flagrun" / name / f"seed-{seed}", first)
        settings = {"seed": 7, "sigma": 0.3, "freeze_primitive": False, "generations": 1}
        runs.train_tiny(second, "point-flagrun", primitive=str(first), **settings)
        train_on(second, tmp_path / "third" / f"{name}-{seed}", seed=9)
    for folder in ("first", "second"):
        shutil.rmtree(tmp_path / folder)
    with raises(ConfigError, "differ in primitive's primitive's sigma."):
        compared(tmp_path / "third")
    shutil.rmtree(tmp_path / "third" / "b-1")
    assert compared(tmp_path / "third") == 2


@pytest.mark.parametrize("config", [None, [], {"run": {"env": "gone"}}])
def test_a_damaged_origin_counts_by_its_path(copied, compared, config):
    runs.change_json(copied / "seed-1" / "config.json", lambda record: record["primitive"].update(config=config))
    with raises(ConfigError, "differ in primitive."):
        compared(copied)
