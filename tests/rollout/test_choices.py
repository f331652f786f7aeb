"""Goal encodings, controller outputs and primitive rewards: their formulas, and what all of a registry promise."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from shes.agents import goals, rewards
from shes.errors import ConfigError
from tests.e2e.own_classes import Nearness, Vector
from tests.rollout import plain_agent

HALF = math.sqrt(0.5)
TURNS = ("one_hot", "heading_vector", "heading_direction")
"""Outputs that turn with the robot."""
EDGES = [(0, 0), (1e-3, 0), (1e-170, -1e-170), (5e-324, 5e-324), (-30, 40), (-2, -2)]


def encode(name, vector, heading):
    """Return features [N, size] of goals at `vector` [N, 2]."""
    encoding, vector = goals.make_goal_encoding(name, {}), np.array(vector, float)
    wide = np.full((len(vector), encoding.size + 4), np.nan)  # features stand in front of what else a primitive sees
    encoding.encode(vector, np.sqrt((vector * vector).sum(axis=1)), heading, wide[:, : encoding.size])
    assert np.isnan(wide[:, encoding.size :]).all()
    return wide[:, : encoding.size]


def decide(name, output, heading):
    """Return vectors [N, 2] to the goals of outputs [N, size], 3.7 m at the goal distance."""
    return goals.make_controller_output(name, {}).vector(output, heading, 3.7)


def pay(name, displacement, way):
    """Return rewards [N] after a movement from where the goal was `way` [N, 2]."""
    start = np.maximum(np.hypot(*way.T), 1e-3)  # as the agent gives it
    return rewards.make_primitive_reward(name, {})(np.hypot(*(way - displacement).T), start, displacement, way)


def vectors(rng, rows):
    """Return vectors [N, 2], among them each with each of the edges' kinds."""
    made = rng.normal(size=(rows, 2)) * 4
    made[: len(EDGES) ** 2] = np.repeat(EDGES, len(EDGES), axis=0)
    return made


def numbers(rng, rows, name):
    """Return outputs [N, size] of a controller, some of which tie, some below 0."""
    made = rng.uniform(-1.05, 1.05, (rows, goals.CONTROLLER_OUTPUTS[name].size))
    made[:20] = np.round(made[:20])
    made[20:30] -= 2
    return made


def cases():
    """Yield for every choice: function, name, arguments [N, ...] and its second implementation of one row."""
    rng, rows = np.random.default_rng(4), 200
    headings, ways, edges = rng.uniform(-4, 4, rows), vectors(rng, rows), np.tile(EDGES, (len(EDGES), 1))
    for name in goals.GOAL_ENCODINGS:
        yield encode, name, (ways, headings), plain_agent.encode
    for name in goals.CONTROLLER_OUTPUTS:
        second = lambda name, *row: plain_agent.decide(name, *row, 3.7)  # noqa: E731 - a row of a table
        yield decide, name, (numbers(rng, rows, name), headings), second
    moved = rng.normal(size=(rows, 2)) * 2
    moved[: len(edges)] = edges
    for name in rewards.PRIMITIVE_REWARDS:
        second = lambda name, m, w: plain_agent.pay(  # noqa: E731
            name, abs(complex(*w) - complex(*m)), max(abs(complex(*w)), 1e-3), m, w
        )
        yield pay, name, (moved, ways), second


over_all = pytest.mark.parametrize(
    ("function", "name", "arguments", "second"), [pytest.param(*case, id=case[1]) for case in cases()]
)


@over_all
def test_it_is_its_second_implementation(function, name, arguments, second):
    found = function(name, *arguments)
    assert found.dtype == np.float64
    assert np.isfinite(found).all()
    for row, own in zip(found, zip(*(array.tolist() for array in arguments), strict=True), strict=True):
        if function is pay and name == "cosine" and 0 < min(abs(complex(*each)) for each in own) < 1e-100:
            assert -1 <= row <= 1  # Python's products underflow
            continue
        if function is encode and 0 < abs(complex(*own[0])) < 1e-150:
            assert (np.abs(row) <= 1.5).all()  # the squares of the shortest vectors are rounded coarsely
            continue
        assert row == pytest.approx(second(name, *own), rel=1e-9, abs=1e-12)


@over_all
def test_no_bit_depends_on_how_many_there_are(function, name, arguments, second):
    before = [array.tobytes() for array in arguments]
    whole = function(name, *arguments)
    for count, start in ((1, 0), (2, 5), (3, 20), (8, 60), (17, 100)):
        part = slice(start, start + count)
        assert function(name, *(array[part] for array in arguments)).tobytes() == whole[part].tobytes()
    assert [array.tobytes() for array in arguments] == before
    assert not any(np.shares_memory(array, whole) for array in arguments)


@given(turn=st.floats(-np.pi, np.pi), heading=st.floats(-np.pi, np.pi), x=st.floats(-9, 9), y=st.floats(-9, 9))
def test_what_a_turned_world_changes(turn, heading, x, y):
    """In the robot's own frame nothing; otherwise vectors turn with the world. Rewards never change."""
    assume(math.hypot(x, y) > 1e-3)
    matrix = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    way, before, after = np.array([[x, y]]), np.array([heading]), np.array([heading + turn])
    for name in goals.GOAL_ENCODINGS:
        one, other = encode(name, way, before), encode(name, way @ matrix, after)
        if not name.startswith("angle"):
            one[:, :2] @= matrix
        assert other == pytest.approx(one, abs=1e-9)
    rng = np.random.default_rng(0)
    for name in goals.CONTROLLER_OUTPUTS:
        output = numbers(rng, 60, name)[40:41]
        one, other = decide(name, output, before), decide(name, output, after)
        assert other == pytest.approx(one @ matrix if name in TURNS else one, abs=1e-9)
    moved = np.array([[0.5, 1.5]])
    assume(abs(math.hypot(*(way - moved)[0]) - 1) > 1e-6)  # rounding may carry it over the bonus's circle
    for name in rewards.PRIMITIVE_REWARDS:
        assert pay(name, moved @ matrix, way @ matrix) == pytest.approx(pay(name, moved, way), abs=1e-9, rel=1e-9)


# Worked out by hand: signs and units, in which two formulas may agree and be wrong.


def test_one_hot_outputs_by_hand():
    """The authors add 1/8 to the angle in radians (`onehot_forward` in policy.jl, whose bins count from 1)."""
    middle = [(-HALF, -HALF), (0, -1), (HALF, -HALF), (1, 0), (HALF, HALF), (0, 1), (-HALF, HALF), (-1, 0)]
    ahead = goals.OneHotOutput().vector(1.75 * np.eye(8) - 1, np.zeros(8), 4.0)
    turned = goals.OneHotOutput().vector(1.1 * np.eye(8) - 1, np.full(8, np.pi / 2), 4.0)
    assert ahead == pytest.approx(3 * np.array(middle), abs=1e-12)
    assert turned == pytest.approx(np.array(middle)[:, ::-1] * [-1, 1], abs=1e-12)  # at least 1 m
    for number, (x, y) in enumerate(ahead, start=1):
        authors = number * (2 * math.pi / 8) - math.pi + 1 / 8
        assert math.remainder(authors - math.atan2(y, x), 2 * math.pi) == pytest.approx(1 / 8)


def test_goals_and_rewards_by_hand():
    for vector, heading, expected in (((0, 4), 0, (1, 0, 0.004)), ((-1, -1), np.pi, (HALF, HALF, math.sqrt(2) / 1000))):
        angle, metres = (encode(name, [vector], np.array([heading]))[0] for name in ("angle", "angle_metres"))
        assert [angle, metres] == [pytest.approx(expected), pytest.approx([*expected[:2], 1000 * expected[2]])]
    for left, start, expected in ((3, 4, 0.25), (12, 4, -2), (1, 4, 0.75), (0.999, 4, 1.75025)):
        paid = rewards.ProgressReward()(np.array([left]), np.array([start]), np.zeros((1, 2)), np.zeros((1, 2)))
        assert paid == pytest.approx([expected], abs=1e-12)
    for moved, way, expected in (((1, 1), (0, -2), -HALF), ((1e-170, 0), (1e-170,) * 2, HALF), ((3, 3), (1, 1), 1)):
        paid = pay("cosine", np.array([moved]), np.array([way]))
        assert paid == pytest.approx([expected], abs=1e-15)
        assert paid <= 1


class Polar(goals.ControllerOutput):
    """A user's own: a bearing, and a distance."""

    size = 2

    def vector(self, output, heading, goal_distance):
        angle = np.pi * output[:, 0] + heading
        return goal_distance * output[:, 1:] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


class Three(Polar):
    size = 3


@pytest.mark.parametrize("name", goals.CONTROLLER_OUTPUTS)
def test_the_outputs_of_a_direction_point_there(name):
    made, angles = goals.make_controller_output(name, {}), np.arange(-8, 16) * np.pi / 4
    for heading in (0.0, 2.0):
        seen = angles + heading * (name in TURNS)
        found = made.vector(made.of_direction(angles), np.full(24, heading), 4.0)
        assert found == pytest.approx(4 * np.stack([np.cos(seen), np.sin(seen)], axis=1), abs=1e-9)


def test_other_numbers_of_outputs_are_equal_steps_of_direction():
    angles = np.radians([0, 59, 61, 240, 301, -119])
    assert Polar().of_direction(angles) == pytest.approx(np.stack([np.cos(angles), np.sin(angles)], axis=1))
    assert Three().of_direction(angles).argmax(axis=1).tolist() == [0, 0, 1, 2, 0, 2]
    assert Three().of_direction(angles).sum(axis=1).tolist() == [1] * 6
    nearest = goals.OneHotOutput().of_direction(np.radians([22, 23, -22, 158, -158]))
    assert nearest.argmax(axis=1).tolist() == [3, 4, 3, 7, 7]


# The registries.


class Forgetful(Vector):
    size = 4


class Sideways(Polar):
    def vector(self, output, heading, goal_distance):
        return super().vector(output, heading, goal_distance).T


class Column(Nearness):
    def __call__(self, distance, start_distance, displacement, goal):
        return distance[:, None]


@pytest.mark.parametrize(
    ("registry", "make", "register", "own", "wrong", "message"),
    [
        (
            goals.GOAL_ENCODINGS, goals.make_goal_encoding, goals.register_goal_encoding, Vector, Forgetful,
            r"write .* each of its 4 features .*left \[1\.0, 1\.0, 1\.414.*, nan\]\. .*`size`",
        ),
        (
            goals.CONTROLLER_OUTPUTS, goals.make_controller_output, goals.register_controller_output, Polar, Sideways,
            r"return an array \[N, 2\].*for 3 episodes .* shape \(2, 3\), not \(3, 2\)",
        ),
        (
            rewards.PRIMITIVE_REWARDS, rewards.make_primitive_reward, rewards.register_primitive_reward, Nearness,
            Column, r"return an array \[N\].*for 2 episodes it returned shape \(2, 1\), not \(2,\)",
        ),
    ],
)  # fmt: skip
def test_ones_own_is_made_by_its_name_if_its_shape_is_right(registry, make, register, own, wrong, message, monkeypatch):
    monkeypatch.setitem(registry, "own", own)  # forgotten after this test
    register("own", own)
    assert type(make("own", {})) is own
    assert {type(make(name, {})) for name in registry} == set(registry.values())
    del registry["own"]
    register("own", wrong)
    with pytest.raises(ConfigError, match=rf"{registry.kind} 'own' must {message}"):
        make("own", {})
