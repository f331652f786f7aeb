"""Goal encodings, controller outputs and primitive rewards: their formulas, and the shapes of one's own."""

import math

import numpy as np
import pytest

from shes.agents import goals, rewards
from shes.errors import ConfigError
from shes.options import make
from tests.e2e.own_classes import Nearness, Vector
from tests.messages import raises
from tests.rollout import plain_agent

TURNS = ("one_hot", "heading_direction")
"""Outputs that turn with the robot."""
EDGES = np.array([(0, 0), (1e-3, 0), (1e-170, -1e-170), (5e-324, 5e-324), (-30, 40), (-2, -2)])
ROWS = 200


def encode(name, vector, heading):
    """Return features [N, size] of goals at `vector` [N, 2]."""
    encoding, vector = make(goals.GOAL_ENCODINGS, name, {}), np.array(vector, float)
    wide = np.full((len(vector), encoding.size + 4), np.nan)  # features stand in front of what else a primitive sees
    encoding.encode(vector, np.sqrt((vector * vector).sum(axis=1)), heading, wide[:, : encoding.size])
    assert np.isnan(wide[:, encoding.size :]).all()
    return wide[:, : encoding.size]


def pay(name, displacement, way):
    """Return rewards [N] after a movement from where the goal was `way` [N, 2]."""
    start = np.maximum(np.hypot(*way.T), 1e-3)  # as the agent gives it
    return make(rewards.PRIMITIVE_REWARDS, name, {})(np.hypot(*(way - displacement).T), start, displacement, way)


def with_edges(rng, edges):
    """Return vectors [N, 2], the first of which are `edges`."""
    return np.concatenate([edges, 4 * rng.normal(size=(ROWS - len(edges), 2))])


@pytest.mark.parametrize("name", goals.GOAL_ENCODINGS)
def test_features_are_those_of_the_second_implementation(name):
    rng = np.random.default_rng(4)
    vectors, headings = with_edges(rng, EDGES), rng.uniform(-4, 4, ROWS)
    for row, vector, heading in zip(encode(name, vectors, headings), vectors, headings, strict=True):
        if 0 < math.hypot(*vector) < 1e-150:
            assert (np.abs(row) <= 1.5).all()  # the squares of the shortest vectors are rounded coarsely
        else:
            assert row == pytest.approx(plain_agent.encode(name, vector, heading), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("name", goals.CONTROLLER_OUTPUTS)
def test_goals_are_those_of_the_second_implementation(name):
    """Some outputs tie, some are all below 0."""
    rng, made = np.random.default_rng(5), make(goals.CONTROLLER_OUTPUTS, name, {})
    output, headings = rng.uniform(-1.05, 1.05, (ROWS, made.size)), rng.uniform(-4, 4, ROWS)
    output[:20] = np.round(output[:20])
    output[20:30] -= 2
    expected = [plain_agent.decide(name, *row, 3.7) for row in zip(output.tolist(), headings, strict=True)]
    assert made.vector(output, headings, 3.7) == pytest.approx(np.array(expected), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("name", rewards.PRIMITIVE_REWARDS)
def test_rewards_are_those_of_the_second_implementation(name):
    rng, number = np.random.default_rng(6), len(EDGES)
    moved, ways = with_edges(rng, np.tile(EDGES, (number, 1))) / 2, with_edges(rng, np.repeat(EDGES, number, axis=0))
    found = pay(name, moved, ways)
    assert name != "cosine" or (np.abs(found) <= 1).all()
    for row, own, way in zip(found, moved, ways, strict=True):
        left, before = math.dist(own, way), max(math.hypot(*way), 1e-3)
        if not 0 < min(math.hypot(*own), math.hypot(*way)) < 1e-300:  # there are no directions between such numbers
            assert row == pytest.approx(plain_agent.pay(name, left, before, own, way), rel=1e-9, abs=1e-12)


class Three(goals.VectorOutput):
    size = 3


@pytest.mark.parametrize("name", goals.CONTROLLER_OUTPUTS)
def test_the_outputs_of_a_direction_point_there(name):
    made, angles = make(goals.CONTROLLER_OUTPUTS, name, {}), np.arange(-8, 16) * np.pi / 4
    for heading in (0.0, 2.0):
        seen = angles + heading * (name in TURNS)
        found = made.vector(made.of_direction(angles), np.full(24, heading), 4.0)
        assert found == pytest.approx(4 * np.stack([np.cos(seen), np.sin(seen)], axis=1), abs=1e-9)


def test_other_numbers_of_outputs_are_equal_steps_of_direction():
    angles = np.radians([0, 59, 61, 240, 301, -119])
    assert Three().of_direction(angles).tolist() == np.eye(3)[[0, 0, 1, 2, 0, 2]].tolist()
    nearest = goals.OneHotOutput().of_direction(np.radians([22, 23, -22, 158, -158]))
    assert nearest.argmax(axis=1).tolist() == [3, 4, 3, 7, 7]


# One's own. `e2e/test_own_classes` trains with those whose shape is right.


class Forgetful(Vector):
    size = 4


class Sideways(goals.VectorOutput):
    def vector(self, output, heading, goal_distance):
        return super().vector(output, heading, goal_distance).T


class Column(Nearness):
    def __call__(self, distance, start_distance, moved, goal):
        return distance[:, None]


@pytest.mark.parametrize(
    ("registry", "wrong", "message"),
    [
        (goals.GOAL_ENCODINGS, Forgetful, "write ... its 4 features ... left [1.0, 1.0, ... , nan]. ... `size`"),
        (goals.CONTROLLER_OUTPUTS, Sideways, "return an array [N, 2] ... for 3 episodes ... (2, 3), not (3, 2)"),
        (rewards.PRIMITIVE_REWARDS, Column, "return an array [N] ... for 2 episodes it ... (2, 1), not (2,)"),
    ],
)
def test_a_choice_of_a_wrong_shape_is_refused(registry, wrong, message, monkeypatch):
    monkeypatch.setitem(registry, "own", wrong)  # forgotten after this test
    with raises(ConfigError, f"{registry.kind} 'own' must {message}"):
        make(registry, "own", {})
