"""Flat pictures: geoms and markers are drawn at their positions, and the outlines of worlds are to scale."""

import itertools
from collections import Counter

import mujoco
import numpy as np
import pytest

from shes.drawing.flat_renderer import FlatRenderer
from shes.drawing.make_drawer import make_renderer
from shes.drawing.renderer import outlines
from shes.envs.markers import FOOD, GOAL, ROBOT, ball, disc, line
from shes.envs.named_environments import ENVIRONMENTS, make_task
from shes.errors import ConfigError, UnknownNameError

SIZE = 780
WALL = (122 / 255, 130 / 255, 143 / 255)


def is_colored(picture, x, y, color, renderer):
    """Return whether a pixel at (x, y) metres, or next to it, of a picture from above has `color`."""
    left, bottom, right, top = renderer.extent
    column = int((x - left) / (right - left) * SIZE)
    row = int((top - y) / (top - bottom) * SIZE)
    around = picture[row - 1 : row + 2, column - 1 : column + 2].astype(int)
    return (np.abs(around - 255 * np.array(color[:3])).max(axis=2) <= 16).any()


def make(name="ant-gather"):
    task = make_task(name, 1)
    task.reset(np.array([0]), [1])
    return task, FlatRenderer(task.world_to_draw().compile(), SIZE, SIZE)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_every_environment_is_drawn_with_its_robot(name):
    task, renderer = make(name)
    picture = renderer.draw(task.sim.qpos[0], task.markers(0), "top")
    assert (picture.shape, picture.dtype) == ((SIZE, SIZE, 3), np.uint8)
    assert (np.abs(picture - 255 * np.array(ROBOT[:3])).max(axis=2) < 12).sum() > 5


def test_markers_lie_where_they_are_said_to():
    task, renderer = make()
    markers = [
        ball((5, 4, 0.4), 0.4, FOOD),
        disc((-6, 2, 0), 0.5, GOAL),
        line((-8, -8, 0), (-2, -8, 0), 0.1, (*GOAL[:3], 1.0)),
    ]
    picture = renderer.draw(task.sim.qpos[0], markers, "top")
    for x, y, color in ((5, 4, FOOD), (-6, 2, GOAL), (-5, -8, GOAL)):
        assert is_colored(picture, x, y, color, renderer)
    assert not is_colored(picture, -5, -7, GOAL, renderer)


def test_the_following_picture_has_the_robot_in_its_middle():
    task, renderer = make("point-gather")
    task.sim.qpos[0, :2] = (7, -3)
    picture = renderer.draw(task.sim.qpos[0], (), "follow")
    assert np.abs(picture[SIZE // 2, SIZE // 2] - 255 * np.array(ROBOT[:3])).max() < 12


def test_walls_are_at_the_rim_and_legs_reach_out_of_the_torso():
    task, renderer = make()
    assert renderer.extent == pytest.approx((-13, -13, 13, 13))
    picture = renderer.draw(task.sim.model.qpos0, (), "top")
    assert is_colored(picture, 12.5, 0, WALL, renderer)
    for x, y in itertools.product((-1, 1), (-1, 1)):
        assert all(
            is_colored(picture, x * reach, y * reach, ROBOT, renderer) for reach in (0.25, 0.35, 0.45, 0.55, 0.7)
        )
    assert not is_colored(picture, 0.6, 0, ROBOT, renderer)


def test_a_camera_or_a_size_that_there_is_not_is_refused():
    task, renderer = make()
    with pytest.raises(UnknownNameError, match="unknown camera 'side'"):
        renderer.draw(task.sim.qpos[0], (), "side")
    for size in ((8, 100), (100, 4000), ("big", 100), (100.5, 100)):
        with pytest.raises(ConfigError, match="must be 16 to 2048 pixels"):
            make_renderer(task.world_to_draw, *size)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_the_outlines_of_a_world_leave_its_start_free(name):
    found = outlines(make_task(name, 1).world_to_draw().compile())
    kinds = Counter(outline.kind for outline in found)
    assert kinds["wall"] >= 4
    assert kinds["block"] == name.endswith(("push", "fall"))
    for outline in found:
        low, high = outline.corners.min(axis=0), outline.corners.max(axis=0)
        assert outline.kind == "platform" or not ((low < 0) & (high > 0)).all()
    order = [outline.kind for outline in found if name == "ant-fall"]  # the lowest comes first
    assert order == sorted(order, key=["platform", "wall", "block"].index)


def test_a_moving_box_that_is_no_block_belongs_to_the_robot():
    spec = mujoco.MjSpec()
    for name, x in (("block", 3.0), ("torso", 0.0)):
        body = spec.worldbody.add_body(name=name, pos=[x, 0, 1])
        body.add_freejoint()
        body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.5, 1, 1])
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 2, 3], pos=[9, 0, 3])
    block, table = outlines(spec.compile())
    assert (block.kind, table.kind) == ("block", "wall")
    np.testing.assert_allclose(block.corners, [[2.5, -1], [3.5, -1], [3.5, 1], [2.5, 1]])
