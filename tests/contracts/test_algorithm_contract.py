"""What every learner promises to a run: those of the package, and the example that is registered from outside."""

import runpy
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, ClassVar

import numpy as np
import pytest

import shes
from shes.agents.views import CONTROLLER_VIEWS, PRIMITIVE_VIEWS, ColumnsView
from shes.algorithms.contract import Algorithm, Preset
from shes.errors import CheckpointError, ConfigError, UnknownNameError
from shes.es.perturbation import MIRRORINGS
from shes.evolution import way_search
from shes.evolution.estimates import draw_episodes
from shes.runs.build import build_algorithm, build_backend
from shes.runs.checkpoint import restore
from shes.runs.config import TrainConfig, known_settings
from shes.runs.make_config import make_config, transferred_levels
from shes.runs.named_algorithms import ALGORITHMS, TAKEN_SECTIONS, algorithm_classes, find_algorithm
from shes.runs.tables import read_csv
from shes.settings import Ge, Settings
from tests.e2e import runs
from tests.messages import raises

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
MARKS = {name: [pytest.mark.hiro] for name in GRADIENT}
OVER_LEARNERS = [pytest.param(name, marks=MARKS.get(of[0], [])) for name, of in LEARNERS.items()]
OF_THE_RUN = {"generation", "env_steps", "wall_time_s", "env_steps_per_s", "evaluation_s", "process_time_s"}


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """The example is known while a test of this module runs, in which searches have short slices."""
    monkeypatch.setattr(way_search, "SLICE_STEPS", 1)
    monkeypatch.setattr(way_search, "WALKERS", 16)
    before = set(ALGORITHMS)
    runpy.run_path(str(EXAMPLE), run_name="random_search")
    yield
    for name in set(ALGORITHMS) - before:
        del ALGORITHMS[name]


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
    assert learner.level_names == tuple(learner.design.networks)
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
        with pytest.raises(CheckpointError):
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


# Everything above `algorithms` knows an algorithm by its contract alone.


@dataclass(frozen=True, kw_only=True)
class OwnSettings(Settings):
    """Own."""

    few: Annotated[int, Ge(1)] = 5
    """A number."""
    many: Annotated[int, Ge(1)] = 10
    """A larger number."""
    primitive: float = 0.5
    """No level."""


@dataclass(frozen=True, kw_only=True)
class Vague(Settings):
    tries: int


class Alone(Algorithm):
    """Stands in."""

    level_names: ClassVar = ("primitive",)
    sections: ClassVar = {"evolution": OwnSettings}

    def __init__(self, problem):
        super().__init__(problem, problem.flat_design(hidden=()))

    start = run = to_arrays = from_arrays = parameters = None


class Own(Alone):
    """Learns in its own way. And this is not shown."""

    level_names: ClassVar = ("policy",)
    without_controller: ClassVar = Alone
    presets: ClassVar = {
        "smoke": Preset(values={"few": 1, "horizon": 7}, per_environment={"point-maze": {"many": 70}}),
        "own-paper": Preset(values={"many": 99}),
    }

    @staticmethod
    def check(settings):
        if settings.evolution.few >= settings.evolution.many:
            raise ConfigError("few must be less than many")

    @staticmethod
    def check_effects(settings, asked):
        if "few" in asked and settings.evolution.many == 3:
            raise ConfigError("few has no effect with many 3")


def having(base=Alone, **attributes):
    """Return an algorithm like `base` with other attributes."""
    return type("Other", (base,), attributes)


@pytest.fixture
def own(registered):
    shes.register_algorithm("own", Own)


TAKEN = "Other has a section '{}', a name that is taken. Choose another name"


@pytest.mark.parametrize(
    ("algorithm", "message"),
    [
        (OwnSettings, "algorithm must be a subclass of shes.algorithms.contract.Algorithm"),
        *((having(sections={name: OwnSettings}), TAKEN.format(name)) for name in ("run", "body", "values")),
        (having(Own, without_controller=having(sections={"run": OwnSettings})), TAKEN.format("run")),
        (having(sections={"search": Vague}), "option 'tries' of ... Vague has no default"),
    ],
)
def test_what_is_no_algorithm_is_refused(algorithm, message):
    with raises(ConfigError, message):
        shes.register_algorithm("other", algorithm)
    assert "other" not in ALGORITHMS


def test_the_taken_sections_are_those_of_every_run():
    config = make_config("point-gather", "smoke", {"algorithm": "td3"})
    attributes = {name for name in (*dir(TrainConfig), *vars(config)) if not name.startswith("_")}
    assert (attributes | {"body"}) - ALGORITHMS["td3"].sections.keys() == TAKEN_SECTIONS


def test_its_check_is_that_of_a_configuration(own):
    values = {"env": "point-gather", "algorithm": "own"}
    for make in (lambda: TrainConfig.of(**values, few=10),
                 lambda: TrainConfig.from_dict({"run": values, "evolution": {"few": 10}})):  # fmt: skip
        with raises(ConfigError, "few must be less than many"):
            make()
    assert TrainConfig.of(**values, few=9).evolution.few == 9
    with pytest.raises(ConfigError):
        make_config("point-gather", "laptop", {"algorithm": "own", "few": 1, "many": 3})
    assert make_config("point-gather", "smoke", {"algorithm": "own", "many": 3}).evolution.few == 1


def test_it_brings_values_of_presets_and_presets_of_its_own():
    with pytest.raises(UnknownNameError):
        make_config("point-gather", "own-paper")
    shes.register_algorithm("own", Own)
    smoke = {env: make_config(env, "smoke", {"algorithm": "own"}) for env in ("point-gather", "point-maze")}
    assert [(each.evolution.few, each.evolution.many) for each in smoke.values()] == [(1, 10), (1, 70)]
    assert (smoke["point-maze"].episodes.horizon, smoke["point-maze"].run.generations) == (7, 3)
    paper = make_config("point-gather", "own-paper")
    assert (paper.run.algorithm, paper.evolution.many, paper.run.preset) == ("own", 99, "own-paper")
    assert "own-paper" in known_settings()["preset"].choices
    with pytest.raises(ConfigError):
        make_config("point-gather", "own-paper", {"algorithm": "es"})
    assert make_config("point-gather", "paper").evolution.population_size == 1000  # of others nothing changes


def test_its_help_and_its_levels_are_its_own(own):
    text = known_settings()["algorithm"].text
    assert "; own: Learns in its own way." in text
    assert all(f"{name}: {cls.__doc__.partition('.')[0]}" in text for name, cls in ALGORITHMS.items())
    assert set(transferred_levels()) == {"controller", "primitive"}
    assert make_config("point-gather", "smoke", {"algorithm": "own", "primitive": 2}).evolution.primitive == 2.0


def test_it_says_who_learns_where_the_environment_sets_the_goals(own):
    """The class that stands in may be a subclass."""
    assert [find_algorithm("own", sets_goals=sets_goals) for sets_goals in (False, True)] == [Own, Alone]
    assert TrainConfig.of(env="point-flagrun", algorithm="own").level_names == ("primitive",)
    with raises(ConfigError, "hiro has nothing to learn. Set --algorithm to shes, ... own"):
        TrainConfig.of(env="point-flagrun", algorithm="hiro")
    whole = having(Own)
    whole.without_controller = having(whole, level_names=("primitive",))
    shes.register_algorithm("whole", whole)
    assert TrainConfig.of(env="point-flagrun", algorithm="whole").level_names == ("primitive",)


def threefold(num_levels):
    """Three members."""
    return [(1,) * num_levels] * 3


def test_mirrorings_and_views_can_be_registered(monkeypatch):
    monkeypatch.setitem(MIRRORINGS, "threefold", threefold)
    for registry in (PRIMITIVE_VIEWS, CONTROLLER_VIEWS):
        monkeypatch.setitem(registry, "first", lambda _: ColumnsView((0,)))
        with pytest.raises(ConfigError):
            registry["own"] = ColumnsView
    asked = {"mirrored": "threefold", "population_size": 6, "primitive_view": "first", "controller_view": "first"}
    built = build_algorithm(make_config("point-gather", "smoke", {**asked, "hidden": ()}))
    draws = draw_episodes(built.start(0), built.hyperparameters, built.table.size)
    assert draws.signs.tolist() == [[[1, 1]] * 3] * 2
    assert [policy.sizes[0] for policy in built.design.policies] == [1, 3 + 1]
    assert "threefold: Three members" in known_settings()["mirrored"].text
