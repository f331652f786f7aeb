"""Controller outputs against numbers worked out by hand, a second implementation, and the contract of every output."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shes.errors import ConfigError, UnknownNameError
from shes.hierarchy.outputs import (
    CONTROLLER_OUTPUTS,
    ControllerOutput,
    OneHotOutput,
    VectorOutput,
    make_controller_output,
    register_controller_output,
)

NAMES = sorted(CONTROLLER_OUTPUTS)
TURNS_WITH_THE_ROBOT = {
    "one_hot": True,
    "heading_vector": True,
    "heading_direction": True,
    "direction": False,
    "vector": False,
}
HALF = math.sqrt(0.5)
DIRECTIONS = [(-HALF, -HALF), (0, -1), (HALF, -HALF), (1, 0), (HALF, HALF), (0, 1), (-HALF, HALF), (-1, 0)]
"""Of the eight outputs, for a robot that faces +x: ahead is +x, its left is +y."""


class Polar(ControllerOutput):
    """A user's own: a bearing, and a distance."""

    size = 2

    def vector(self, output, heading, goal_distance):
        angle = np.pi * output[:, 0] + heading
        return goal_distance * output[:, 1:] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _one_hot(largest, value, others=-1.0):
    output = np.full((1, 8), others, dtype=float)
    output[0, largest] = value
    return output


def _second_implementation(name, output, heading, goal_distance):
    if name == "vector":
        return (output[0] * goal_distance, output[1] * goal_distance)
    if name == "heading_vector":
        turned = complex(*output) * goal_distance * complex(math.cos(heading), math.sin(heading))
        return (turned.real, turned.imag)
    if name.endswith("direction"):
        length = math.hypot(*output)
        unit = [x / (length or 1) for x in output]
        return _second_implementation(name.replace("direction", "vector"), unit, heading, goal_distance)
    best = 0
    for index, value in enumerate(output):
        if value > output[best]:
            best = index
    angle = math.radians((-135, -90, -45, 0, 45, 90, 135, 180)[best]) + heading
    distance = max(output[best] * goal_distance, 1)
    return (distance * math.cos(angle), distance * math.sin(angle))


def _authors_angle(bin_number, yaw, bins):
    """Return the angle of `onehot_forward` in policy.jl, whose bins count from 1."""
    return bin_number * (2 * math.pi / bins) - math.pi + 1 / bins + yaw


@pytest.mark.parametrize(
    ("output", "vector"),
    [((0, 0), (0, 0)), ((1, -1), (4, -4)), ((0.5, -0.25), (2, -1)), ((1.0625, -1.03125), (4.25, -4.125))],
)
def test_the_vector_output_is_that_worked_out_by_hand_whatever_the_heading(output, vector):
    for heading in (0.0, 2.0, -3.0):
        assert VectorOutput().vector(np.array([output], float), np.array([heading]), 4.0).tolist() == [list(vector)]


def test_the_vector_output_of_a_networks_float32_has_the_bits_of_the_product_in_float64():
    output = np.tanh(np.random.default_rng(0).normal(size=(500, 2))).astype(np.float32)
    expected = output.reshape(-1, 2).astype(np.float64) * 4.1
    for given_output in (output, output.astype(np.float64)):
        assert VectorOutput().vector(given_output, np.zeros(500), 4.1).tobytes() == expected.tobytes()


@pytest.mark.parametrize("largest", range(8))
def test_the_largest_of_eight_outputs_picks_the_direction_and_its_value_the_distance(largest):
    facing_x = OneHotOutput().vector(_one_hot(largest, 0.75), np.zeros(1), 4.0)
    assert facing_x[0] == pytest.approx(3 * np.array(DIRECTIONS[largest]), abs=1e-12)
    x, y = DIRECTIONS[largest]
    facing_y = OneHotOutput().vector(_one_hot(largest, 0.75), np.full(1, math.pi / 2), 4.0)
    assert facing_y[0] == pytest.approx((-3 * y, 3 * x), abs=1e-12)


@pytest.mark.parametrize(
    ("value", "others", "distance"),
    [(1, -1, 4), (1.02, 1, 4.08), (0.5, 0.49, 2), (0.25, 0, 1), (0.2, 0, 1), (0, -1, 1), (-0.5, -0.6, 1)],
)
def test_a_one_hot_goal_is_the_largest_value_away_and_at_least_1_m(value, others, distance):
    assert OneHotOutput().vector(_one_hot(3, value, others), np.zeros(1), 4.0)[0].tolist() == [distance, 0]


def test_of_equal_outputs_the_first_one_counts():
    output = np.array([[0.5] * 8, [0, 0, 0.5, 0.5, 0, 0.5, 0, 0], [-1] * 8], float)
    vectors = OneHotOutput().vector(output, np.zeros(3), 4.0)
    assert vectors == pytest.approx(np.array([DIRECTIONS[0], DIRECTIONS[2], DIRECTIONS[0]]) * [[2], [2], [1]])


def test_the_one_hot_directions_are_the_authors_turned_to_the_right_by_the_eighth_of_a_radian_that_they_add():
    for largest in range(8):
        x, y = OneHotOutput().vector(_one_hot(largest, 1), np.full(1, 0.4), 4.0)[0]
        difference = _authors_angle(largest + 1, 0.4, bins=8) - math.atan2(y, x)
        assert math.remainder(difference, 2 * math.pi) == pytest.approx(1 / 8)


def test_the_authors_one_hot_goals_in_gather_leave_108_degrees_free():
    angles = sorted(math.degrees(_authors_angle(number, 0, bins=10)) for number in range(1, 9))
    gaps = [after - before for before, after in zip(angles, [*angles[1:], angles[0] + 360], strict=True)]
    assert gaps == pytest.approx([36] * 7 + [108])
    assert angles[-1] == pytest.approx(113.7, abs=0.1)


@given(
    output=st.lists(st.floats(-1.05, 1.05), min_size=8, max_size=8),
    heading=st.floats(-np.pi, np.pi),
    goal_distance=st.floats(0.5, 20),
)
def test_a_one_hot_goal_is_between_1_m_and_the_goal_distance_away_at_a_multiple_of_45_degrees(
    output, heading, goal_distance
):
    x, y = OneHotOutput().vector(np.array([output]), np.array([heading]), goal_distance)[0]
    assert 1 - 1e-9 <= math.hypot(x, y) <= max(1.05 * goal_distance, 1) + 1e-9
    assert math.remainder(math.atan2(y, x) - heading, math.pi / 4) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
@given(heading=st.floats(-np.pi, np.pi), turn=st.floats(-np.pi, np.pi), seed=st.integers(0, 99))
def test_a_vector_turns_with_the_robot_or_does_not_know_its_heading(name, heading, turn, seed):
    made = make_controller_output(name)
    output = np.tanh(np.random.default_rng(seed).normal(size=(1, made.size)))
    before, after = (made.vector(output, np.array([yaw]), 4.0) for yaw in (heading, heading + turn))
    if TURNS_WITH_THE_ROBOT[name]:
        rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        assert after == pytest.approx(before @ rotation.T, abs=1e-9)
    else:
        assert after.tobytes() == before.tobytes()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_the_outputs_of_a_direction_point_there_at_the_goal_distance(name, heading):
    made, angles = make_controller_output(name), np.arange(-8, 16) * np.pi / 4
    outputs = made.of_direction(angles)
    assert outputs.shape == (24, made.size)
    seen = angles + heading * TURNS_WITH_THE_ROBOT[name]
    expected = 4 * np.stack([np.cos(seen), np.sin(seen)], axis=1)
    assert made.vector(outputs, np.full(24, heading), 4.0) == pytest.approx(expected, abs=1e-9)
    assert np.abs(outputs).max() <= 1


def test_the_outputs_of_a_direction_of_ones_own_are_a_unit_vector_or_the_nearest_of_equal_steps():
    class Three(Polar):
        size = 3

    angles = np.radians([0, 59, 61, 240, 301, -119])
    assert Polar().of_direction(angles) == pytest.approx(np.stack([np.cos(angles), np.sin(angles)], axis=1))
    assert Three().of_direction(angles).argmax(axis=1).tolist() == [0, 0, 1, 2, 0, 2]
    assert Three().of_direction(angles).sum(axis=1).tolist() == [1] * 6


def test_a_one_hot_direction_is_the_nearest_one():
    angles = np.radians([22, 23, -22, 158, -158])
    assert OneHotOutput().of_direction(angles).argmax(axis=1).tolist() == [3, 4, 3, 7, 7]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, -1.0, 1.05, -1.05, 1e-300])
def test_a_vector_is_finite_for_outputs_without_a_direction_and_at_the_limits(name, value):
    made = make_controller_output(name)
    for heading in (0.0, math.pi, -math.pi):
        vector = made.vector(np.full((2, made.size), value), np.full(2, heading), 4.0)
        assert np.isfinite(vector).all()


@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_number_stays_none_so_that_it_is_noticed(name):
    made = make_controller_output(name)
    output = np.zeros((2, made.size))
    output[0] = np.nan
    vector = made.vector(output, np.zeros(2), 4.0)
    assert np.isnan(vector[0]).all()
    assert np.isfinite(vector[1]).all()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_vector_is_float64_and_leaves_its_arguments_as_they_are(name, dtype):
    made = make_controller_output(name)
    rng = np.random.default_rng(1)
    output, heading = rng.uniform(-1, 1, (9, made.size)).astype(dtype), rng.uniform(-4, 4, 9)
    before = (output.copy(), heading.copy())
    vector = made.vector(output, heading, 4.0)
    assert vector.dtype == np.float64
    assert vector.shape == (9, 2)
    for argument, copy in zip((output, heading), before, strict=True):
        assert argument.tobytes() == copy.tobytes()
        assert not np.shares_memory(argument, vector)


@pytest.mark.parametrize("name", NAMES)
def test_a_networks_float32_gives_the_bits_of_the_same_numbers_in_float64(name):
    made = make_controller_output(name)
    output = np.tanh(np.random.default_rng(4).normal(size=(50, made.size))).astype(np.float32)
    narrow, wide = (made.vector(each, np.zeros(50), 4.1) for each in (output, output.astype(np.float64)))
    assert narrow.tobytes() == wide.tobytes()


@pytest.mark.parametrize("name", NAMES)
def test_the_vectors_are_those_of_a_second_implementation(name):
    made = make_controller_output(name)
    rng = np.random.default_rng(2)
    output, heading = rng.uniform(-1.05, 1.05, (200, made.size)), rng.uniform(-4, 4, 200)
    output[:20] = np.round(output[:20])  # ties
    output[20:30] -= 2
    vectors = made.vector(output, heading, 3.7)
    for row, numbers, yaw in zip(vectors, output.tolist(), heading.tolist(), strict=True):
        assert row == pytest.approx(_second_implementation(name, numbers, yaw, 3.7), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_the_bits_of_a_vector_do_not_depend_on_how_many_there_are(name):
    made = make_controller_output(name)
    rng = np.random.default_rng(3)
    output, heading = rng.uniform(-1, 1, (37, made.size)), rng.uniform(-4, 4, 37)
    vectors = made.vector(output, heading, 4.0)
    for count in (1, 2, 3, 8, 17):
        for start in (0, 5, 20):
            part = slice(start, start + count)
            assert made.vector(output[part], heading[part], 4.0).tobytes() == vectors[part].tobytes()


@pytest.mark.parametrize(("name", "output", "size"), [("vector", VectorOutput, 2), ("one_hot", OneHotOutput, 8)])
def test_outputs_are_made_by_name(name, output, size):
    assert CONTROLLER_OUTPUTS.find(name) is output
    assert type(make_controller_output(name)) is output
    assert output.size == size


@pytest.mark.parametrize("refuse", [CONTROLLER_OUTPUTS.find, make_controller_output])
def test_an_unknown_output_is_refused_with_the_nearest_name(refuse):
    message = (
        r"unknown controller output 'onehot'\. Did you mean 'one_hot'\? Known: one_hot, direction, heading_direction, "
        r"heading_vector, vector\. "
        r"Set --controller-output\. Register your own first: shes\.register_controller_output, or --import MODULE"
    )
    with pytest.raises(UnknownNameError, match=message):
        refuse("onehot")


def test_an_own_output_is_made_by_its_name(monkeypatch):
    monkeypatch.setitem(CONTROLLER_OUTPUTS, "polar", Polar)  # forgotten after this test
    register_controller_output("polar", Polar)
    assert isinstance(make_controller_output("polar"), Polar)


class Sizeless(ControllerOutput):
    def vector(self, output, heading, goal_distance):
        return output


class Weighted(Polar):
    def __init__(self, weight):
        self.weight = weight


@pytest.mark.parametrize(
    ("name", "output", "message"),
    [
        (
            "vector",
            Polar,
            r"controller output 'vector' is shes\.hierarchy\.outputs\.VectorOutput already\. Choose another name",
        ),
        ("My Own", Polar, r"controller output name must be lower-case words .*got 'My Own'\. For example: 'my-own-2'"),
        (
            "own",
            VectorOutput(),
            r"must be a subclass of shes\.hierarchy\.outputs\.ControllerOutput, got <.*not an object of it",
        ),
        ("own", dict, r"must be a subclass of .*ControllerOutput, got <class 'dict'>"),
        ("own", ControllerOutput, r"ControllerOutput lacks vector, size\. .*ControllerOutput says what each of them"),
        ("own", Sizeless, r"Sizeless lacks size\."),
        ("own", Weighted, r"Weighted cannot be constructed with no arguments: .*'weight'\. Change its __init__"),
    ],
)
def test_what_is_no_new_output_is_refused(name, output, message):
    before = dict(CONTROLLER_OUTPUTS)
    with pytest.raises(ConfigError, match=message):
        register_controller_output(name, output)
    assert before == CONTROLLER_OUTPUTS


class Sideways(Polar):
    def vector(self, output, heading, goal_distance):
        return super().vector(output, heading, goal_distance).T


def test_an_output_that_is_not_one_vector_for_each_episode_is_refused(monkeypatch):
    monkeypatch.setitem(CONTROLLER_OUTPUTS, "sideways", Sideways)
    message = r"'sideways' must return an array \[N, 2\], .*for 3 episodes it returned shape \(2, 3\), not \(3, 2\)\."
    with pytest.raises(ConfigError, match=message):
        make_controller_output("sideways")
