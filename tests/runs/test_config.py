"""Settings of a run: sections, one value for each name, JSON that gives them back; those without effect are refused."""

import copy
import json
import pickle
from dataclasses import make_dataclass
from pathlib import Path
from typing import Annotated

import gymnasium
import pytest

import shes
from shes.envs.bodies.point import Point
from shes.envs.gymnasium_ids import register_ids
from shes.envs.named_environments import ENVIRONMENTS, Environment
from shes.envs.tasks.task import TaskOptions
from shes.errors import ConfigError, RunFolderError, ShapeError, UnknownNameError
from shes.runs.build import build_algorithm, build_options
from shes.runs.config import TrainConfig, WorkerSettings
from shes.runs.make_config import make_config
from shes.runs.named_algorithms import PRESET_NAMES
from shes.settings import Gt, Settings, Shared
from tests.e2e import own_classes, runs
from tests.messages import raises

EXECUTION = {
    "preset": "paper", "backend": "serial", "num_workers": 3, "chunk_size": 7, "device": "cuda", "nconmax": 3,
    "njmax": 7, "deterministic": True, "generations": 5, "env_steps": 900, "minutes": 1.0, "keep_checkpoints": 2,
}  # fmt: skip
"""Settings that change no number, with values that are not their defaults."""


def make(**settings):
    return TrainConfig.of(env="point-gather", **settings)


def test_sections_are_those_of_the_algorithm():
    for env, algorithm, sections in (
        ("point-gather", "shes", "run workers evolution exploration networks hierarchy estimate transfer"),
        ("point-flagrun", "shes", "run workers evolution networks hierarchy estimate transfer"),
        ("point-gather", "es", "run workers evolution networks"),
    ):
        config = TrainConfig.of(env=env, algorithm=algorithm)
        expected = [*sections.split(), "environment", "episodes", "evaluation"]
        assert list(config.sections) == list(config.to_dict()) == expected


def test_settings_that_never_change_numbers_are_marked():
    numbers = make().numbers()
    assert numbers.keys() == make().values.keys() - EXECUTION.keys()
    assert make(**EXECUTION).numbers() == numbers
    assert make(seed=2).numbers() != numbers


def test_a_run_has_at_most_as_many_settings_as_can_be_read():
    assert len(TrainConfig.of(env="ant-gather").values) <= 65


BRANCHES = {"primitive_estimate": "interval", "primitive_view": "egocentric"}
SEARCHED = {"explore": "archive", "primitive_view": "egocentric"}
REFUSED = [
    # Environment; settings beyond those of `smoke`; the message.
    ("point-gather", {"workers": 4}, "unknown setting 'workers'. Did you mean 'num_workers'?"),
    ("point-gather", {"qqq": 1}, "unknown setting 'qqq'. `shes train ENV --help-all` lists the settings."),
    (3, {}, "env must be a name, got 3. Set --env"),
    ("point-gather", {"mirrored": "trio"}, "unknown mirroring 'trio'. Known: none, pair, quad. Set --mirrored"),
    ("point-gather", {"primitive_reward": "pow", "exponent": 2}, "primitive reward 'pow'. ... --import MODULE."),
    ("point-gather", {"algorithm": "hero"}, "algorithm 'hero'. Did you mean 'hiro' ... shes.register_algorithm"),
    ("point-gather", {"population_size": 18}, "must be a positive multiple of 4, ... got 18. Set ... -size 16 or 20"),
    ("point-gather", {"fitness_shaping": "pair_rank"}, "with mirrored 'quad' a group has 4 member"),
    ("point-gather", {"symmetry": "rotation"}, "'rotation', but the primitive's view is ... Set --primitive-v"),
    ("point-gather", {"primitive_estimate": "interval"}, "but the primitive sees the task's ... egocentric or "),
    ("point-gather", {**BRANCHES, "primitive_population_size": 3}, "must be an even number: ... mirrored pairs, got 3"),
    ("ant-flagrun", {"primitive": "ant-walker"}, "is frozen, so nothing ... of ant-flagrun. Set --no-freeze"),
    ("point-gather", {"controller": ""}, "controller must be a name, e.g. --controller runs/walk, got ''. Set --contr"),
    ("gymnasium:Pendulum-v1", {"device": "cuda"}, "'cuda', but gymnasium:P ... has physics ... Set --device cpu"),
    ("ant-maze", {"preset": "paper", "algorithm": "hiro"}, "is for algorithm shes or es, got ... Set --preset laptop"),
    ("ant-maze", {"preset": "papr"}, "unknown preset 'papr'. Did you mean 'paper'? ... Set --preset"),
    # Like another run.
    (None, {"like": "gone"}, "gone does not exist. Give the folder that `shes train` printed"),
    (None, {"like": "ant-maze", "algorithm": "es"}, "fall_price is 8.0 in ant-maze, but it is not a setting"),
    (None, {"like": "ant-walker"}, "took its primitive from fifth-walker@last, ... --primitive ant-walker, or set"),
    (None, {"like": 3}, "a run must be the path of its folder or the name of a shipped agent, got 3."),
    ("point-maze", {"like": "ant-maze"}, "does not fit point-maze: it was trained on ant-flagrun for the ant"),
    ("ant-gather", {"like": "ant-maze", "sigm": 1}, "unknown setting 'sigm'. Did you mean 'sigma'"),
    ("ant-gather", {"like": "ant-maze", "preset": "smoke"}, "preset has no effect with like, got 'smoke'. Omit --p"),
    # Search for a way.
    ("point-gather", SEARCHED, "point-gather has no target with a way ... only this package's Maze ... --explore none"),
    ("gymnasium:Pendulum-v1", SEARCHED, "Pendulum-v1 has no target with a way ... Set --explore none"),
    ("point-flagrun", {"explore": "archive"}, "explore is not a setting of a run of point-flagrun ... Omit"),
    ("point-maze", SEARCHED, "the training target is random. Set --target, e.g. --target 0 16, or --explore none"),
    ("point-push", {**SEARCHED, "horizon": 24}, "horizon must be at least controller_interval, 25 ... , got 24. Set"),
    ("point-push", {**SEARCHED, "explore_horizon": 9}, "must be at least controller_interval, 25 ... , got 9. Set"),
    ("point-push", {"explore": "archive", "primitive_view": "observation"},
     "sees the task's ... Set --primitive-view egocentric or p"),
]  # fmt: skip


@pytest.mark.parametrize(("env", "settings", "message"), REFUSED, ids=str)
def test_settings_that_no_run_can_have_are_refused(env, settings, message):
    preset = settings.get("preset", None if "like" in settings else "smoke")
    with raises((ConfigError, UnknownNameError, RunFolderError), message):
        make_config(env, preset, {name: value for name, value in settings.items() if name != "preset"})


@pytest.mark.parametrize("env", ["point-gather", "point-flagrun", "robotics-ant-maze"])
def test_a_configuration_can_be_recorded_pickled_and_copied(env):
    config = TrainConfig.of(env=env, hidden=(16, 8), sigma=0.1 + 0.2, minutes=1.5, seed=2**62, biases="glorot_normal")
    assert (config.to_dict()["networks"]["hidden"], config.numbers()["hidden"]) == ([16, 8], [16, 8])
    kept = json.loads(json.dumps(config.to_dict()))
    arrived = pickle.loads(pickle.dumps(config))  # noqa: S301 - our own bytes
    assert TrainConfig.from_dict(kept) == arrived == copy.deepcopy(config) == config
    assert arrived.run.seed == 2**62
    for target, name in ((config, "run"), (config.evolution, "sigma")):
        with pytest.raises(AttributeError):
            setattr(target, name, 1)


def test_no_layers_are_not_the_same_as_none():
    """A primitive of its own layers may have none of them; without any it has those of the controller."""
    for config, layers in ((make(hidden=(3,), primitive_hidden=()), ()), (make(hidden=(3,)), (3,))):
        algorithm = build_algorithm(TrainConfig.from_dict(json.loads(json.dumps(config.to_dict()))))
        assert [policy.sizes[1:-1] for policy in algorithm.design.policies] == [(3,), layers]


def test_what_is_newer_than_a_record_has_its_default():
    record = make().to_dict()
    del record["exploration"], record["workers"]["chunk_size"]
    assert TrainConfig.from_dict(record) == make()


def test_workers_are_all_cores_unless_said(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    assert (WorkerSettings().count, WorkerSettings(num_workers=2).count) == (3, 2)


def options_of(base, **fields):
    """Return settings of these fields: name=(type, default)."""
    found = [(name, *each) for name, each in fields.items()]
    return make_dataclass(f"Own_{'_'.join(fields)}", found, bases=(base,), frozen=True, kw_only=True)


def test_a_task_and_a_body_from_outside_bring_their_own_settings(monkeypatch, tmp_path):
    task, body = (
        type("Own", (cls,), {"Options": options_of(base, **{name: (Annotated[float, Gt(1)], 2.0)})})
        for cls, base, name in ((own_classes.Corner, TaskOptions, "corner_m"), (Point, Settings, "load_kg"))
    )
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(body, task))
    monkeypatch.setattr("shes.envs.gymnasium_ids.SPECS_OF", {})
    register_ids("point-corner", task.specs)
    own = {"corner_m": 3.0, "load_kg": 5.0}
    config = make_config("point-corner", "smoke", own)
    assert TrainConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config
    assert config.to_dict()["body"] == {"load_kg": 5.0}
    assert config.numbers().items() >= own.items()
    env = gymnasium.make("shes/PointCorner-v0", **own).unwrapped
    gymnasium.registry.pop("shes/PointCorner-v0")
    plan = build_algorithm(config).plan()
    monkeypatch.delitem(ENVIRONMENTS, "point-corner")  # as in a worker process, which has the environment in its plan
    for each in (env.task, plan.env.make(1, plan.training)):
        assert type(each) is task
        assert (each.options.corner_m, each.body.options.load_kg) == (3.0, 5.0)


def test_observations_that_their_spec_does_not_name_are_refused(monkeypatch):
    shy = type("Shy", (own_classes.Corner,), {"observe": lambda self: own_classes.Corner.observe(self)[:, :-1]})
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(Point, shy))
    message = "'point-corner' must observe [N, 6], ... for 1 episode it observed (1, 5). Change observation_spec"
    with raises(ShapeError, message):
        build_algorithm(make_config("point-corner", "smoke"))


@pytest.mark.parametrize(
    ("name", "option", "message"),
    [
        (
            "sigma",
            (Annotated[float, Gt(0)], 3.0),
            "is a setting ... 'evolution' ... 'environment' ... Own ... other name",
        ),
        ("controller_interval", (Annotated[int, Shared()], 10), "default 25 ... default 10, ... both the same default"),
    ],
)
def test_a_task_has_no_option_with_the_name_of_another_setting(monkeypatch, name, option, message):
    task = type("OwnTask", (own_classes.Corner,), {"Options": options_of(TaskOptions, **{name: option})})
    monkeypatch.setitem(ENVIRONMENTS, "point-mypush", Environment(Point, task))
    with raises(ConfigError, f"'{name}' ... {message}"):
        make_config("point-mypush", "smoke", {})


# Presets: what they start from, by numbers written down by hand.

PAPER = {
    # SHES paper, Table I.
    "population_size": 1000, "episodes_per_policy": 5, "horizon": 500, "controller_interval": 25, "goal_distance": 4.0,
    "learning_rate": 0.01, "sigma_end": None, "learning_rate_end": None, "sigma": 0.02, "generations": 3000,
    # Where Table I is silent: the authors' code (docs/differences.md).
    "hidden": (256, 256, 256), "biases": "glorot_normal", "weight_decay": 0.005, "mirrored": "quad",
    "common_random_numbers": "off", "statistics_fraction": 0.01, "minimum_goal_distance": True,
    "goal_encoding": "angle", "controller_output": "vector", "perturbation": "many_to_many",
    "fitness_shaping": "centred_rank_index", "optimizer": "adam", "primitive_reward": "progress",
    # What makes the ant learn in the other presets is not the paper's (docs/learning.md).
    "primitive_view": "observation", "controller_view": "observation", "symmetry": "none", "clock_frequency": None,
    "primitive_estimate": "episode", "output_weights": "glorot_normal", "max_tilt": None,
    "explore": "none", "freeze_primitive": True, "reset_noise": 0.0, "evaluation_episodes": 10,
    "noise_table_size": 250_000_000,
}  # fmt: skip


@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_the_paper_preset_has_the_numbers_of_table_one(env):
    values = make_config(env, "paper").values
    expected = {**PAPER, "population_size": 256} if env in ("ant-flagrun", "point-flagrun") else PAPER
    shared = expected.keys() & values.keys()
    assert {name: values[name] for name in shared} == {name: expected[name] for name in shared}
    assert "flagrun" in env or expected.keys() - shared <= {"max_tilt"}


def test_the_paper_preset_evaluates_as_it_trains():
    config = make_config("ant-gather", "paper")
    assert config.evaluation_steps == 500
    for is_evaluation, noise in ((False, 0.0), (True, 0.1)):
        options = build_options(config, is_evaluation=is_evaluation)
        assert (options.integrator, options.reset_noise) == ("euler", noise)


@pytest.mark.parametrize("preset", [*PRESET_NAMES])
@pytest.mark.parametrize("env", ENVIRONMENTS)
def test_every_preset_suits_every_environment(env, preset):
    if "hiro" in preset and "flagrun" in env:
        with pytest.raises(ConfigError):
            make_config(env, preset)
        return
    config = make_config(env, preset)
    assert (config.run.env, config.run.preset) == (env, preset)
    if "hiro" not in preset:  # it may set what has no effect
        assert make_config(env, preset, {"algorithm": "es"}).run.preset == preset


def test_the_presets_of_hiro_have_the_published_numbers():
    config = make_config("ant-maze", "hiro-paper")
    published = {
        "hidden": (300, 300), "batch_size": 100, "replay_size": 200_000, "actor_learning_rate": 1e-4,
        "critic_learning_rate": 1e-3, "discount": 0.99, "target_rate": 0.005, "policy_delay": 2,
        "exploration_noise": 1.0, "goal_noise": 1.0, "noise_unit": "raw", "controller_interval": 10,
        "goal_distance": 10.0, "reward_scale": 0.1, "spec": "hiro", "horizon": 500, "env_steps": 10_000_000,
        "normalise_inputs": False, "bootstrap_terminal": False, "update_interval": 1,
        "controller_update_interval": 10, "warmup_steps": 2500, "evaluation_episodes": 50,
    }  # fmt: skip
    assert config.values.items() >= {**published, "algorithm": "hiro"}.items()
    assert make_config("ant-maze", "hiro-paper", {"algorithm": "td3"}).learner.hidden == (300, 300)
    assert config.learner.generation_steps * config.evaluation.evaluation_interval == 50_000
    assert make_config("point-maze", "hiro-paper").learner.exploration_noise == 0.1
    table = make_config("ant-maze", "hiro-table1")
    assert (table.learner.actor_learning_rate, table.environment.spec) == (0.001, "shes")
    assert table.learner.normalise_inputs  # the target in that observation is 100 times smaller than the position


@pytest.mark.extras
@pytest.mark.parametrize("preset", ["hiro-paper", "hiro-table1"])
def test_the_presets_of_hiro_fit_a_small_maze(preset):
    pytest.importorskip("gymnasium_robotics")
    config = make_config("robotics-point-maze", preset)
    assert (config.learner.exploration_noise, config.goals.goal_distance, config.goals.goal_noise) == (0.1, 1.0, 0.1)


def test_a_run_like_another_has_its_settings_but_not_its_seed(tmp_path):
    given = {"algorithm": "es", "sigma": 0.07, "seed": 9, "generations": 0 + 1, "integrator": "rk4"}
    run = shes.train("point-gather", out=tmp_path / "run", **runs.TINY | given)
    config = make_config(None, None, {"like": run})
    assert config.values == {**run.config.values, "seed": 1}
    more = make_config("point-maze", None, {"like": run.path, "seed": 4, "sigma": 0.08, "mirrored": "none"}).values
    changed = {"env": "point-maze", "seed": 4, "sigma": 0.08, "mirrored": "none"}
    assert {name: more[name] for name in run.config.values} == {**run.config.values, **changed}
    assert make_config("point-maze", None, {"algorithm": "es"}).values.items() >= {
        (name, more[name]) for name in more - run.config.values.keys()
    }


def test_what_a_run_like_a_shipped_agent_takes():
    assert make_config("ant-maze", None, {"like": "ant-gather"}).values["primitive"] == "ant-walker"
    for primitive in ("ant-walker", None):  # what the error below says to give instead
        values = make_config(None, None, {"like": "ant-walker", "primitive": primitive}).values
        assert (values["primitive"], values["freeze_primitive"]) == (primitive, False)


OF_INTERVALS = "is evaluated by intervals: it applies to whole episodes only; ... --primitive-estimate episode"
ON_WALKER = {"primitive": "ant-walker"}
FROZEN = "{name} has no effect on a frozen primitive; got {value}"
NO_SETTING = "{name} is not a setting of a run of %s with algorithm '%s', got {value}. Omit --{flag}."
ONE_PROCESS = "{name} is ... {value} ... , but one process serves device cuda. Omit --"
NO_BUFFERS = "{name} has no effect with device 'cpu', got {value}. Set --device to warp-cpu or cuda, or omit --{name}"
IDLE = [
    # Environment; a setting that has no effect, and others; the message; what helps.
    ("point-gather", {"schedule_generations": 50},
     "{name} has no effect with sigma_end None, learning_rate_end None, got 50 ... --sched", {"sigma_end": 0.01}),
    ("ant-gather", {"freeze_primitive": False},
     "{name} has no effect with primitive None, got False. Set --primitive, or omit --freeze-primitive", ON_WALKER),
    ("ant-maze", {"explore_horizon": 900, "explore": "none"},
     "{name} has no effect with explore 'none', got 900", {"explore": "archive"}),
    ("ant-gather", {"perturbation": "one_to_many"},
     "needs two levels evaluated by whole episodes; in this run only the controller is; got 'one_to_many'",
     {"primitive_estimate": "episode"}),
    ("ant-gather", {"perturbation": "one_to_many", **ON_WALKER},
     "--{name} needs two learning levels; in this run only the controller learns", None),
    *(("ant-flagrun", each, "{name} ... " + OF_INTERVALS, {"primitive_estimate": "episode"}) for each in (
        {"fitness_shaping": "centred_rank"}, {"mirrored": "none"}, {"episodes_per_policy": 5},
        {"common_random_numbers": "off"}, {"statistics_fraction": 0.0})),
    *(("ant-gather", {**each, **ON_WALKER}, FROZEN, {"freeze_primitive": False}) for each in (
        {"intervals": 5}, {"primitive_sigma": 0.3})),
    *(("gymnasium:shes/PointMaze-v0", each, "{name} has no effect on ... its own physics", None) for each in (
        {"reset_noise": 0.0}, {"spec": "shes"})),
    ("gymnasium:shes/PointMaze-v0", {"primitive_estimate": "interval"}, "... is its own and cannot be", None),
    ("point-gather", {"symmetry": "rotation", "primitive_view": "egocentric"}, "the point of ... has no known", None),
    ("point-flagrun", {"minimum_goal_distance": 3}, NO_SETTING % ("point-flagrun", "shes"), None),
    ("point-gather", {"primitive": 3, "algorithm": "es"}, NO_SETTING % ("point-gather", "es"), None),
    ("point-gather", {"target": 3}, NO_SETTING % ("point-gather", "shes"), None),
    *(("point-gather", each, NO_BUFFERS, {"device": "cuda"}) for each in (
        {"nconmax": 9}, {"njmax": 9}, {"deterministic": True})),
    ("flagrun", {"integrator": "rk4", "robot": str(Path(__file__).parents[2] / "examples/hexapod.xml")},
     "{name} has no effect on flagrun, ... got 'rk4'. Omit --integrator, and set it in the <option>", None),
    ("point-gather", {"backend": "processes", "device": "cuda"}, ONE_PROCESS + "backend", {"backend": "serial"}),
    *(("point-gather", {"num_workers": 4, "device": "cuda"}, ONE_PROCESS + "workers, or set --device cpu", helps)
      for helps in ({"num_workers": 1}, {"num_workers": 0})),
]  # fmt: skip


@pytest.mark.parametrize(("env", "settings", "message", "helps"), IDLE, ids=str)
def test_a_setting_without_effect_is_refused_with_what_helps(env, settings, message, helps):
    name, value = next(iter(settings.items()))
    with raises(ConfigError, message.format(name=name, value=value, flag=name.replace("_", "-"))):
        build_algorithm(make_config(env, "laptop", settings))
    if helps is not None:
        helped = {**settings, **helps}
        assert {name: make_config(env, "laptop", helped).values[name] for name in helped} == helped


def test_a_default_that_has_no_effect_may_be_given():
    assert make_config("point-gather", "smoke", {"nconmax": None, "deterministic": False})
