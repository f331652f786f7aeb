"""The following view: nothing stands between the camera and the robot, wherever the robot is."""

import mujoco
import numpy as np
import pytest

from shes.drawing.flat_renderer import FlatRenderer
from shes.drawing.follow import follow_view
from shes.drawing.scenery import FOLLOW_FIELD_OF_VIEW_DEG, decorate
from shes.envs.registry import make_task

PLACES = [
    *(("ant-gather", place) for place in [(0, 0), (0, -11.3), (0, 11.3), (11.3, 0), (-11.3, -11.3)]),
    *(("point-gather", place) for place in [(0, -11.7), (11.7, 11.7), (-11.7, -11.7)]),
    *(("ant-maze", place) for place in [(0, -3.2), (0, 12.8), (16, -3.2)]),
    *(("ant-push", place) for place in [(0, -3.2), (0, 12.8), (0, 19)]),
    *(("ant-fall", place) for place in [(0, 0), (0, 12.8, 0.75), (8, 12.8, 0.75), (0, 16, 0.75)]),
]


def look(name, place):
    """Return the model, the state and the view of the robot at `place`."""
    task = make_task(name, 1)
    model = decorate(task.build_world(task.body, task.options)).compile()
    data = mujoco.MjData(model)
    data.qpos[: len(place)] = place
    mujoco.mj_forward(model, data)
    return model, data, follow_view(model, data, FlatRenderer(model, 64, 64).extent)


def first_hit(model, data, start, end):
    """Return the name of the first geom between two points; an empty string if there is none."""
    found = np.array([-1], dtype=np.int32)
    distance = mujoco.mj_ray(model, data, start, end - start, None, True, -1, found)
    return model.geom(int(found[0])).name if 0 <= distance <= 1 else ""


@pytest.mark.parametrize(("name", "place"), PLACES)
def test_nothing_hides_the_robot_from_the_camera(name, place):
    model, data, view = look(name, place)
    torso = data.xpos[model.body("torso").id]
    seen = first_hit(model, data, view.eye, torso)
    assert seen
    assert not seen.startswith(("wall", "block", "platform", "floor"))


@pytest.mark.parametrize(("name", "place"), PLACES)
def test_the_robot_is_inside_the_picture(name, place):
    model, data, view = look(name, place)
    offset = data.xpos[model.body("torso").id] - view.eye
    forward = (view.lookat - view.eye) / view.distance
    right = np.array([1.0, 0.0, 0.0])
    up = np.cross(right, forward)
    limit = np.tan(np.deg2rad(FOLLOW_FIELD_OF_VIEW_DEG / 2))
    assert np.abs([offset @ right, offset @ up]).max() < 0.9 * limit * (offset @ forward)


def test_in_the_open_the_camera_is_behind_and_above_the_robot():
    _, data, view = look("ant-gather", (3, -4))
    np.testing.assert_array_equal(view.lookat, data.xpos[1])
    np.testing.assert_allclose(view.eye - view.lookat, 11 * np.array([0, -np.cos(0.733), np.sin(0.733)]), atol=1e-2)


def test_the_camera_moves_smoothly_along_the_way_to_a_wall():
    eyes = np.array([look("point-fall", (0, y, 0.5))[2].eye for y in np.arange(12.3, 16, 0.1)])
    assert np.linalg.norm(np.diff(eyes, axis=0), axis=1).max() < 2


def test_near_a_wall_most_of_the_picture_is_the_arena():
    """At the southern wall, half of a picture with the robot in its middle would be wall."""
    _, _, view = look("ant-gather", (0, -11.3))
    lower_edge = np.deg2rad(-view.elevation + FOLLOW_FIELD_OF_VIEW_DEG / 2)
    assert view.eye[1] + view.eye[2] / np.tan(lower_edge) > -14.5
