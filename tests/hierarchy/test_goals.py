"""Goal encodings against numbers worked out by hand, a second implementation, and the contract of every encoding."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from shes.errors import ConfigError, UnknownNameError
from shes.hierarchy.goals import (
    GOAL_ENCODINGS,
    AngleEncoding,
    GoalEncoding,
    MetreAngleEncoding,
    UnitVectorEncoding,
    VectorEncoding,
    make_goal_encoding,
    register_goal_encoding,
)
from tests.e2e.own_classes import Vector

HALF = np.sqrt(0.5)


NAMES = sorted(GOAL_ENCODINGS)
IN_THE_ROBOTS_FRAME = {"angle": True, "angle_metres": True, "unit_vector": False, "vector": False}
DEGENERATE = [(0, 0), (-0.0, 0.0), (1e-3, 0), (1e-170, -1e-170), (2e-162, 0), (5e-324, 5e-324), (-1e9, 1e9)]


def _length(vector):
    return np.sqrt(vector[:, 0] * vector[:, 0] + vector[:, 1] * vector[:, 1])  # as the agent measures it


def _encode(vector, heading, encoding=AngleEncoding):
    vector = np.atleast_2d(np.array(vector, dtype=float))
    out = np.full((len(vector), encoding.size), np.nan)
    encoding().encode(vector, _length(vector), np.broadcast_to(heading, len(vector)).astype(float), out)
    return out


def _rotated(vector, turn):
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.asarray(vector, dtype=float) @ rotation.T


def _second_implementation(name, x, y, heading):
    distance = math.hypot(x, y)
    unit = complex(x, y) / distance if distance else complex(0, 0)
    ahead = complex(x, y) * complex(math.cos(heading), -math.sin(heading))  # as the robot sees it
    seen = ahead / abs(ahead) if distance else complex(math.cos(heading), -math.sin(heading))
    return {
        "angle": (seen.imag, seen.real, distance / 1000),
        "angle_metres": (seen.imag, seen.real, distance),
        "unit_vector": (unit.real, unit.imag, distance / 1000),
        "vector": (x, y),
    }[name]


@pytest.mark.parametrize(
    ("vector", "heading", "expected"),
    [
        ((3, 0), 0, (0, 1, 0.003)),  # straight ahead
        ((0, 4), 0, (1, 0, 0.004)),  # to the left
        ((0, -4), 0, (-1, 0, 0.004)),  # to the right
        ((-2, 0), 0, (0, -1, 0.002)),  # behind
        ((0, 3), np.pi / 2, (0, 1, 0.003)),  # facing +y: straight ahead
        ((3, 0), np.pi / 2, (-1, 0, 0.003)),  # facing +y: to the right
        ((-3, 0), np.pi / 2, (1, 0, 0.003)),  # facing +y: to the left
        ((0, -5), np.pi / 2, (0, -1, 0.005)),  # facing +y: behind
        ((3, 4), 0, (0.8, 0.6, 0.005)),
        ((3, 4), np.pi / 2, (-0.6, 0.8, 0.005)),
        ((1, 1), -np.pi / 4, (1, 0, np.sqrt(2) / 1000)),
        ((-1, -1), np.pi, (HALF, HALF, np.sqrt(2) / 1000)),  # half behind, facing -x: ahead to the left
        ((600, 800), 0, (0.8, 0.6, 1.0)),
    ],
)
def test_the_angle_encoding_of_a_goal_is_that_worked_out_by_hand(vector, heading, expected):
    assert _encode(vector, heading)[0] == pytest.approx(expected, abs=1e-12)


def test_exactly_at_the_goal_the_features_are_finite_and_the_distance_is_zero():
    sine, cosine, distance = _encode((0, 0), 0.3)[0]
    assert distance == 0
    assert sine**2 + cosine**2 == pytest.approx(1)


@pytest.mark.parametrize("heading", [0, 0.7, -3])
@pytest.mark.parametrize(
    ("vector", "unit_vector", "distance"),
    [
        ((3, 0), (1, 0), 3),
        ((0, -4), (0, -1), 4),
        ((-3, 4), (-0.6, 0.8), 5),
        ((-2, -2), (-HALF, -HALF), np.sqrt(8)),
        ((600, 800), (0.6, 0.8), 1000),
        ((1e-3, 0), (1, 0), 1e-3),
        ((0, 0), (0, 0), 0),  # at the goal: no direction
    ],
)
def test_the_encodings_in_the_world_frame_are_those_worked_out_by_hand(vector, heading, unit_vector, distance):
    assert _encode(vector, heading, UnitVectorEncoding)[0] == pytest.approx((*unit_vector, distance / 1000), abs=1e-15)
    assert _encode(vector, heading, VectorEncoding)[0].tolist() == list(vector)


@pytest.mark.parametrize(
    ("vector", "heading", "expected"),
    [
        ((0, 4), 0, (1, 0, 4)),
        ((-2, 0), 0, (0, -1, 2)),
        ((3, 4), np.pi / 2, (-0.6, 0.8, 5)),
        ((600, 800), 0, (0.8, 0.6, 1000)),
    ],
)
def test_the_encoding_in_metres_is_that_worked_out_by_hand(vector, heading, expected):
    assert _encode(vector, heading, MetreAngleEncoding)[0] == pytest.approx(expected, abs=1e-12)


def test_the_encoding_in_metres_has_the_angle_of_the_angle_encoding_to_the_bit():
    vector = np.random.default_rng(1).normal(size=(50, 2)) * 4
    metres, angle = _encode(vector, 0.4, MetreAngleEncoding), _encode(vector, 0.4)
    assert metres[:, :2].tobytes() == angle[:, :2].tobytes()
    assert metres[:, 2] / 1000 == pytest.approx(angle[:, 2], rel=1e-15)


def test_normalised_the_distance_over_1000_stays_below_006_and_the_distance_in_metres_does_not():
    vector = np.random.default_rng(2).uniform(-4, 4, (1000, 2))
    largest = {}
    for encoding in (AngleEncoding, MetreAngleEncoding):
        seen = _encode(vector, 0, encoding)
        normalised = (seen - seen.mean(axis=0)) / np.maximum(seen.std(axis=0), 0.1)  # as the networks see it
        largest[encoding] = np.abs(normalised[:, 2]).max()
    assert largest[AngleEncoding] < 0.06
    assert largest[MetreAngleEncoding] > 1


@given(x=st.floats(-20, 20), y=st.floats(-20, 20), heading=st.floats(-np.pi, np.pi), turn=st.floats(-np.pi, np.pi))
def test_turning_robot_and_goal_together_changes_nothing(x, y, heading, turn):
    assume(np.hypot(x, y) > 1e-3)
    for name in ("angle", "angle_metres"):
        before = _encode((x, y), heading, GOAL_ENCODINGS[name])
        after = _encode(_rotated((x, y), turn), heading + turn, GOAL_ENCODINGS[name])
        assert after == pytest.approx(before, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_an_encoding_is_in_the_robots_frame_or_does_not_know_the_heading_and_turns_with_the_goal(name):
    encoding = GOAL_ENCODINGS[name]
    before, turned = _encode((3, 1), 0.3, encoding), _encode(_rotated((3, 1), 2.0), 2.3, encoding)
    if IN_THE_ROBOTS_FRAME[name]:
        assert turned == pytest.approx(before, abs=1e-12)
    else:
        assert turned[:, :2] == pytest.approx(_rotated(before[:, :2], 2.0), abs=1e-12)
        assert turned[:, 2:] == pytest.approx(before[:, 2:], abs=1e-12)
        assert turned != pytest.approx(before, abs=0.1)
        assert _encode((3, 1), -1.2, encoding).tobytes() == before.tobytes()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("vector", DEGENERATE)
def test_features_are_finite_also_at_the_goal_and_next_to_it(name, vector):
    for heading in (0.0, -np.pi, 3.1):
        features = _encode(vector, heading, GOAL_ENCODINGS[name])
        assert np.isfinite(features).all()
        if name != "vector":
            assert (np.abs(features[0, :2]) <= 1.5).all()  # the squares of the shortest vectors are rounded coarsely


@pytest.mark.parametrize("name", NAMES)
def test_every_feature_is_written_and_no_argument_is_changed(name):
    rng = np.random.default_rng(3)
    vector, heading = rng.normal(size=(9, 2)), rng.uniform(-4, 4, 9)
    distance = _length(vector)
    before = [vector.copy(), distance.copy(), heading.copy()]
    encoding = make_goal_encoding(name)
    inputs = np.full((9, encoding.size + 4), np.nan)
    encoding.encode(vector, distance, heading, inputs[:, : encoding.size])
    assert np.isfinite(inputs[:, : encoding.size]).all()
    assert np.isnan(inputs[:, encoding.size :]).all()
    for argument, copy in zip((vector, distance, heading), before, strict=True):
        assert argument.tobytes() == copy.tobytes()


@pytest.mark.parametrize("name", NAMES)
def test_the_features_are_those_of_a_second_implementation(name):
    rng = np.random.default_rng(4)
    vector, heading = rng.normal(size=(200, 2)) * 5, rng.uniform(-4, 4, 200)
    vector[:3] = [(0, 0), (2, 0), (0, -3)]
    encoded = np.full((200, GOAL_ENCODINGS[name].size), np.nan)
    make_goal_encoding(name).encode(vector, _length(vector), heading, encoded)
    for row, (x, y), yaw in zip(encoded, vector.tolist(), heading.tolist(), strict=True):
        assert row == pytest.approx(_second_implementation(name, x, y, yaw), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_the_bits_of_a_goals_features_do_not_depend_on_how_many_goals_there_are(name):
    encoding, size = make_goal_encoding(name), GOAL_ENCODINGS[name].size
    rng = np.random.default_rng(0)
    vector, heading = rng.normal(size=(37, 2)), rng.uniform(-4, 4, 37)
    # Features stand in front of the primitive's observation, as in the agent.
    inputs = np.zeros((37, 20))
    encoding.encode(vector, _length(vector), heading, inputs[:, :size])
    for count in (1, 2, 3, 8, 17):
        for start in (0, 5, 20):
            part = slice(start, start + count)
            few = np.zeros((count, 20))
            encoding.encode(vector[part], _length(vector[part]), heading[part], few[:, :size])
            assert few.tobytes() == inputs[part].tobytes()


@pytest.mark.parametrize(
    ("name", "encoding", "size"),
    [
        ("angle", AngleEncoding, 3),
        ("unit_vector", UnitVectorEncoding, 3),
        ("vector", VectorEncoding, 2),
        ("angle_metres", MetreAngleEncoding, 3),
    ],
)
def test_encodings_are_made_by_name(name, encoding, size):
    assert type(make_goal_encoding(name)) is encoding
    assert encoding.size == size


def test_an_unknown_encoding_is_refused_with_the_nearest_name():
    with pytest.raises(
        UnknownNameError, match=r"goal encoding 'angel'\. Did you mean 'angle'\?.*--goal-encoding.*Register your own"
    ):
        make_goal_encoding("angel")


def test_an_own_encoding_is_made_by_its_name(monkeypatch):
    monkeypatch.setitem(GOAL_ENCODINGS, "own-vector", Vector)  # forgotten after this test
    register_goal_encoding("own-vector", Vector)
    assert isinstance(make_goal_encoding("own-vector"), Vector)


class Sizeless(GoalEncoding):
    def encode(self, vector, distance, heading, out):
        out[:] = 0


@pytest.mark.parametrize(
    ("name", "encoding", "message"),
    [
        (
            "angle",
            Vector,
            r"goal encoding 'angle' is shes\.hierarchy\.goals\.AngleEncoding already\. Choose another name",
        ),
        ("My Own", Vector, r"goal encoding name must be lower-case words .*got 'My Own'\. For example: 'my-own-2'"),
        (
            "own",
            AngleEncoding(),
            r"must be a subclass of shes\.hierarchy\.goals\.GoalEncoding, got <.*not an object of it",
        ),
        ("own", dict, r"must be a subclass of .*GoalEncoding, got <class 'dict'>"),
        ("own", GoalEncoding, r"GoalEncoding lacks encode, size\. .*GoalEncoding says what each of them is: add them"),
        ("own", Sizeless, r"Sizeless lacks size\."),
    ],
)
def test_what_is_no_new_encoding_is_refused(name, encoding, message):
    before = dict(GOAL_ENCODINGS)
    with pytest.raises(ConfigError, match=message):
        register_goal_encoding(name, encoding)
    assert before == GOAL_ENCODINGS


class Forgetful(Vector):
    size = 4


def test_an_encoding_that_does_not_write_all_its_features_is_refused(monkeypatch):
    monkeypatch.setitem(GOAL_ENCODINGS, "forgetful", Forgetful)
    message = (
        r"'forgetful' must write .* each of its 4 features .*left \[1\.0, 1\.0, 1\.414.*, nan\]\. .*change its `size`"
    )
    with pytest.raises(ConfigError, match=message):
        make_goal_encoding("forgetful")
