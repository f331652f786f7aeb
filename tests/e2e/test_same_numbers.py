"""The same numbers for any number of workers, any chunk size, any backend."""

import numpy as np
import pytest

import shes
from shes.backends.backend import SerialBackend
from shes.runs.config import known_settings
from tests.contracts.variants import VARIANTS
from tests.e2e import runs

# Every variant of the method.

METHOD = {"generations": 3, "evaluation_interval": 1, "keep_checkpoints": 1, "population_size": 12}
SCHEDULES = {"learning_rate_end": 0.001, "sigma_end": 0.3, "schedule_generations": 2}


NO_CHOICES = {"backend", "device", "preset"}
"""Names that say how, where and from what: backends are what is compared here, devices elsewhere."""
SOURCE = "the run of the fixture `source`"
EGOCENTRIC = {"primitive_view": "egocentric"}
BRANCHES = {**EGOCENTRIC, "primitive_estimate": "interval", "controller_interval": 4}
"""Intervals so short that an episode has several of them."""
WITH = {
    "fitness_shaping=pair_rank": {"mirrored": "pair"},
    "primitive_estimate": BRANCHES,
    "explore": {**EGOCENTRIC, "target": (0.0, 16.0)},
}
"""What a setting, or one of its choices, asks of others."""
OF_THE_ANT = {"symmetry"}
"""Settings that say nothing of a point."""
OF_GATHER = {"sectors", "equivariant"}
"""Choices that a maze has not."""


OF_HIRO = {"algorithm": {"hiro", "td3"}, "noise_unit": {"range", "raw"}}
"""Choices of algorithms that have no population, and tests of their own in tests/baselines."""
CHOICES = {
    name: tuple(choice for choice in each.choices if choice not in OF_HIRO.get(name, ()))
    for name, each in known_settings().items()
    if each.choices
}

BY_CHOICE = {
    f"{name}={choice}": {**WITH.get(name, {}), **WITH.get(f"{name}={choice}", {}), name: choice}
    for name, choices in CHOICES.items()
    for choice in choices
    if name not in NO_CHOICES | OF_THE_ANT and choice not in OF_GATHER
}
BY_HAND = {
    "layers of its own": {"primitive_hidden": (3, 5)},
    "some statistics": {"statistics_fraction": 0.4},
    "no statistics": {"statistics_fraction": 0.0},
    "flat, schedules": {"algorithm": "es", **SCHEDULES},
    "flat, own episodes": {"algorithm": "es", "mirrored": "none", "common_random_numbers": "off"},
    "frozen": {"primitive": SOURCE},
    "unfrozen": {"primitive": SOURCE, "freeze_primitive": False},
    "unfrozen by halves": {
        "primitive": SOURCE, "freeze_primitive": False, "perturbation": "one_to_many_halves", "optimizer": "sgd",
    },
    "branches": {**BRANCHES, "fall_price": 1.5},
    "branches, own rates": {
        **BRANCHES, "primitive_population_size": 6, "primitive_sigma": 0.2, "primitive_learning_rate": 0.05,
        "intervals": 3, "episodes_per_policy": 3,
    },
    "branches of one that learns on": {
        "primitive": SOURCE, "primitive_estimate": "interval", "freeze_primitive": False, "controller_interval": 4,
    },
    "everything": {
        "perturbation": "one_to_many", "mirrored": "pair", "fitness_shaping": "pair_rank", "optimizer": "sgd",
        "common_random_numbers": "population", "controller_output": "one_hot",
        "goal_encoding": "unit_vector", "primitive_reward": "cosine", "primitive_view": "proprioception",
        "clock_frequency": 1.5, "primitive_hidden": (3,), "episodes_per_policy": 3,
        **SCHEDULES,
    },
}  # fmt: skip
WALKER = {**EGOCENTRIC, "symmetry": "dihedral", **BRANCHES, "fall_price": 3.0, "horizon": 40, "output_weights": "zero"}
"""A primitive of the ant on branches, with all that helps it learn."""
BY_ENVIRONMENT = {
    "point-flagrun": {
        "alone": {},
        "alone, schedules": {**SCHEDULES, "optimizer": "sgd"},
        "alone, own episodes": {"mirrored": "none", "common_random_numbers": "off"},
        "flat": {"algorithm": "es"},
        "episodes that end": {**BRANCHES, "horizon": 16},  # after the second generation
    },
    "ant-flagrun": {
        "alone": {}, "flat": {"algorithm": "es"}, "rotation": {**EGOCENTRIC, "symmetry": "rotation"}, "walker": WALKER,
    },
    "ant-maze": {
        "everything": BY_HAND["everything"], "no symmetry": {**EGOCENTRIC, "symmetry": "none"},
        "walker": {**WALKER, "symmetry": "auto", "max_tilt": 20.0, "target": (0.0, 16.0)},
    },
    "ant-gather": {
        "walker": {
            **WALKER, "controller_network": "equivariant", "controller_view": "sectors",
            "controller_output": "heading_direction", "mirrored": "pair", "fitness_shaping": "pair_rank",
            "primitive_population_size": 8, "primitive_sigma": 0.1, "primitive_learning_rate": 0.05,
            "intervals": 1, "clock_frequency": 1.2,
        },
    },
    "point-push": {
        "branches": {**BRANCHES, "controller_output": "heading_direction", "goal_encoding": "vector"},
        "position": {"controller_view": "position", "controller_output": "direction"},
    },
    # Many members are paid the same here, so that it matters how ties rank.
    "point-gather": {
        "ties by index": {"fitness_shaping": "centred_rank_index", "controller_view": "sectors"},
    },
}  # fmt: skip
METHODS = [
    *(("point-maze", name, settings) for name, settings in {**BY_CHOICE, **BY_HAND}.items()),
    *((env, name, settings) for env, cases in BY_ENVIRONMENT.items() for name, settings in cases.items()),
    *((each.name, each.spec, {"spec": each.spec}) for each in VARIANTS),
]
QUICK = {("point-maze", "everything"), ("ant-gather", "walker"), ("point-flagrun", "episodes that end")}
"""These share enough with the others for worker processes on every day. The policies do not come out even."""
QUICK_SERIAL = {
    "mirrored", "fitness_shaping", "optimizer", "perturbation", "common_random_numbers", "statistics_fraction",
    "schedule_generations", "episodes_per_policy", "fall_price", "horizon",
}  # fmt: skip
"""Settings of the evolution itself, compared every day on the serial backend."""


def comparisons():
    """Return a test of every method on each of the two backends, most of them slow."""
    tests = []
    for env, name, settings in METHODS:
        is_quick_serial = env.startswith("point-") and bool(QUICK_SERIAL & settings.keys())
        for backend, is_quick in (("serial", is_quick_serial), ("processes", (env, name) in QUICK)):
            marks = [] if is_quick else [pytest.mark.slow]
            spread = {"backend": backend, "num_workers": 0, "chunk_size": (5, 1, 7, 0)[len(tests) // 2 % 4]}
            if backend == "processes":
                spread["num_workers"] = 3 if is_quick else 1 + len(tests) // 2 % 3
            tests.append(pytest.param(spread, env, settings, id=f"{backend}-{env}-{name}", marks=marks))
    return tests


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """Folder of a run that trained a point's primitive alone."""
    path = tmp_path_factory.mktemp("source") / "run"
    return runs.train_tiny(path, "point-flagrun", generations=2, clock_frequency=0.5, hidden=(3,))


@pytest.mark.parametrize(("spread", "env", "settings"), comparisons())
def test_neither_workers_nor_a_resume_change_any_method(tmp_path, monkeypatch, source, spread, env, settings):
    """The workers of the serial backend are 13 by name: members that share noise are divided as for so many."""
    if settings.get("primitive") == SOURCE:
        settings = {**settings, "primitive": str(source)}
    one = runs.train_tiny(tmp_path / "one", env, **{**METHOD, **settings})
    two = runs.train_tiny(tmp_path / "two", env, **{**METHOD, **settings, "generations": 1})
    monkeypatch.setattr(SerialBackend, "num_workers", 13)
    shes.resume(two, generations=3, **spread)
    assert runs.differences(one, two) == []


def test_a_primitive_on_branches_leaves_episodes_that_go_on(tmp_path):
    """So that the comparison of such a run says that they survive its end."""
    path = runs.train_tiny(tmp_path / "run", "ant-flagrun", **{**METHOD, **WALKER, "generations": 2})
    found = runs.numbers(path)
    assert found["last.npz/running/steps"].max() == 16  # two generations of two intervals
    assert found["last.npz/running/states"].shape[0] == 6
    assert found["generation_000001.npz/running/steps"].max() == 8
    settings = BY_ENVIRONMENT["point-flagrun"]["episodes that end"]
    path = runs.train_tiny(tmp_path / "ends", "point-flagrun", **{**METHOD, **settings})
    assert [runs.state(path, number).running is None for number in (1, 2, 3)] == [False, True, False]


def test_every_choice_of_every_name_is_compared():
    tried = {item for _, _, settings in METHODS for item in settings.items() if isinstance(item[1], str)}
    every = {(name, choice) for name in CHOICES if name not in NO_CHOICES for choice in CHOICES[name]}
    assert every <= tried
    assert {(env, name) for env, name, _ in METHODS} >= QUICK


# What the comparison sees.


def test_the_comparison_detects_a_bit_and_what_is_missing(run_copy, tiny_run):
    names = runs.numbers(tiny_run)
    assert {"progress.csv/env_steps", "evaluation.csv/score_mean", "last.npz/primitive/optimizer_second"} <= {*names}
    assert not any(name.endswith("_s") for name in names)
    assert runs.differences(tiny_run, tiny_run) == []
    last, table = run_copy / "checkpoints" / "last.npz", run_copy / "progress.csv"
    with np.load(last) as file:
        arrays = dict(file)
    arrays["primitive/theta"].view(np.int32)[-1] ^= 1
    np.savez(last, **arrays)
    assert runs.differences(tiny_run, run_copy) == ["last.npz/primitive/theta"]
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:-1]))
    assert "progress.csv/env_steps" in runs.differences(tiny_run, run_copy)
    (run_copy / "checkpoints" / "generation_000002.npz").unlink()
    assert "generation_000002.npz/controller/theta" in runs.differences(tiny_run, run_copy)
