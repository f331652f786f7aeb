"""The options of a task, as Python gives them: values of the right kind, or an error that says what is allowed."""

import re

import gymnasium
import numpy as np
import pytest

import shes  # registers
from shes.envs.registry import make_task
from shes.envs.tasks.options import TaskOptions
from shes.errors import ConfigError, UnknownNameError

assert shes

NAMES = {"spec": "--spec", "integrator": "--integrator", "target_sampling": "--target-sampling"}
SWITCHES = {"evaluation": "Set evaluation", "fall_penalty": "--fall-penalty", "observe_block": "--observe-block"}


@pytest.mark.parametrize("option", NAMES)
@pytest.mark.parametrize("wrong", [None, 1, ["shes"], {"rk4": 1}, b"hiro"])
def test_a_name_that_is_no_text_is_refused_with_the_names_that_there_are(option, wrong):
    message = rf"{option} must be one of \w+, .+, got {re.escape(repr(wrong))}\. .*{NAMES[option]}"
    with pytest.raises(ConfigError, match=message):
        TaskOptions(**{option: wrong})


@pytest.mark.parametrize("option", NAMES)
def test_an_unknown_name_is_refused_with_its_flag(option):
    with pytest.raises(UnknownNameError, match=rf"unknown .* 'zzz'\. Known: .*{NAMES[option]}"):
        TaskOptions(**{option: "zzz"})


@pytest.mark.parametrize("option", SWITCHES)
@pytest.mark.parametrize("wrong", ["no", "false", 0, 1, 0.0, np.array(True), []])
def test_a_switch_is_true_or_false(option, wrong):
    message = rf"{option} must be True or False, got {re.escape(repr(wrong))}\. .*{SWITCHES[option]}"
    with pytest.raises(ConfigError, match=message):
        TaskOptions(**{option: wrong})


@pytest.mark.parametrize("wrong", [0, -3, 2.5, 25.0, np.nan, np.inf, True, "5", None, [5], np.array([5])])
def test_an_interval_of_goals_is_a_whole_number_of_at_least_one(wrong):
    message = rf"goal_interval must be a whole number of at least 1, got {re.escape(repr(wrong))}\. Set --controller-i"
    with pytest.raises(ConfigError, match=message):
        TaskOptions(goal_interval=wrong)


@pytest.mark.parametrize("wrong", [0, 0.99, -4, 1001, 1e308, np.nan, np.inf, True, "4", None, (4.0,)])
def test_goals_are_drawn_within_one_to_a_thousand_metres(wrong):
    message = rf"goal_range must be at least 1 m, and at most 1000, got {re.escape(repr(wrong))}\. Set --goal-distance"
    with pytest.raises(ConfigError, match=message):
        TaskOptions(goal_range=wrong)


@pytest.mark.parametrize("wrong", ["0.1", None, True, False, [0.1], 1j])
def test_reset_noise_is_a_number(wrong):
    message = rf"reset_noise must be in \[0, 1\), got {re.escape(repr(wrong))}\. Set it \(--reset-noise\)"
    with pytest.raises(ConfigError, match=message):
        TaskOptions(reset_noise=wrong)


@pytest.mark.parametrize("option", ["target", "evaluation_target"])
@pytest.mark.parametrize(
    "wrong",
    [
        5,
        "ab",
        ("0", "1"),
        [[1], [2]],
        [[1], [2, 3]],
        {0: 1, 1: 2},
        (True, 1),
        (0, None),
        (0, np.nan),
        (np.inf, 0),
        (1e308, 0),
        (0, -1000.1),
        np.array(5.0),
        np.zeros((2, 1)),
        np.array(["a", "b"]),
    ],
    ids=repr,
)
def test_a_target_is_coordinates_that_lie_in_reach(option, wrong):
    flag = f"--{option.replace('_', '-')}"
    allowed = "coordinates in metres, numbers from -1000 to 1000"
    with pytest.raises(ConfigError, match=rf"{option} must be {allowed}, got {re.escape(repr(wrong))}\. Set {flag}"):
        TaskOptions(**{option: wrong})
    with pytest.raises(ConfigError, match=f"{option} must be coordinates"):
        gymnasium.make("shes/PointMaze-v0", **{option: wrong})


@pytest.mark.parametrize("option", ["target", "evaluation_target"])
@pytest.mark.parametrize(
    ("name", "wrong"), [("point-maze", ()), ("point-push", (1.0, 2.0, 3.0)), ("point-fall", (1, 2))]
)
def test_a_target_has_as_many_coordinates_as_the_tasks_own(option, name, wrong):
    kind = name.removeprefix("point-")
    with pytest.raises(ConfigError, match=rf"{option} of {kind} must be \d coordinates in metres, got \(.*\)\. Set -"):
        make_task(name, 1, TaskOptions(**{option: wrong}))


@pytest.mark.parametrize("given", [[8, 3.5], (8, 3.5), np.array([8.0, 3.5]), np.float32([8, 3.5]), [np.int64(8), 3.5]])
def test_a_target_may_be_any_list_of_numbers_and_becomes_a_tuple(given):
    options = TaskOptions(target=given, evaluation_target=given)
    assert options == TaskOptions(target=(8.0, 3.5), evaluation_target=(8.0, 3.5))
    assert all(type(each) is float for each in options.target)
    for is_evaluation in (False, True):
        env = gymnasium.make("shes/PointMaze-v0", target=given, evaluation_target=given, evaluation=is_evaluation)
        env.reset(seed=0)
        np.testing.assert_array_equal(env.unwrapped._adapter.task.target, [[8.0, 3.5]])


def test_numpys_values_become_pythons():
    given = {
        "spec": np.str_("hiro"),
        "reset_noise": np.float32(0.5),
        "evaluation": np.True_,
        "observe_block": np.False_,
        "fall_penalty": np.False_,
        "goal_interval": np.int32(7),
        "goal_range": np.float64(3),
    }
    options = TaskOptions(**given)
    plain = {name: value.item() if isinstance(value, np.generic) else value for name, value in given.items()}
    assert options == TaskOptions(**plain)
    assert {type(getattr(options, name)) for name in given} == {str, float, bool, int}


def test_options_that_were_checked_are_checked_again_without_a_change():
    options = TaskOptions(spec="hiro", target=[1, 2])
    assert TaskOptions(**vars(options)) == options
    assert options.integrator == "rk4"


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("point-gather", {"fall_penalty": False}, "penalty for falls in specification hiro alone.*--spec hiro"),
        (
            "point-maze",
            {"target": (1, 2), "target_sampling": "free_cells"},
            r"target \(1.0, 2.0\) fixes training's target, so target_sampling 'free_cells' does nothing.*Leave --t",
        ),
    ],
)
def test_what_an_option_beside_it_makes_idle_is_refused(name, options, message):
    with pytest.raises(ConfigError, match=message):
        make_task(name, 1, TaskOptions(**options))
    for option, value in options.items():
        spec = "hiro" if option == "fall_penalty" else "shes"
        make_task(name, 1, TaskOptions(spec=spec, **{option: value}))
