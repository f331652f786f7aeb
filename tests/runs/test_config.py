"""Settings of a run: sections of its algorithm and its task, one value for each name, JSON that gives them back."""

import copy
import json
import pickle
from dataclasses import dataclass
from typing import Annotated, ClassVar

import gymnasium
import numpy as np
import pytest

import shes
from shes.algorithms.evolution.learned_levels import learns
from shes.algorithms.evolution.sections import SCHEDULED
from shes.envs.bodies.point import Point
from shes.envs.gymnasium_ids import register_ids
from shes.envs.registry import ENVIRONMENTS, Environment
from shes.envs.tasks.task_options import TaskOptions
from shes.errors import ConfigError, UnknownNameError
from shes.hierarchy.goals import GOAL_ENCODINGS
from shes.hierarchy.outputs import CONTROLLER_OUTPUTS, VectorOutput
from shes.hierarchy.rewards import PRIMITIVE_REWARDS
from shes.runs.config import TrainConfig
from shes.runs.sections import WorkerSettings, execution_settings, known_settings
from shes.settings import Gt, Settings, Shared, flag
from shes.training.build import build_algorithm, build_task
from shes.training.make_config import make_config
from tests.e2e import own_classes, runs

EXECUTION = {
    "preset", "backend", "num_workers", "chunk_size", "device", "nconmax", "njmax", "generations", "env_steps",
    "minutes", "keep_checkpoints", "ray_address", "worker_timeout_s",
    "max_diverged_generations",
}  # fmt: skip


def make(**settings):
    return TrainConfig.of(env="point-gather", **settings)


def test_a_setting_is_in_a_section_and_is_told_by_its_own_name():
    config = make(sigma=0.5, fall_penalty=False, spec="hiro", num_workers=3)
    assert (config.evolution.sigma, config.environment.fall_penalty, config.workers.num_workers) == (0.5, False, 3)
    assert config.values["sigma"] == 0.5
    assert config.having(sigma=0.25).evolution.sigma == 0.25
    assert config.having(sigma=0.5) == config != config.having(sigma=0.25)


@pytest.mark.parametrize(
    ("env", "algorithm", "sections"),
    [
        ("point-gather", "shes", "run workers evolution schedules exploration networks hierarchy estimate transfer"),
        ("point-flagrun", "shes", "run workers evolution schedules networks hierarchy estimate transfer"),
        ("point-gather", "es", "run workers evolution schedules networks"),
    ],
)
def test_sections_are_those_of_the_algorithm(env, algorithm, sections):
    config = TrainConfig.of(env=env, algorithm=algorithm)
    assert list(config.sections) == [*sections.split(), "environment", "episodes", "evaluation"]
    for section in ("exploration", "hierarchy"):
        if section not in config:
            with pytest.raises(AttributeError, match=f"no section of settings '{section}' here; it has run, "):
                getattr(config, section)


def test_settings_that_never_change_numbers_are_marked():
    assert set(execution_settings()) == EXECUTION
    numbers = make().numbers()
    assert set(numbers) == set(make().values) - EXECUTION
    execution = {"generations": 5, "env_steps": 900, "minutes": 1.0, "keep_checkpoints": 2, "preset": "paper"}
    assert make(num_workers=3, chunk_size=7, backend="serial", **execution).numbers() == numbers
    assert make(device="cuda", nconmax=3, njmax=7).numbers() == numbers
    assert make(seed=2).numbers() != numbers


def test_every_number_is_checked_where_it_is_told():
    """Each setting that is a number refuses one below its range, by its own name."""
    for name, setting in known_settings().items():
        if setting.item not in (int, float):
            continue
        wrong = (-2000,) if setting.kind is tuple else -1
        with pytest.raises(ConfigError, match=rf"^{name} must be .*, got .*Set {setting.flag}\.$"):
            setting.checked(wrong)


def test_the_population_is_a_multiple_of_its_groups():
    for mirrored, wrong, nearest in (("quad", 18, "16 or 20"), ("pair", 7, "6 or 8")):
        with pytest.raises(ConfigError, match=rf"population_size must be a positive multiple .*{wrong}\. .*{nearest}"):
            make(population_size=wrong, mirrored=mirrored)


def test_an_environment_is_known_and_needed():
    with pytest.raises(UnknownNameError, match=r"unknown environment 'ant-gathr'\. Did you mean 'ant-gather'\?"):
        TrainConfig.of(env="ant-gathr")
    with pytest.raises(ConfigError, match=r"names no environment \(key 'env'\)"):
        TrainConfig.from_dict({"run": {"seed": 1}})
    with pytest.raises(ConfigError, match=r"env must be a name, got 3\. Set --env"):
        TrainConfig.of(env=3)


def test_names_registered_later_are_allowed_and_suggested(monkeypatch):
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(Point, own_classes.Corner))
    monkeypatch.setitem(GOAL_ENCODINGS, "own-vector", own_classes.Vector)
    monkeypatch.setitem(PRIMITIVE_REWARDS, "nearness", own_classes.Nearness)
    monkeypatch.setitem(CONTROLLER_OUTPUTS, "sideways", VectorOutput)
    names = {
        "env": "point-corner",
        "goal_encoding": "own-vector",
        "primitive_reward": "nearness",
        "controller_output": "sideways",
    }
    assert TrainConfig.from_dict(TrainConfig.of(**names).to_dict()).values.items() >= names.items()
    for name, right in names.items():
        with pytest.raises(UnknownNameError, match=f"Did you mean '{right}'"):
            TrainConfig.of(**{**names, name: right[:-1]})


def test_json_gives_back_the_same_settings():
    config = make(hidden=(16, 8), sigma=0.1 + 0.2, minutes=1.5, seed=2**62, primitive_hidden=())
    kept = json.loads(json.dumps(config.to_dict()))
    assert kept["networks"]["hidden"] == [16, 8]
    assert TrainConfig.from_dict(kept) == config
    config = TrainConfig.of(env="robotics-ant-maze")
    assert TrainConfig.from_dict(config.to_dict()) == config


def test_numbers_of_numpy_become_numbers_of_python():
    config = make(seed=np.int64(3), sigma=np.float32(0.5), hidden=[np.int32(4)], hide_position=np.bool_(True))
    assert config == make(seed=3, sigma=0.5, hidden=(4,), hide_position=True)
    assert type(config.evolution.sigma) is float


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("sigmma", r"unknown setting 'sigmma'\. Did you mean 'sigma'\?( Similar: [a-z_, ]+\.)?$"),
        ("qqq", r"unknown setting 'qqq'\. `shes train ENV --help-all` lists the settings\.$"),
    ],
)
def test_an_unknown_setting_gets_the_nearest_names_alone(name, message):
    with pytest.raises(ConfigError, match=message):
        make(**{name: 1})


def record(env="point-gather", **changes):
    """Return the record of a run with other values: `section={name: value}`; one that is `...` is absent."""
    sections = {
        **TrainConfig.of(env=env).to_dict(),
        **{section: ... for section, each in changes.items() if each is ...},
    }
    for section, each in changes.items():
        if isinstance(each, dict):
            sections[section] = {
                name: value for name, value in {**sections.get(section, {}), **each}.items() if value is not ...
            }
        elif each is not ...:
            sections[section] = each
    return {section: values for section, values in sections.items() if values is not ...}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"evolution": {"sigmma": 1}}, r"unknown setting 'sigmma' in section 'evolution'\. Did you mean 'sigma'\?"),
        ({"workers": {"sigma": 0.1}}, r"unknown setting 'sigma' in section 'workers'"),
        ({"attic": {}}, r"a run of point-gather has no section of settings 'attic'"),
        ({"evolution": 1}, r"'evolution' must be an object of settings, got 1"),
        ({"run": {"env": ...}}, r"the configuration names no environment"),
    ],
)
def test_an_unknown_key_or_section_is_an_error(changes, message):
    with pytest.raises(ConfigError, match=message):
        TrainConfig.from_dict(record(**changes))


@pytest.mark.parametrize("changes", [{"exploration": ...}, {"workers": {"chunk_size": ..., "device": ...}}])
def test_a_setting_or_section_that_is_newer_than_the_record_has_its_default(changes):
    assert TrainConfig.from_dict(record(**changes)) == TrainConfig.from_dict(record())


def test_a_class_that_is_not_registered_is_named_before_its_options():
    settings = {"primitive_reward": "pow", "exponent": 2}
    message = r"unknown primitive reward 'pow'\. .*Register your own first: .*, or --import MODULE\.$"
    with pytest.raises(UnknownNameError, match=message):
        make(**settings)
    with pytest.raises(UnknownNameError, match=message):
        TrainConfig.from_dict(record(hierarchy=settings))


def test_a_shared_setting_has_one_value_in_a_record():
    message = r"goal_distance is 4\.0 in section 'hierarchy', but 9\.0 in section 'environment'\. It is one setting"
    with pytest.raises(ConfigError, match=message):
        TrainConfig.from_dict(record("point-flagrun", environment={"goal_distance": 9.0}))


@pytest.mark.parametrize("env", ["point-gather", "point-flagrun", "robotics-ant-maze"])
def test_a_configuration_can_be_pickled_and_copied(env):
    config = TrainConfig.of(env=env, hidden=(16, 8), optimizer="sgd", momentum=0.5)
    arrived = pickle.loads(pickle.dumps(config))  # noqa: S301 - our own bytes
    assert arrived == copy.deepcopy(config) == config


def test_settings_cannot_be_changed():
    with pytest.raises(AttributeError, match="settings cannot be changed"):
        make().evolution = None
    with pytest.raises(AttributeError):
        make().evolution.sigma = 1.0


def test_workers_are_all_cores_unless_said(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    assert WorkerSettings().count == 3
    assert WorkerSettings(num_workers=2).count == 2


# Options of tasks and bodies from outside.


@dataclass(frozen=True, kw_only=True)
class CornerOptions(TaskOptions):
    """Options of a task of a user's own."""

    corner_m: Annotated[float, Gt(1)] = 2.0
    """Where the corner is."""


class OwnCorner(own_classes.Corner):
    Options: ClassVar[type[CornerOptions]] = CornerOptions


@dataclass(frozen=True, kw_only=True)
class HeavyOptions(Settings):
    """Options of a body of a user's own."""

    load_kg: Annotated[float, Gt(0)] = 1.0
    """What it carries."""


class HeavyPoint(Point):
    Options: ClassVar[type[HeavyOptions]] = HeavyOptions


def test_a_task_and_a_body_from_outside_bring_their_own_settings(monkeypatch, tmp_path):
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(HeavyPoint, OwnCorner))
    monkeypatch.setattr("shes.envs.gymnasium_ids.SPECS_OF", {})
    register_ids("point-corner", OwnCorner.specs)
    own = {"corner_m": 3.0, "load_kg": 5.0}
    run = shes.train("point-corner", out=tmp_path / "run", **{**runs.TINY, "generations": 1}, **own)
    kept = json.loads((run.path / "config.json").read_text())["config"]
    assert (kept["environment"]["corner_m"], kept["body"]) == (3.0, {"load_kg": 5.0})
    assert run.config.numbers().items() >= own.items()
    task = build_task(run.config, 1, is_evaluation=True)
    assert (task.options.corner_m, task.body.options.load_kg) == (3.0, 5.0)
    with pytest.raises(ConfigError, match=r"corner_m must be a number greater than 1, got 0\.5\. Set --corner-m\."):
        make_config("point-corner", "smoke", {"corner_m": 0.5})
    with pytest.raises(ConfigError, match=r"corner_m is not a setting of a run of point-gather with algorithm 'shes'"):
        make_config("point-gather", "smoke", {"corner_m": 2.0})
    env = gymnasium.make("shes/PointCorner-v0", **own).unwrapped
    assert (env.task.options.corner_m, env.task.body.options.load_kg) == (3.0, 5.0)
    gymnasium.registry.pop("shes/PointCorner-v0")


@dataclass(frozen=True, kw_only=True)
class PushOptions(TaskOptions):
    """Options of a task, of which one has the name of a setting of the algorithm."""

    sigma: Annotated[float, Gt(0)] = 3.0


@dataclass(frozen=True, kw_only=True)
class SlowOptions(TaskOptions):
    """Options of a task that shares a setting, but not its default."""

    controller_interval: Annotated[int, Gt(0), Shared()] = 10


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            PushOptions,
            r"'sigma' is a setting of section 'evolution' .* of section 'environment' .*PushOptions.*other name",
        ),
        (
            SlowOptions,
            r"'controller_interval' is .*'hierarchy' \(default 25\).*default 10, .*Give both the same default",
        ),
    ],
)
def test_a_task_has_no_option_with_the_name_of_another_setting(monkeypatch, options, message):
    task = type("OwnTask", (own_classes.Corner,), {"Options": options})
    monkeypatch.setitem(ENVIRONMENTS, "point-mypush", Environment(Point, task))
    with pytest.raises(ConfigError, match=message):
        make_config("point-mypush", "smoke", {})


# Schedules.

KINDS_OF_SCHEDULE = [name for name in known_settings()["sigma_schedule"].choices if name != "constant"]
ENDS = ["episodes_end", "learning_rate_end", "sigma_end"]


@pytest.mark.parametrize(("quantity", "fields_of"), SCHEDULED.items())
@pytest.mark.parametrize("how", KINDS_OF_SCHEDULE)
def test_a_schedule_and_its_end_belong_together(quantity, fields_of, how):
    kind, end = fields_of
    config = make(**{kind: how, end: 2})
    assert (config.values[kind], config.values[end]) == (how, 2)
    with pytest.raises(ConfigError, match=rf"{kind} is '{how}', but {end} is not set\. Set {flag(end)}\."):
        make(**{kind: how})
    message = rf"{end} is 2(\.0)?, but {quantity} is constant\. Set {flag(kind)} to linear, .*omit {flag(end)}"
    with pytest.raises(ConfigError, match=message):
        make(**{end: 2})


@pytest.mark.parametrize("name", ENDS)
@pytest.mark.parametrize("wrong", [0, -1, "1", True, float("nan")])
def test_the_end_of_a_schedule_is_as_good_a_value_as_its_start(name, wrong):
    if name == "learning_rate_end" and wrong == 0:
        return  # see below
    schedule = next(kind for kind, end in SCHEDULED.values() if end == name)
    with pytest.raises(ConfigError, match=rf"{name} must be (a|zero or a) .*, got {wrong!r}\. Set {flag(name)}\."):
        make(**{schedule: "linear", name: wrong})


@pytest.mark.parametrize("how", KINDS_OF_SCHEDULE)
def test_a_learning_rate_may_fall_to_zero_where_a_schedule_reaches_it(how):
    settings = {"learning_rate_schedule": how, "learning_rate_end": 0}
    if how == "exponential":
        with pytest.raises(ConfigError, match="the end of the exponential schedule of learning_rate must be positive"):
            make(**settings)
    else:
        assert make(**settings).schedules.learning_rate_end == 0


# Levels, and what concerns one that is not there.


@pytest.mark.parametrize(
    ("env", "settings", "names", "learning"),
    [
        ("point-gather", {}, ("controller", "primitive"), (True, True)),
        ("point-gather", {"algorithm": "es"}, ("policy",), (True,)),
        ("point-flagrun", {}, ("primitive",), (True,)),
        ("ant-flagrun", {"algorithm": "es"}, ("policy",), (True,)),
        ("point-gather", {"primitive": "run"}, ("controller", "primitive"), (True, False)),
        ("point-gather", {"primitive": "run", "freeze_primitive": False}, ("controller", "primitive"), (True, True)),
        ("robotics-ant-maze", {}, ("controller", "primitive"), (True, True)),
        ("robotics-ant-maze", {"algorithm": "es"}, ("policy",), (True,)),
    ],
)
def test_the_settings_say_which_levels_there_are_and_which_learn(env, settings, names, learning):
    config = TrainConfig.of(env=env, **settings)
    assert (config.level_names, learns(config)) == (names, learning)


@pytest.mark.parametrize("level", ["primitive", "controller"])
@pytest.mark.parametrize("wrong", ["", 3, True])
def test_a_transferred_level_is_the_path_of_a_run(level, wrong):
    with pytest.raises(
        ConfigError, match=rf"{level} must be a name, e\.g\. --{level} .*, got {wrong!r}\. Set --{level}"
    ):
        make(**{level: wrong})


def test_a_primitive_alone_goes_on_from_another_one_only_if_it_learns():
    assert learns(TrainConfig.of(env="point-flagrun", primitive="run", freeze_primitive=False)) == (True,)
    message = r"the primitive 'run' is frozen, so nothing would learn in a run of point-flagrun\. Set --no-fr"
    with pytest.raises(ConfigError, match=message):
        TrainConfig.of(env="point-flagrun", primitive="run")


@pytest.mark.parametrize(("mirrored", "size"), [("quad", 2), ("pair", 2), ("none", 1)])
def test_a_frozen_primitive_asks_for_groups_of_one_level(mirrored, size):
    assert make(primitive="run", population_size=size, mirrored=mirrored).evolution.population_size == size
    if mirrored == "quad":
        with pytest.raises(ConfigError, match="population_size must be a positive multiple of 4"):
            make(primitive="run", freeze_primitive=False, population_size=size, mirrored=mirrored)


OF_CONTROLLERS = {
    "controller": "run",
    "controller_output": "one_hot",
    "controller_view": "egocentric",
    "controller_weight_decay": 0.1,
    "minimum_goal_distance": False,
    "primitive_hidden": (8,),
    "perturbation": "one_to_many",
    "primitive_learning_rate": 0.1,
    "primitive_population_size": 8,
    "primitive_sigma": 0.1,
}
OF_PRIMITIVES = {
    **OF_CONTROLLERS,
    "controller_interval": 5,
    "goal_distance": 2.0,
    "goal_encoding": "vector",
    "hide_position": True,
    "fall_price": 2.0,
    "freeze_primitive": False,
    "intervals": 3,
    "primitive": "run",
    "primitive_checkpoint": "last",
    "primitive_estimate": "interval",
    "primitive_fitness_shaping": "z_score",
    "primitive_reward": "cosine",
    "primitive_view": "proprioception",
    "symmetry": "dihedral",
}
UNHEEDED = [
    *(("point-flagrun", "shes", name) for name in (*OF_CONTROLLERS, "explore")),
    *(("point-gather", "es", name) for name in OF_PRIMITIVES),
    *(pytest.param("robotics-ant-maze", "es", name, marks=pytest.mark.extras) for name in OF_PRIMITIVES),
    *(("point-flagrun", "es", name) for name in OF_PRIMITIVES if name not in ("controller_interval", "goal_distance")),
    *(("point-gather", "shes", name) for name in ("target", "observe_block", "target_sampling")),
    *(("point-maze", "shes", name) for name in ("fall_penalty", "observe_block")),
]


@pytest.mark.parametrize(("env", "algorithm", "name"), UNHEEDED)
def test_what_would_do_nothing_is_no_setting_of_the_run(env, algorithm, name):
    message = rf"{name} is not a setting of a run of {env} with algorithm '{algorithm}', got .*\. Omit {flag(name)}\."
    with pytest.raises(ConfigError, match=message):
        make_config(env, "smoke", {"algorithm": algorithm, name: OF_PRIMITIVES.get(name, "ns")})


@pytest.mark.parametrize("name", ["controller_interval", "goal_distance"])
@pytest.mark.parametrize("algorithm", ["shes", "es"])
def test_a_random_controller_heeds_interval_and_distance(algorithm, name):
    config = make_config("point-flagrun", "smoke", {"algorithm": algorithm, name: OF_PRIMITIVES[name]})
    assert getattr(config.environment, name) == config.values[name] == OF_PRIMITIVES[name]
    assert TrainConfig.from_dict(config.to_dict()) == config


@pytest.mark.parametrize(
    ("level", "name", "value"),
    [
        ("primitive", "freeze_primitive", False),
        ("primitive", "freeze_primitive", True),
        ("primitive", "primitive_checkpoint", "last"),
        ("controller", "controller_checkpoint", "last"),
    ],
)
def test_what_concerns_a_transferred_level_needs_one(level, name, value):
    message = rf"{name} has no effect with {level} None, got {value!r}\. Set --{level}, or omit {flag(name)}\."
    with pytest.raises(ConfigError, match=message):
        make_config("point-gather", "smoke", {name: value})


@pytest.mark.parametrize("preset", ["paper", "laptop", "smoke"])
def test_a_preset_may_hold_what_does_nothing_here(preset):
    """Only what somebody asked for is refused."""
    for settings in ({"algorithm": "es"}, {}):
        assert make_config("point-flagrun", preset, settings).run.preset == preset


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"fitness_shaping": "pair_rank"},
            r"ranks mirrored pairs, but with mirrored 'quad' a group has 4 member",
        ),
        (
            {"fitness_shaping": "pair_rank", "mirrored": "none"},
            r"'none' a group has 1 member.*--mirrored pair",
        ),
        (
            {"symmetry": "rotation"},
            r"'rotation', but the primitive's view is 'observation'.*Set --primitive-v",
        ),
        (
            {"primitive_estimate": "interval"},
            r"but the primitive sees the task's observation.*egocentric or ",
        ),
        (
            {"primitive_estimate": "interval", "primitive_view": "egocentric", "primitive_population_size": 3},
            r"primitive_population_size must be an even number: branches are mirrored pairs, got 3\.",
        ),
    ],
)
def test_an_estimate_that_cannot_be_made_is_refused(settings, message):
    with pytest.raises(ConfigError, match=message):
        make(**settings)


def test_an_external_environment_cannot_be_branched():
    with pytest.raises(
        ConfigError, match=r"the physics of gymnasium:shes/PointMaze-v0 is its own and cannot be branched"
    ):
        make_config("gymnasium:shes/PointMaze-v0", "smoke", {"primitive_estimate": "interval"})


@pytest.mark.parametrize(
    ("env", "settings", "message"),
    [
        (
            "point-gather",
            {"primitive_view": "egocentric", "symmetry": "rotation"},
            "the point of .* has no known symmetry",
        ),
        (
            "point-gather",
            {"primitive_view": "egocentric", "hide_position": True},
            "egocentric view contains no absolute",
        ),
    ],
)
def test_a_robot_that_cannot_be_seen_so_is_refused(env, settings, message):
    with pytest.raises(ConfigError, match=message):
        build_algorithm(make_config(env, "smoke", settings))
