"""Settings: every value is checked, and JSON gives back what it was given."""

import json
from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest

from shes.envs.point import Point
from shes.envs.registry import ENVIRONMENTS, Environment
from shes.errors import ConfigError, UnknownNameError
from shes.experiments.config import EXECUTION_FIELDS, TrainConfig, check_fields, flag
from shes.hierarchy.goals import GOAL_ENCODINGS
from shes.hierarchy.rewards import PRIMITIVE_REWARDS
from tests.e2e import own_classes

WHOLE_NUMBERS = {
    "chunk_size": 0,
    "controller_interval": 1,
    "episodes_per_policy": 1,
    "evaluation_episodes": 1,
    "evaluation_horizon": 1,
    "evaluation_interval": 1,
    "generations": 1,
    "horizon": 1,
    "keep_checkpoints": 1,
    "noise_table_size": 2,
    "num_workers": 0,
    "seed": 0,
}
POSITIVE = ["goal_distance", "learning_rate", "minutes", "sigma"]
NOT_NEGATIVE = ["evaluation_reset_noise", "reset_noise", "weight_decay"]
NAMES = [
    "backend",
    "biases",
    "goal_encoding",
    "integrator",
    "mirrored",
    "primitive_reward",
    "rank_ties",
    "spec",
    "target_sampling",
]
SWITCHES = ["common_random_numbers", "fall_penalty", "minimum_goal_distance", "observe_block"]
PLACES = ["evaluation_target", "target"]
OTHERS = ["env", "external", "hidden", "population_size", "preset", "statistics_fraction"]


def make(**settings):
    return TrainConfig(env="point-gather", **settings)


def test_every_setting_is_checked_by_a_test_here():
    checked = [*WHOLE_NUMBERS, *POSITIVE, *NOT_NEGATIVE, *NAMES, *SWITCHES, *PLACES, *OTHERS]
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
@pytest.mark.parametrize("wrong", [-0.1, float("nan"), float("inf"), "1", None])
def test_a_number_that_may_be_zero_is_not_negative(name, wrong):
    assert getattr(make(**{name: 0}), name) == 0
    with pytest.raises(
        ConfigError, match=rf"{name} must be zero or a positive number, got {wrong!r}\. Set {flag(name)}"
    ):
        make(**{name: wrong})


@pytest.mark.parametrize("wrong", [-0.1, 1.1, float("nan"), "all"])
def test_the_share_of_the_statistics_is_between_zero_and_one(wrong):
    assert make(statistics_fraction=0).statistics_fraction == 0
    with pytest.raises(ConfigError, match=rf"statistics_fraction must be between 0 and 1, got {wrong!r}\. Set --stat"):
        make(statistics_fraction=wrong)


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
    right = getattr(make(), name)
    wrong = right[:-1]
    message = rf"unknown {name.replace('_', ' ')} '{wrong}'\. Did you mean '{right}'\? Known: .*Set {flag(name)}\."
    with pytest.raises(UnknownNameError, match=message):
        make(**{name: wrong})


def test_names_registered_later_are_allowed_and_suggested(monkeypatch):
    monkeypatch.setitem(ENVIRONMENTS, "point-corner", Environment(Point, own_classes.Corner))
    monkeypatch.setitem(GOAL_ENCODINGS, "vector", own_classes.Vector)
    monkeypatch.setitem(PRIMITIVE_REWARDS, "nearness", own_classes.Nearness)
    names = {"env": "point-corner", "goal_encoding": "vector", "primitive_reward": "nearness"}
    assert TrainConfig.from_dict(TrainConfig(**names).to_dict()).to_dict().items() >= names.items()
    for name, right in names.items():
        with pytest.raises(UnknownNameError, match=f"Did you mean '{right}'"):
            TrainConfig(**{**names, name: right[:-1]})


@pytest.mark.parametrize("wrong", [(0,), (8, -1), (8.5,), ("8",)])
def test_hidden_layers_are_positive_whole_numbers(wrong):
    with pytest.raises(
        ConfigError, match=r"hidden must be positive whole numbers, e\.g\. --hidden 64 64, got \(.*Set --hid"
    ):
        make(hidden=wrong)


def test_no_hidden_layer_is_allowed():
    assert make(hidden=()).hidden == ()


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
    config = make(seed=np.int64(3), sigma=np.float32(0.5), hidden=[np.int32(4)], common_random_numbers=np.bool_(False))
    assert config == make(seed=3, sigma=0.5, hidden=(4,), common_random_numbers=False)
    assert json.loads(json.dumps(config.to_dict()))["hidden"] == [4]
    assert type(config.sigma) is float


def test_an_unknown_key_is_an_error_that_names_the_nearest():
    with pytest.raises(ConfigError, match=r"unknown setting 'sigmma'\. Did you mean 'sigma'\? Settings: env, preset, "):
        TrainConfig.from_dict({"env": "point-gather", "sigmma": 1})
    with pytest.raises(ConfigError, match=r"unknown setting 'qqq'\. Settings: "):
        check_fields({"qqq": 1})


def test_numbers_are_the_settings_that_change_numbers():
    numbers = make().numbers()
    assert set(numbers) == {field.name for field in fields(TrainConfig)} - EXECUTION_FIELDS
    other = make(num_workers=3, chunk_size=7, backend="serial", generations=5, minutes=1.0, keep_checkpoints=2)
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
