"""Goal encodings against numbers worked out by hand."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from shes.errors import ConfigError, UnknownNameError
from shes.hierarchy.goals import GOAL_ENCODINGS, AngleEncoding, GoalEncoding, make_goal_encoding, register_goal_encoding
from tests.e2e.own_classes import Vector

HALF = np.sqrt(0.5)


def _encode(vector, heading):
    vector = np.atleast_2d(np.array(vector, dtype=float))
    out = np.full((len(vector), 3), np.nan)
    AngleEncoding().encode(vector, np.hypot(*vector.T), np.broadcast_to(heading, len(vector)).astype(float), out)
    return out


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


@given(x=st.floats(-20, 20), y=st.floats(-20, 20), heading=st.floats(-np.pi, np.pi), turn=st.floats(-np.pi, np.pi))
def test_turning_robot_and_goal_together_changes_nothing(x, y, heading, turn):
    vector = np.array([x, y])
    assume(np.hypot(x, y) > 1e-3)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    assert _encode(rotation @ vector, heading + turn) == pytest.approx(_encode(vector, heading), abs=1e-9)


def test_the_bits_of_a_goals_features_do_not_depend_on_how_many_goals_there_are():
    rng = np.random.default_rng(0)
    vector, heading = rng.normal(size=(37, 2)), rng.uniform(-4, 4, 37)
    # Features stand in front of the primitive's observation, as in the agent.
    inputs = np.zeros((37, 20))
    AngleEncoding().encode(vector, np.hypot(*vector.T), heading, inputs[:, :3])
    for count in (1, 2, 3, 8, 17):
        for start in (0, 5, 20):
            part = slice(start, start + count)
            few = np.zeros((count, 20))
            AngleEncoding().encode(vector[part], np.hypot(*vector[part].T), heading[part], few[:, :3])
            assert few.tobytes() == inputs[part].tobytes()


def test_encodings_are_made_by_name():
    assert isinstance(make_goal_encoding("angle"), AngleEncoding)
    assert AngleEncoding.size == 3


def test_an_unknown_encoding_is_refused_with_the_nearest_name():
    with pytest.raises(
        UnknownNameError, match=r"goal encoding 'angel'\. Did you mean 'angle'\?.*--goal-encoding.*Register your own"
    ):
        make_goal_encoding("angel")


def test_an_own_encoding_is_made_by_its_name(monkeypatch):
    monkeypatch.setitem(GOAL_ENCODINGS, "vector", Vector)  # forgotten after this test
    register_goal_encoding("vector", Vector)
    assert isinstance(make_goal_encoding("vector"), Vector)


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
