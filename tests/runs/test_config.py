"""Settings: every value is checked, and JSON gives back what it was given."""

import json
from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest

from shes.envs.bodies.point import Point
from shes.envs.registry import ENVIRONMENTS, Environment
from shes.errors import ConfigError, UnknownNameError
from shes.hierarchy.goals import GOAL_ENCODINGS
from shes.hierarchy.outputs import CONTROLLER_OUTPUTS, VectorOutput
from shes.hierarchy.rewards import PRIMITIVE_REWARDS
from shes.runs.config import EXECUTION_FIELDS, TrainConfig, check_fields
from shes.runs.settings import NAMES as WORDS
from shes.runs.settings import SCHEDULED, choices, flag
from shes.training.build import build_design, build_settings
from shes.training.presets import make_config
from tests.e2e import own_classes

WHOLE_NUMBERS = {
    "chunk_size": 0,
    "controller_interval": 1,
    "env_steps": 1,
    "episodes_per_policy": 1,
    "evaluation_episodes": 1,
    "evaluation_horizon": 1,
    "evaluation_interval": 1,
    "generations": 1,
    "horizon": 1,
    "intervals": 1,
    "keep_checkpoints": 1,
    "noise_table_size": 2,
    "novelty_neighbours": 1,
    "num_workers": 0,
    "schedule_generations": 1,
    "seed": 0,
}
POSITIVE = [
    "clock_frequency",
    "goal_distance",
    "learning_rate",
    "minutes",
    "primitive_learning_rate",
    "primitive_sigma",
    "sigma",
]
NOT_NEGATIVE = ["controller_weight_decay", "evaluation_reset_noise", "fall_price", "reset_noise", "weight_decay"]
SHARES = {
    "momentum": ("at least 0 and less than 1", [0, 0.99], [-0.1, 1]),
    "statistics_fraction": ("between 0 and 1", [0, 1], [-0.1, 1.1]),
    "top_fraction": ("more than 0 and less than 1", [0.01, 0.99], [0, 1]),
}
NAMES = [
    "algorithm",
    "backend",
    "biases",
    "common_random_numbers",
    "controller_output",
    "controller_view",
    "device",
    "fitness_shaping",
    "goal_encoding",
    "integrator",
    "mirrored",
    "novelty",
    "optimizer",
    "output_weights",
    "perturbation",
    "primitive_estimate",
    "primitive_fitness_shaping",
    "primitive_reward",
    "primitive_view",
    "rank_ties",
    "spec",
    "symmetry",
    "target_sampling",
    "weight_decay_form",
]
SCHEDULES = ["episodes_schedule", "learning_rate_schedule", "sigma_schedule"]
ENDS = ["episodes_end", "learning_rate_end", "sigma_end"]
SWITCHES = ["fall_penalty", "freeze_primitive", "hide_position", "hold_tied", "minimum_goal_distance", "observe_block"]
PLACES = ["evaluation_target", "target"]
BUFFERS = ["nconmax", "njmax"]
LAYERS = ["hidden", "primitive_hidden"]
OTHERS = [
    "controller",
    "controller_checkpoint",
    "env",
    "population_size",
    "preset",
    "primitive",
    "primitive_checkpoint",
    "primitive_population_size",
]
NUMBERS = [WHOLE_NUMBERS, POSITIVE, NOT_NEGATIVE, SHARES, BUFFERS]
KINDS = [*NUMBERS, NAMES, SCHEDULES, ENDS, SWITCHES, PLACES, LAYERS, OTHERS]


def make(**settings):
    return TrainConfig(env="point-gather", **settings)


def test_every_setting_is_checked_by_a_test_here():
    checked = [name for kind in KINDS for name in kind]
    assert sorted(checked) == sorted(field.name for field in fields(TrainConfig))


@pytest.mark.parametrize("name", WHOLE_NUMBERS)
def test_a_whole_number_has_a_least_value(name):
    least = WHOLE_NUMBERS[name]
    assert getattr(make(**{name: least}), name) == least
    for wrong in (least - 1, 1.5, 2.0, "3", True):
        message = rf"{name} must be a whole number of at least {least}, got {wrong!r}\. Set {flag(name)}\."
        with pytest.raises(ConfigError, match=message):
            make(**{name: wrong})


@pytest.mark.parametrize("name", POSITIVE)
@pytest.mark.parametrize("wrong", [0, -0.1, float("nan"), float("inf"), "1", True])
def test_a_positive_number_is_positive_and_finite(name, wrong):
    assert getattr(make(**{name: 2}), name) == 2
    with pytest.raises(ConfigError, match=rf"{name} must be a positive number, got {wrong!r}\. Set {flag(name)}\."):
        make(**{name: wrong})


@pytest.mark.parametrize("name", NOT_NEGATIVE)
@pytest.mark.parametrize("wrong", [-0.1, float("nan"), float("inf"), "1", True])
def test_a_number_that_may_be_zero_is_not_negative(name, wrong):
    assert getattr(make(**{name: 0}), name) == 0
    with pytest.raises(
        ConfigError, match=rf"{name} must be zero or a positive number, got {wrong!r}\. Set {flag(name)}"
    ):
        make(**{name: wrong})


@pytest.mark.parametrize("name", BUFFERS)
@pytest.mark.parametrize("wrong", [0, -1, 1.5, "3", True])
def test_a_buffer_holds_one_at_least(name, wrong):
    assert getattr(make(**{name: 1}), name) == 1
    message = rf"{name} must be a whole number of at least 1, got {wrong!r}\. Set {flag(name)}\."
    with pytest.raises(ConfigError, match=message):
        make(**{name: wrong})


OPTIONAL = [
    "clock_frequency",
    "controller_weight_decay",
    "env_steps",
    "evaluation_horizon",
    "minutes",
    "observe_block",
    "primitive",
]


@pytest.mark.parametrize("name", [*OPTIONAL, *ENDS, *PLACES, *BUFFERS, "primitive_hidden"])
def test_what_may_be_none_is_none_unless_said(name):
    assert getattr(make(), name) is None
    assert getattr(make(**{name: None}), name) is None


@pytest.mark.parametrize("name", ["sigma", "reset_noise", "horizon", "momentum", "hidden", "novelty", "rank_ties"])
def test_what_must_be_said_is_never_none(name):
    with pytest.raises(ConfigError, match=rf"{name} must be .*, got None\. Set {flag(name)}"):
        make(**{name: None})


@pytest.mark.parametrize("name", SHARES)
def test_a_share_lies_between_its_bounds(name):
    allowed, right, wrong = SHARES[name]
    for value in right:
        assert getattr(make(**{name: value}), name) == value
    for value in (*wrong, float("nan"), "all", True):
        with pytest.raises(ConfigError, match=rf"{name} must be {allowed}, got {value!r}\. Set {flag(name)}\."):
            make(**{name: value})


@pytest.mark.parametrize("name", SWITCHES)
def test_a_switch_is_true_or_false(name):
    with pytest.raises(ConfigError, match=rf"{name} must be true or false, got 1\. Set {flag(name)}"):
        make(**{name: 1})


@pytest.mark.parametrize("name", PLACES)
def test_a_place_is_finite_coordinates_or_none(name):
    assert getattr(make(), name) is None
    assert getattr(make(**{name: [0, 16.5]}), name) == (0, 16.5)
    for wrong in (3.0, (), (0, float("nan")), ("0", "16"), (True, 0), "home"):
        with pytest.raises(ConfigError, match=rf"{name} must be coordinates in metres, e\.g\. {flag(name)} 0 16, got"):
            make(**{name: wrong})


@pytest.mark.parametrize("name", NAMES)
def test_a_name_must_be_known(name):
    right = {"algorithm": "shes", "novelty": "nsra_reset"}.get(name, getattr(make(), name))
    wrong = right[:-1]
    message = rf"unknown {name.replace('_', ' ')} '{wrong}'\. Did you mean '{right}'\? Known: .*Set {flag(name)}\."
    with pytest.raises(UnknownNameError, match=message):
        make(**{name: wrong})


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
    assert TrainConfig.from_dict(TrainConfig(**names).to_dict()).to_dict().items() >= names.items()
    for name, right in names.items():
        with pytest.raises(UnknownNameError, match=f"Did you mean '{right}'"):
            TrainConfig(**{**names, name: right[:-1]})


@pytest.mark.parametrize("name", SCHEDULES)
def test_a_schedule_must_be_known(name):
    with pytest.raises(UnknownNameError, match=rf"unknown {name.replace('_', ' ')} 'linea'\. Did you mean 'linear'"):
        make(**{name: "linea"})


@pytest.mark.parametrize("name", LAYERS)
@pytest.mark.parametrize("wrong", [(0,), (8, -1), (8.5,), ("8",), (True,), 8, "8 8"])
def test_hidden_layers_are_positive_whole_numbers(name, wrong):
    with pytest.raises(
        ConfigError,
        match=rf"{name} must be positive whole numbers, e\.g\. {flag(name)} 64 64, got .*Set {flag(name)}\.",
    ):
        make(**{name: wrong})


@pytest.mark.parametrize("name", LAYERS)
def test_no_hidden_layer_is_allowed(name):
    assert getattr(make(**{name: ()}), name) == ()


@pytest.mark.parametrize(("mirrored", "wrong", "nearest"), [("quad", 18, "16 or 20"), ("pair", 7, "6 or 8")])
def test_the_population_is_a_multiple_of_its_groups(mirrored, wrong, nearest):
    with pytest.raises(ConfigError, match=rf"population_size must be a positive multiple .*got {wrong}\. .*{nearest}"):
        make(population_size=wrong, mirrored=mirrored)


def test_a_seed_fits_a_checkpoint():
    assert make(seed=2**63 - 1).seed == 2**63 - 1
    with pytest.raises(ConfigError, match=r"seed must be less than 2\*\*63, got 9223372036854775808\. Set --seed"):
        make(seed=2**63)


def test_an_environment_is_known_and_needed():
    with pytest.raises(UnknownNameError, match=r"unknown environment 'ant-gathr'\. Did you mean 'ant-gather'\?"):
        TrainConfig(env="ant-gathr")
    with pytest.raises(ConfigError, match=r"names no environment \(key 'env'\)"):
        TrainConfig.from_dict({"seed": 1})


def test_json_gives_back_the_same_settings():
    config = make(hidden=(16, 8), sigma=0.1 + 0.2, minutes=1.5, seed=2**62)
    assert TrainConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config


def test_numbers_of_numpy_become_numbers_of_python():
    config = make(seed=np.int64(3), sigma=np.float32(0.5), hidden=[np.int32(4)], hide_position=np.bool_(True))
    assert config == make(seed=3, sigma=0.5, hidden=(4,), hide_position=True)
    assert json.loads(json.dumps(config.to_dict()))["hidden"] == [4]
    assert type(config.sigma) is float


def test_an_unknown_key_is_an_error_that_names_the_nearest():
    with pytest.raises(
        ConfigError, match=r"unknown setting 'sigmma'\. Did you mean 'sigma'\? Settings: env, algorithm, "
    ):
        TrainConfig.from_dict({"env": "point-gather", "sigmma": 1})
    with pytest.raises(ConfigError, match=r"unknown setting 'qqq'\. Settings: "):
        check_fields({"qqq": 1})


def test_numbers_are_the_settings_that_change_numbers():
    numbers = make().numbers()
    assert set(numbers) == {field.name for field in fields(TrainConfig)} - EXECUTION_FIELDS
    execution = {"generations": 5, "env_steps": 900, "minutes": 1.0, "keep_checkpoints": 2}
    other = make(num_workers=3, chunk_size=7, backend="serial", **execution)
    assert other.numbers() == numbers
    other = make(device="cuda", nconmax=3, njmax=7)
    assert other.numbers() == numbers
    assert make(seed=2).numbers() != numbers


def test_settings_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        make().sigma = 1.0


def test_workers_are_all_cores_unless_said(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    assert make().workers == 3
    assert make(num_workers=2).workers == 2


def test_flags_are_the_fields_with_dashes():
    assert flag("population_size") == "--population-size"
    assert flag("num_workers") == "--workers"


@pytest.mark.parametrize("name", [*NAMES, *SCHEDULES])
def test_every_choice_of_a_name_is_allowed(name):
    """Where it needs another setting beside it, it says so and is not unknown."""
    ends = {kind: {end: 1} for kind, end in SCHEDULED.values()}.get(name, {})
    beside = {
        "pair_rank": {"mirrored": "pair"} if name == "fitness_shaping" else {},
        "interval": {"primitive_view": "egocentric"},
        "rotation": {"primitive_view": "egocentric"},
        "dihedral": {"primitive_view": "egocentric"},
    }
    for choice in choices(name):
        settings = {} if choice == "constant" else ends or beside.get(choice, {})
        assert getattr(make(population_size=8, **{name: choice}, **settings), name) == choice
    assert choices("env") == ()
    assert set(NAMES) | set(SCHEDULES) == set(WORDS) - {"preset", "controller_checkpoint", "primitive_checkpoint"}


@pytest.mark.parametrize(
    "name", ["preset", "controller_checkpoint", "primitive_checkpoint", "novelty", "goal_encoding"]
)
def test_a_name_is_a_string(name):
    with pytest.raises(ConfigError, match=rf"{name} must be a name, got 3\. Set {flag(name)}\."):
        make(**{name: 3})


# Schedules.

KINDS_OF_SCHEDULE = [name for name in choices("sigma_schedule") if name != "constant"]


@pytest.mark.parametrize(("quantity", "fields_of"), SCHEDULED.items())
@pytest.mark.parametrize("how", KINDS_OF_SCHEDULE)
def test_a_schedule_and_its_end_belong_together(quantity, fields_of, how):
    kind, end = fields_of
    config = make(**{kind: how, end: 2})
    assert (getattr(config, kind), getattr(config, end)) == (how, 2)
    with pytest.raises(ConfigError, match=rf"{kind} is '{how}', but nothing says where to\. Set {flag(end)}\."):
        make(**{kind: how})
    message = rf"{end} is 2, but {quantity} is constant\. Set {flag(kind)} to linear, .*leave {flag(end)} away"
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
        assert make(**settings).learning_rate_end == 0


def test_what_the_episodes_schedule_is_set_by_is_a_flag_that_there_is():
    config = make(episodes_schedule="linear", episodes_end=5)
    assert flag(f"{build_settings(config).episodes_per_policy.quantity}_schedule") == "--episodes-schedule"


# Levels, and what concerns one that is not there.


@pytest.mark.parametrize(
    ("env", "settings", "names", "learns"),
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
def test_the_settings_say_which_levels_there_are_and_which_learn(env, settings, names, learns):
    config = TrainConfig(env=env, **settings)
    assert (config.level_names, config.learns) == (names, learns)


@pytest.mark.parametrize("wrong", ["", 3, True])
def test_a_primitive_is_the_path_of_a_run(wrong):
    with pytest.raises(ConfigError, match=rf"primitive must be the path of a run folder, got {wrong!r}\. Set --prim"):
        make(primitive=wrong)


@pytest.mark.parametrize("env", ["point-gather", "point-flagrun"])
def test_a_primitive_needs_a_level_of_that_kind(env):
    message = rf"primitive is 'run', but a run of {env} with algorithm 'es' has the levels policy alone"
    with pytest.raises(ConfigError, match=message + r".*Leave --primitive away, or name another environment"):
        TrainConfig(env=env, algorithm="es", primitive="run")


def test_a_primitive_alone_goes_on_from_another_one_only_if_it_learns():
    assert TrainConfig(env="point-flagrun", primitive="run", freeze_primitive=False).learns == (True,)
    with pytest.raises(
        ConfigError, match=r"a run of point-flagrun has nothing else that learns.*--no-freeze-primitive"
    ):
        TrainConfig(env="point-flagrun", primitive="run")


def test_novelty_is_not_for_a_primitive_alone():
    with pytest.raises(ConfigError, match=r"novelty is 'ns', but .*point-flagrun trains a primitive.*Leave --novelty"):
        TrainConfig(env="point-flagrun", novelty="ns")
    assert TrainConfig(env="point-flagrun", algorithm="es", novelty="ns").novelty == "ns"


@pytest.mark.parametrize(("mirrored", "size"), [("quad", 2), ("pair", 2), ("none", 1)])
def test_a_frozen_primitive_asks_for_groups_of_one_level(mirrored, size):
    assert make(primitive="run", population_size=size, mirrored=mirrored).population_size == size
    if mirrored == "quad":
        with pytest.raises(ConfigError, match="population_size must be a positive multiple of 4"):
            make(primitive="run", freeze_primitive=False, population_size=size, mirrored=mirrored)


OF_CONTROLLERS = {
    "controller_output": "one_hot",
    "controller_view": "egocentric",
    "controller_weight_decay": 0.1,
    "minimum_goal_distance": False,
    "primitive_hidden": (8,),
}
OF_PRIMITIVES = {
    **OF_CONTROLLERS,
    "controller_interval": 5,
    "goal_distance": 2.0,
    "goal_encoding": "vector",
    "hide_position": True,
    "fall_price": 2.0,
    "primitive_estimate": "interval",
    "primitive_reward": "cosine",
    "primitive_view": "proprioception",
}
UNHEEDED = [
    *(("point-flagrun", "shes", "primitive", name) for name in OF_CONTROLLERS),
    *(("point-gather", "es", "policy", name) for name in OF_PRIMITIVES),
    *(("robotics-ant-maze", "es", "policy", name) for name in OF_PRIMITIVES),
    *(("point-flagrun", "es", "policy", n) for n in OF_PRIMITIVES if n not in ("controller_interval", "goal_distance")),
]


@pytest.mark.parametrize(("env", "algorithm", "level", "name"), UNHEEDED)
def test_what_would_do_nothing_is_refused(env, algorithm, level, name):
    settings = {"algorithm": algorithm, name: OF_PRIMITIVES[name]}
    message = (
        rf"{name} does nothing in a run of {env} with algorithm '{algorithm}', whose one level is the {level}; got "
    )
    with pytest.raises(ConfigError, match=message + rf".*Leave {flag(name)} away\."):
        make_config(env, "smoke", settings)


@pytest.mark.parametrize("name", ["controller_interval", "goal_distance"])
@pytest.mark.parametrize("algorithm", ["shes", "es"])
def test_a_random_controller_heeds_interval_and_distance(algorithm, name):
    config = make_config("point-flagrun", "smoke", {"algorithm": algorithm, name: OF_PRIMITIVES[name]})
    assert getattr(config, name) == OF_PRIMITIVES[name]


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
    message = rf"{name} is {value!r}, but no run is named whose {level} it would be\. Set --{level} RUN, or leave "
    with pytest.raises(ConfigError, match=message + flag(name)):
        make_config("point-gather", "smoke", {name: value})


@pytest.mark.parametrize("preset", ["paper", "laptop", "smoke"])
def test_a_preset_may_hold_what_does_nothing_here(preset):
    """Only what somebody asked for is refused."""
    for settings in ({"algorithm": "es"}, {}):
        assert make_config("point-flagrun", preset, settings).preset == preset


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
            "what symmetry the point of",
        ),
        (
            "point-gather",
            {"primitive_view": "egocentric", "hide_position": True},
            "egocentric view shows no absolute",
        ),
    ],
)
def test_a_robot_that_cannot_be_seen_so_is_refused(env, settings, message):
    with pytest.raises(ConfigError, match=message):
        build_design(make_config(env, "smoke", settings))


# What version 0.1 wrote.


@pytest.mark.parametrize(("former", "today"), [(True, "group"), (False, "off")])
def test_settings_of_the_first_version_are_read_in_words_of_today(former, today):
    new = {"algorithm", "novelty", "primitive", "sigma_schedule", "optimizer", "clock_frequency"}
    old = {name: value for name, value in make(sigma=0.5).to_dict().items() if name not in new}
    config = TrainConfig.from_dict({**old, "common_random_numbers": former})
    assert config == make(sigma=0.5, common_random_numbers=today)


def test_runs_of_before_tied_levels_were_held_do_not_hold_them():
    old = {name: value for name, value in make().to_dict().items() if name != "hold_tied"}
    assert TrainConfig.from_dict(old) == make(hold_tied=False)
    assert TrainConfig.from_dict({**old, "hold_tied": True}) == make(hold_tied=True)


@pytest.mark.parametrize("former", [True, False])
def test_nobody_can_ask_for_them_any_more(former):
    with pytest.raises(ConfigError, match=rf"common_random_numbers must be a name, got {former}\. Set --common-random"):
        make(common_random_numbers=former)
