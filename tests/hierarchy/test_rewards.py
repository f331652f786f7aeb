"""Primitive rewards against numbers worked out by hand, a second implementation, and the contract of every reward."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from shes.errors import ConfigError, UnknownNameError
from shes.hierarchy.rewards import (
    PRIMITIVE_REWARDS,
    CosineReward,
    NegativeDistanceReward,
    PrimitiveReward,
    ProgressReward,
    make_primitive_reward,
    register_primitive_reward,
)
from tests.e2e.own_classes import Nearness

NAMES = sorted(PRIMITIVE_REWARDS)
HALF = math.sqrt(0.5)
DOES_NOT_MOVE = [(0, 0), (-0.0, 0.0)]
SHORT = [(1e-170, 0), (0, -5e-324), (1e-3, 1e-3)]


def _pay(name, displacement, goal):
    """Return the reward [N] of robots that moved `displacement` [N, 2] with goals at `goal`, and the arguments."""
    displacement, goal = np.array(displacement, float).reshape(-1, 2), np.array(goal, float).reshape(-1, 2)
    start_distance = np.maximum(np.hypot(*goal.T), 1e-3)  # as the agent gives it
    arguments = (np.hypot(*(goal - displacement).T), start_distance, displacement, goal)
    return make_primitive_reward(name)(*arguments), arguments


def _second_implementation(name, displacement, goal):
    moved, way = complex(*displacement), complex(*goal)
    left, start = abs(way - moved), max(abs(way), 1e-3)
    both = abs(moved) * abs(way)
    return {
        "progress": 1 - left / start + (1 if left < 1 else 0),
        "metres": 4 * (start - left) + (0.2 if left < 1 else 0),
        "negative_distance": -left,
        "cosine": (moved.real * way.real + moved.imag * way.imag) / both if both else 0,
    }[name]


def _progress(distance, start_distance):
    away = np.zeros((1, 2))
    return ProgressReward()(np.array([distance], float), np.array([start_distance], float), away, away)[0]


@pytest.mark.parametrize(
    ("distance", "start_distance", "expected"),
    [
        (4, 4, 0),  # not moved
        (3, 4, 0.25),  # a quarter of the way
        (6, 4, -0.5),  # the wrong way
        (12, 4, -2),
        (1.001, 4, 0.74975),  # just outside
        (1, 4, 0.75),  # on the circle: not yet reached
        (0.999, 4, 1.75025),  # just inside
        (0, 4, 2),  # exactly at the goal
        (1, 1, 0),  # the nearest goal that a minimum distance allows
        (0.5, 1, 1.5),
        (0.4, 0.2, 0),  # without a minimum distance: twice as far, but within reach
    ],
)
def test_the_progress_reward_is_that_worked_out_by_hand(distance, start_distance, expected):
    assert _progress(distance, start_distance) == pytest.approx(expected, abs=1e-12)


@given(start=st.floats(1, 8), near=st.floats(0, 20), far=st.floats(0, 20))
def test_progress_pays_no_less_for_being_nearer(start, near, far):
    near, far = sorted((near, far))
    assert _progress(near, start) >= _progress(far, start)


def test_each_episode_is_paid_for_its_own_way():
    away = np.zeros((3, 2))
    reward = ProgressReward()(np.array([2.0, 0.5, 6.0]), np.array([4.0, 2.0, 3.0]), away, away)
    assert reward == pytest.approx([0.5, 1.75, -1])


@pytest.mark.parametrize("distance", [0, 1e-3, 0.999, 1, 4, 12.5])
def test_the_negative_distance_is_minus_the_distance_wherever_the_robot_started(distance):
    for start_distance in (1e-3, 1, 8):
        away = np.ones((1, 2))
        reward = NegativeDistanceReward()(np.array([distance], float), np.array([start_distance], float), away, away)
        assert reward.tolist() == [-distance]


@pytest.mark.parametrize(
    ("displacement", "goal", "expected"),
    [
        ((2, 0), (4, 0), 1),  # straight at it
        ((20, 0), (4, 0), 1),  # past it: only the direction counts
        ((-1, 0), (4, 0), -1),
        ((0, 3), (4, 0), 0),  # aside
        ((1, 1), (4, 0), HALF),
        ((1, 1), (0, -2), -HALF),
        ((3, 4), (4, 3), 0.96),
        ((1e-170, 0), (1e-170, 1e-170), HALF),  # too short for squares
        ((0, 0), (4, 0), 0),  # not moved
        ((1, 2), (0, 0), 0),  # a goal where the robot stood
        ((0, 0), (0, 0), 0),
    ],
)
def test_the_cosine_reward_is_that_worked_out_by_hand(displacement, goal, expected):
    assert _pay("cosine", displacement, goal)[0].tolist() == pytest.approx([expected], abs=1e-15)


@given(angle=st.floats(-np.pi, np.pi), length=st.floats(1e-6, 1e6), factor=st.floats(1e-6, 1e6))
def test_the_cosine_of_a_straight_way_is_1_and_never_more_whatever_its_length(angle, length, factor):
    way = np.array([math.cos(angle), math.sin(angle)]) * length
    (reward,) = _pay("cosine", factor * way, way)[0]
    assert reward == pytest.approx(1)
    assert reward <= 1
    assert -1 <= _pay("cosine", -factor * way, way)[0][0] < -0.999


@pytest.mark.parametrize("name", NAMES)
def test_metres_alone_are_paid_by_what_the_step_itself_has_won(name):
    distance, before, start = (np.array([metres]) for metres in (2.0, 2.5, 5.0))
    made, away = make_primitive_reward(name), np.ones((1, 2))
    paid = made.of_step(distance, before, start, away, away)
    expected = 4 * 0.5 if name == "metres" else made(distance, start, away, away)
    assert paid == pytest.approx(expected)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("displacement", [*DOES_NOT_MOVE, *SHORT, (30, -40)])
def test_a_reward_is_finite_without_a_movement_and_without_a_way(name, displacement):
    for goal in (*DOES_NOT_MOVE, *SHORT, (4, 3)):
        (reward,) = _pay(name, displacement, goal)[0]
        assert np.isfinite(reward)
        if name == "cosine" and (displacement in DOES_NOT_MOVE or goal in DOES_NOT_MOVE):
            assert reward == 0


@pytest.mark.parametrize("name", NAMES)
def test_a_reward_is_float64_and_leaves_its_arguments_as_they_are(name):
    rng = np.random.default_rng(0)
    _, arguments = _pay(name, rng.normal(size=(9, 2)), rng.normal(size=(9, 2)) * 4)
    before = [argument.copy() for argument in arguments]
    reward = make_primitive_reward(name)(*arguments)
    assert reward.dtype == np.float64
    assert reward.shape == (9,)
    for argument, copy in zip(arguments, before, strict=True):
        assert argument.tobytes() == copy.tobytes()
        assert not np.shares_memory(argument, reward)


@pytest.mark.parametrize("name", NAMES)
def test_the_reward_is_that_of_a_second_implementation(name):
    rng = np.random.default_rng(1)
    displacement, goal = rng.normal(size=(200, 2)) * 2, rng.normal(size=(200, 2)) * 4
    displacement[:3], goal[2:5] = 0, 0
    reward, _ = _pay(name, displacement, goal)
    expected = [_second_implementation(name, *pair) for pair in zip(displacement.tolist(), goal.tolist(), strict=True)]
    assert reward.tolist() == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_the_bits_of_a_reward_do_not_depend_on_how_many_episodes_there_are(name):
    rng = np.random.default_rng(2)
    displacement, goal = rng.normal(size=(37, 2)), rng.normal(size=(37, 2)) * 4
    reward, arguments = _pay(name, displacement, goal)
    for count in (1, 2, 3, 8, 17):
        for start in (0, 5, 20):
            part = slice(start, start + count)
            few = make_primitive_reward(name)(*(argument[part] for argument in arguments))
            assert few.tobytes() == reward[part].tobytes()


@pytest.mark.parametrize("name", NAMES)
@given(turn=st.floats(-np.pi, np.pi), x=st.floats(-9, 9), y=st.floats(-9, 9))
def test_turning_the_way_and_the_movement_together_changes_no_reward(name, turn, x, y):
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    displacement, goal = np.array([0.5, 1.5]), np.array([x, y])
    (before,), (distance, *_) = _pay(name, displacement, goal)
    assume(min(np.hypot(x, y), abs(distance[0] - 1)) > 1e-6)  # rounding may carry it over the bonus's circle
    assert _pay(name, rotation @ displacement, rotation @ goal)[0][0] == pytest.approx(before, abs=1e-9, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "reward"),
    [("progress", ProgressReward), ("negative_distance", NegativeDistanceReward), ("cosine", CosineReward)],
)
def test_rewards_are_made_by_name(name, reward):
    assert type(make_primitive_reward(name)) is reward


def test_an_unknown_reward_is_refused_with_the_nearest_name():
    with pytest.raises(
        UnknownNameError, match=r"reward 'progres'\. Did you mean 'progress'\?.*--primitive-reward.*Register your own"
    ):
        make_primitive_reward("progres")


def test_an_own_reward_is_made_by_its_name(monkeypatch):
    monkeypatch.setitem(PRIMITIVE_REWARDS, "nearness", Nearness)  # forgotten after this test
    register_primitive_reward("nearness", Nearness)
    assert isinstance(make_primitive_reward("nearness"), Nearness)


class Weighted(Nearness):
    def __init__(self, weight):
        self.weight = weight


@pytest.mark.parametrize(
    ("name", "reward", "message"),
    [
        (
            "progress",
            Nearness,
            r"primitive reward 'progress' is shes\.hierarchy\.rewards\.ProgressReward already\. Choose",
        ),
        ("My Own", Nearness, r"primitive reward name must be lower-case words .*got 'My Own'\. For example"),
        (
            "own",
            ProgressReward(),
            r"must be a subclass of shes\.hierarchy\.rewards\.PrimitiveReward, got <.*not an object",
        ),
        ("own", print, r"must be a subclass of .*PrimitiveReward, got <built-in function print>"),
        ("own", PrimitiveReward, r"PrimitiveReward lacks __call__\."),
        ("own", Weighted, r"Weighted cannot be constructed with no arguments: .*'weight'\. Change its __init__"),
    ],
)
def test_what_is_no_new_reward_is_refused(name, reward, message):
    before = dict(PRIMITIVE_REWARDS)
    with pytest.raises(ConfigError, match=message):
        register_primitive_reward(name, reward)
    assert before == PRIMITIVE_REWARDS


class Column(Nearness):
    def __call__(self, distance, start_distance, displacement, goal):
        return distance[:, None]


def test_a_reward_that_is_not_one_number_for_each_episode_is_refused(monkeypatch):
    monkeypatch.setitem(PRIMITIVE_REWARDS, "column", Column)
    message = r"'column' must return an array \[N\].*for 2 episodes it returned shape \(2, 1\), not \(2,\)"
    with pytest.raises(ConfigError, match=message):
        make_primitive_reward("column")
