"""Flat pictures: geoms and markers are drawn at their positions."""

import numpy as np
import pytest

from shes.drawing.flat_renderer import FlatRenderer
from shes.drawing.rendering import make_renderer
from shes.envs.markers import FOOD, GOAL, ROBOT, ball, disc, line
from shes.envs.registry import ENVIRONMENTS, make_task
from shes.errors import ConfigError, UnknownNameError

SIZE = 780


def rgb(color):
    return np.array([round(255 * part) for part in color[:3]])


def is_colored(picture, x, y, color, renderer):
    """Return whether a pixel at (x, y) metres, or next to it, of a picture from above has `color`."""
    left, bottom, right, top = renderer.extent
    column = int((x - left) / (right - left) * SIZE)
    row = int((top - y) / (top - bottom) * SIZE)
    around = picture[row - 1 : row + 2, column - 1 : column + 2].astype(int)
    return (np.abs(around - rgb(color)).max(axis=2) <= 16).any()


def make(name="ant-gather"):
    task = make_task(name, 1)
    task.reset(np.array([0]), [1])
    return task, FlatRenderer(task.build_world(task.body, task.options).compile(), SIZE, SIZE)


@pytest.mark.parametrize("name", ENVIRONMENTS)
@pytest.mark.parametrize("camera", [pytest.param("follow", marks=pytest.mark.slow), "top"])
def test_every_environment_is_drawn_with_its_robot(name, camera):
    task, renderer = make(name)
    picture = renderer.draw(task.sim.qpos[0], task.markers(0), camera)
    assert picture.shape == (SIZE, SIZE, 3)
    assert picture.dtype == np.uint8
    assert (np.abs(picture.astype(int) - rgb(ROBOT)).max(axis=2) < 12).sum() > 5


def test_markers_lie_where_they_are_said_to():
    task, renderer = make()
    markers = [
        ball((5, 4, 0.4), 0.4, FOOD),
        disc((-6, 2, 0), 0.5, GOAL),
        line((-8, -8, 0), (-2, -8, 0), 0.1, (*GOAL[:3], 1.0)),
    ]
    picture = renderer.draw(task.sim.qpos[0], markers, "top")
    assert is_colored(picture, 5, 4, FOOD, renderer)
    assert is_colored(picture, -6, 2, GOAL, renderer)
    assert is_colored(picture, -5, -8, GOAL, renderer)
    assert not is_colored(picture, -5, -7, GOAL, renderer)


def test_the_robot_is_in_the_middle_of_the_picture_that_follows_it():
    task, renderer = make("point-gather")
    task.sim.qpos[0, :2] = (7, -3)
    picture = renderer.draw(task.sim.qpos[0], (), "follow")
    assert np.abs(picture[SIZE // 2, SIZE // 2].astype(int) - rgb(ROBOT)).max() < 12


def test_walls_are_at_the_rim_and_legs_reach_out_of_the_torso():
    task, renderer = make()
    assert renderer.extent == pytest.approx((-13, -13, 13, 13))
    task.sim.qpos[0] = task.sim.model.qpos0
    picture = renderer.draw(task.sim.qpos[0], (), "top")
    assert is_colored(picture, 12.5, 0, (122 / 255, 130 / 255, 143 / 255), renderer)
    for x, y in ((0.45, 0.45), (-0.45, 0.45), (0.45, -0.45), (-0.45, -0.45)):
        assert is_colored(picture, x, y, ROBOT, renderer), (x, y)
    assert not is_colored(picture, 0.6, 0, ROBOT, renderer)


def test_a_camera_that_there_is_not_is_refused():
    task, renderer = make()
    with pytest.raises(UnknownNameError, match="unknown camera 'side'"):
        renderer.draw(task.sim.qpos[0], (), "side")


@pytest.mark.parametrize("size", [(8, 100), (100, 4000), ("big", 100), (100.5, 100)])
def test_a_size_out_of_range_is_refused(size):
    task, _ = make()
    with pytest.raises(ConfigError, match="must be 16 to 2048 pixels"):
        make_renderer(lambda: task.build_world(task.body, task.options), *size)
