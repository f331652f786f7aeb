"""What every learner promises to a run: those of the package, and the example that is registered from outside."""

import runpy
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import shes
from shes.errors import CheckpointError, ConfigError, UnknownNameError
from shes.evolution import way_search
from shes.runs.build import build_algorithm, build_backend
from shes.runs.checkpoint import restore
from shes.runs.config import TrainConfig
from shes.runs.make_config import make_config
from shes.runs.named_algorithms import ALGORITHMS, TAKEN_SECTIONS, algorithm_classes, find_algorithm
from shes.runs.tables import read_csv
from shes.settings import Settings
from tests.e2e import runs

EXAMPLE = Path(__file__).parents[2] / "examples" / "random_search.py"
BRANCHED = {"primitive_estimate": "interval", "primitive_view": "proprioception", "controller_interval": 3}
SMALL_REPLAY = {"warmup_steps": 50, "generation_steps": 50, "batch_size": 4, "replay_size": 130, "update_interval": 5}
GRADIENT = ("hiro", "td3")
"""Algorithms that need JAX."""
LEARNERS = {
    # what is tried: (algorithm, environment, settings)
    **{name: (name, "point-gather", {}) for name in (*ALGORITHMS, "random-search")},
    **{
        f"{name}, without controller": (name, "point-flagrun", {})
        for name, cls in ALGORITHMS.items()
        if cls.without_controller not in (None, *ALGORITHMS.values())
    },
    "shes, branched": ("shes", "point-gather", BRANCHED),
    "shes, branched, searching": ("shes", "point-push", {**BRANCHED, "explore": "archive"}),
    "shes, without controller, branched": ("shes", "point-flagrun", {**BRANCHED, "primitive_view": "egocentric"}),
    "hiro": ("hiro", "point-gather", {**SMALL_REPLAY, "controller_update_interval": 5}),
    "td3": ("td3", "point-flagrun", {**SMALL_REPLAY, "num_envs": 3}),
}
OVER_LEARNERS = [
    pytest.param(name, marks=[pytest.mark.hiro] if LEARNERS[name][0] in GRADIENT else []) for name in LEARNERS
]
OF_THE_RUN = {"generation", "env_steps", "wall_time_s", "env_steps_per_s", "evaluation_s", "process_time_s"}


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """The example is known while a test of this module runs, in which searches have short slices."""
    monkeypatch.setattr(way_search, "SLICE_STEPS", 1)
    monkeypatch.setattr(way_search, "WALKERS", 16)
    runpy.run_path(str(EXAMPLE), run_name="random_search")
    yield
    for name in ("random-search", "own"):
        ALGORITHMS.pop(name, None)


def tiny(name):
    """Return environment and settings of a tiny run: of the tiny sizes those that its algorithm has."""
    algorithm, env, settings = LEARNERS[name]
    config = TrainConfig.of(env=env, algorithm=algorithm)
    sizes = {name: value for name, value in runs.TINY.items() if name in config.values}
    return env, {**sizes, **settings, "algorithm": algorithm}


@pytest.fixture(params=OVER_LEARNERS)
def learner(request, registered):
    """A learner of a tiny run."""
    env, settings = tiny(request.param)
    return build_algorithm(make_config(env, settings.pop("preset"), settings))


def reports(learner, state, count):
    with build_backend(learner.problem.settings, learner.plan()) as backend:
        return list(islice(learner.run(state, backend), count))


def same(learner, *states):
    one, other = (learner.to_arrays(state) for state in states)
    return one.keys() == other.keys() and all(one[name].tobytes() == other[name].tobytes() for name in one)


def no_times(columns):
    return {name: repr(value) for name, value in columns.items() if not name.endswith("_s")}


def test_every_learner_is_tried_here():
    tried = {find_algorithm(algorithm, sets_goals="flagrun" in env) for algorithm, env, _ in LEARNERS.values()}
    assert tried == set(algorithm_classes())


def test_it_starts_by_the_seed_with_agents_of_its_design(learner):
    state = learner.start(7)
    assert (state.seed, state.generation, state.env_steps) == (7, 0, 0)
    assert same(learner, state, learner.start(7))
    parameters = learner.parameters(state)
    assert learner.level_names == learner.design.level_names
    assert tuple(len(level.theta) for level in parameters) == learner.design.dims
    assert tuple(len(level.mean) for level in parameters) == learner.design.observation_sizes
    kept = learner.parameters(learner.without_training(state))
    assert [level.theta.tobytes() for level in kept] == [level.theta.tobytes() for level in parameters]


def test_a_generation_depends_on_the_state_alone(learner):
    """A learner that keeps something beside its state, or arrays with objects, would go on otherwise after a crash."""
    first, second, third = reports(learner, learner.start(5), 3)
    assert [each.state.generation for each in (first, second, third)] == [1, 2, 3]
    assert 0 < first.state.env_steps < second.state.env_steps < third.state.env_steps
    assert list(first.columns) == list(third.columns)
    assert not OF_THE_RUN & first.columns.keys()
    arrays = learner.to_arrays(first.state)
    assert {"seed", "generation", "env_steps"} <= arrays.keys()
    assert all(isinstance(array, np.ndarray) and not array.dtype.hasobject for array in arrays.values())
    for name in arrays:
        broken = SimpleNamespace(arrays={key: array for key, array in arrays.items() if key != name})
        with pytest.raises(CheckpointError, match=r"^a\.npz (is not|has) "):
            restore(broken, learner.from_arrays, Path("a.npz"))
    again = reports(learner, learner.from_arrays({name: array.copy() for name, array in arrays.items()}), 2)
    assert same(learner, again[-1].state, third.state)
    assert [no_times(each.columns) for each in again] == [no_times(each.columns) for each in (second, third)]
    assert not same(learner, second.state, third.state)


@pytest.mark.parametrize("name", OVER_LEARNERS)
def test_a_run_of_it_goes_on_and_its_agent_acts(name, tmp_path):
    env, settings = tiny(name)
    whole = shes.train(env, out=tmp_path / "whole", **{**settings, "generations": 2}).path
    half = shes.train(env, out=tmp_path / "half", **{**settings, "generations": 1}).path
    shes.resume(half, generations=2)
    assert runs.differences(whole, half) == []
    assert list(read_csv(whole / "progress.csv"))[:4] == ["generation", "env_steps", "wall_time_s", "env_steps_per_s"]
    evaluations = [shes.evaluate(whole, episodes=3, num_workers=workers).summary() for workers in (1, 2)]
    assert evaluations[0] == evaluations[1]
    agent = shes.load(whole)
    assert np.isfinite(agent.act(np.zeros(agent.observation_size))).all()


@pytest.mark.parametrize(
    ("name", "algorithm", "message"),
    [
        ("shes", "RandomSearch", "algorithm 'shes' is shes.evolution.strategies.SHES already"),
        ("Random search", "RandomSearch", "algorithm name must be lower-case words"),
        ("other", "State", "an? algorithm must be a subclass of shes.algorithms.contract.Algorithm"),
    ],
)
def test_what_is_no_algorithm_is_refused(name, algorithm, message):
    found = runpy.run_path(str(EXAMPLE), run_name="random_search")
    with pytest.raises(ConfigError, match=message):
        shes.register_algorithm(name, found[algorithm])
    assert "other" not in ALGORITHMS


@dataclass(frozen=True, kw_only=True)
class Search(Settings):
    tries: int = 1


@dataclass(frozen=True, kw_only=True)
class Vague(Settings):
    tries: int


def test_a_section_of_an_algorithm_has_a_name_of_its_own():
    example = runpy.run_path(str(EXAMPLE), run_name="random_search")["RandomSearch"]
    for section in ("run", "body", "values"):
        taken = type("Own", (example,), {"sections": {section: Search}})
        with pytest.raises(
            ConfigError, match=rf"Own has a section '{section}', a name that is taken\. Choose another name"
        ):
            shes.register_algorithm("own", taken)
    with pytest.raises(ConfigError, match=r"option 'tries' of .*Vague has no default"):
        shes.register_algorithm("own", type("Own", (example,), {"sections": {"search": Vague}}))
    shes.register_algorithm("own", type("Own", (example,), {"sections": {"evolution": Search}}))


def test_the_taken_sections_are_those_of_every_run():
    config = make_config("point-gather", "smoke", {"algorithm": "td3"})
    attributes = {name for name in (*dir(TrainConfig), *vars(config)) if not name.startswith("_")}
    assert (attributes | {"body"}) - ALGORITHMS["td3"].sections.keys() == TAKEN_SECTIONS


def test_an_unknown_algorithm_is_told_how_to_be_known():
    message = r"unknown algorithm 'random_serch'\. Did you mean 'random-search'.*shes\.register_algorithm"
    with pytest.raises(UnknownNameError, match=message):
        make_config("point-gather", "smoke", {"algorithm": "random_serch"})
