"""Runs on primitives of other runs are repetitions if their primitives are."""

import shutil

import pytest

from shes.errors import ConfigError
from shes.runs.comparison import compare_runs, differing_settings, repeated_settings, seeds_of
from shes.runs.folder import RunFolder
from shes.runs.train import resume
from shes.viewing.groups import group_runs, read_run
from tests.e2e import runs


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


def groups_of(*paths):
    """Return the number of runs of each group, by its label."""
    return {group.label: len(group.runs) for group in group_runs([read_run(RunFolder.open(path)) for path in paths])}


def seeds_below(*folders):
    return [folder / f"seed-{seed}" for folder in folders for seed in (1, 2)]


def test_runs_whose_primitives_differ_in_the_seed_are_one_group(transferred, tmp_path):
    shared = train_on(transferred / "flagrun" / "a" / "seed-1", tmp_path / "shared", seed=3)
    found = seeds_below(transferred / "gather" / "a")
    assert groups_of(*found) == {"point-gather smoke (2 runs)": 2}
    assert list(groups_of(*found, shared).values()) == [3]


def test_runs_on_primitives_of_other_settings_or_lengths_stay_apart(transferred, tmp_path):
    longer = shutil.copytree(transferred / "flagrun" / "a" / "seed-1", tmp_path / "longer")
    resume(longer, generations=2)
    on_longer = train_on(longer, tmp_path / "on-longer", seed=3)
    assert groups_of(*seeds_below(transferred / "gather" / "a", transferred / "gather" / "b"), on_longer) == {
        "primitive's sigma 0.07, primitive's generations 1 (2 runs)": 2,
        "primitive's sigma 0.5, primitive's generations 1 (2 runs)": 2,
        "primitive's sigma 0.07, primitive's generations 2": 1,
    }


def test_groups_of_transferred_runs_are_compared_over_runs(transferred):
    found = compare_runs(transferred / "gather" / "a", transferred / "gather" / "b", episodes=2, num_workers=1)
    assert (found.unit, found.first_count, found.second_count) == ("runs", 2, 2)
    with pytest.raises(ConfigError, match=r"differ in primitive's sigma\. Give the folder of one group"):
        compare_runs(transferred / "gather", transferred / "gather" / "b")


def test_a_shipped_agent_counts_by_its_name(tmp_path):
    path = runs.train_tiny(tmp_path / "run", "ant-gather", primitive="ant-walker", generations=1)
    assert repeated_settings(RunFolder(path))["primitive"] == "ant-walker"
    assert "config" not in RunFolder(path).read_record()["primitive"]


def test_runs_of_one_seed_on_two_primitives_are_two_results(transferred, tmp_path):
    primitives = seeds_below(transferred / "flagrun" / "a")
    made = [train_on(primitive, tmp_path / primitive.name) for primitive in primitives]
    assert list(groups_of(*made).values()) == [2]
    shutil.copytree(made[0], tmp_path / "again")
    with pytest.raises(ConfigError, match="have the same seed and settings: they are one run"):
        compare_runs(tmp_path, transferred / "gather" / "b")


def test_a_chain_of_transfers_is_known_to_its_first_run(transferred, tmp_path):
    for seed in (1, 2):
        first, second = (tmp_path / name / str(seed) for name in ("first", "second"))
        shutil.copytree(transferred / "flagrun" / "a" / f"seed-{seed}", first)
        runs.train_tiny(second, "point-flagrun", seed=7, sigma=0.3, primitive=str(first), freeze_primitive=False)
        train_on(second, tmp_path / "third" / str(seed), seed=9)
    folders = [RunFolder.open(tmp_path / "third" / str(seed)) for seed in (1, 2)]
    for folder in ("first", "second"):
        shutil.rmtree(tmp_path / folder)
    settings = [repeated_settings(folder) for folder in folders]
    assert differing_settings(settings) == []
    names = ("sigma", "primitive's sigma", "primitive's primitive's sigma")
    assert [settings[0][name] for name in names] == [0.07, 0.3, 0.07]
    assert settings[0]["primitive"] == settings[0]["primitive's primitive"] == "of point-flagrun"
    expected = [{"seed": 9, "primitive's seed": 7, "primitive's primitive's seed": seed} for seed in (1, 2)]
    assert [seeds_of(folder) for folder in folders] == expected


@pytest.mark.parametrize("config", [None, [], {"run": {"env": "gone"}}])
def test_a_damaged_origin_counts_by_its_path(transferred, tmp_path, config):
    path = shutil.copytree(transferred / "gather" / "a" / "seed-1", tmp_path / "run")
    record = RunFolder(path).read_record()
    record["primitive"]["config"] = config
    RunFolder(path).write_record(record)
    assert repeated_settings(RunFolder(path))["primitive"] == str(transferred / "flagrun" / "a" / "seed-1")
