"""Primitive rewards against numbers worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import ConfigError, UnknownNameError
from shes.hierarchy.rewards import (
    PRIMITIVE_REWARDS,
    PrimitiveReward,
    ProgressReward,
    make_primitive_reward,
    register_primitive_reward,
)
from tests.e2e.own_classes import Nearness


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


def test_rewards_are_made_by_name():
    assert isinstance(make_primitive_reward("progress"), ProgressReward)


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
        ("own", Weighted, r"Weighted must be made from no arguments, and is not: .*'weight'\. Change its __init__"),
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
