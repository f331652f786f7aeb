"""Goal encodings against numbers worked out by hand."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from shes.errors import UnknownNameError
from shes.hierarchy.goals import AngleEncoding, make_goal_encoding

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
    with pytest.raises(UnknownNameError, match=r"goal encoding 'angel'\. Did you mean 'angle'\?.*--goal-encoding"):
        make_goal_encoding("angel")
