"""Pictures by both renderers, with and without OpenGL, and the outlines of worlds."""

import os
from collections import Counter

import mujoco
import numpy as np
import pytest

from shes.drawing.make_drawer import find_opengl, make_drawer
from shes.drawing.renderer import between, extent_of, outlines
from shes.envs.markers import FOOD, GOAL, ROBOT, Marker
from shes.envs.named_environments import ENVIRONMENTS
from tests.envs.episodes import make_task

SIZE = 390
WALL = (122 / 255, 130 / 255, 143 / 255)


@pytest.fixture(params=["flat", pytest.param("opengl", marks=pytest.mark.render)])
def make(request, monkeypatch):
    """Return a function that makes a task and a drawer of it, for the renderer of the test."""
    if request.param == "flat":
        monkeypatch.setenv("MUJOCO_GL", "off")
    find_opengl.cache_clear()
    if request.param == "opengl" and find_opengl() is None:
        pytest.skip("there is no OpenGL here (EGL or OSMesa)")
    drawers = []

    def made(name="ant-gather", size=SIZE):
        task = make_task(name, 1)
        task.reset(np.array([0]), [1])
        drawers.append(make_drawer(task, size, size))
        return task, drawers[-1]

    yield made
    for drawer in drawers:
        drawer.close()
    find_opengl.cache_clear()


def is_hue(picture, color):
    """Return where a picture has about the hue of `color` [H, W], whatever the light."""
    wanted = np.array(color[:3]) / np.linalg.norm(color[:3])
    return picture / np.maximum(np.linalg.norm(picture, axis=2, keepdims=True), 1) @ wanted > 0.985


def around(picture, x, y, extent):
    """Return the pixels next to (x, y) metres of a picture from above."""
    left, bottom, right, top = extent
    column = int((x - left) / (right - left) * len(picture))
    row = int((top - y) / (top - bottom) * len(picture))
    return picture[row - 1 : row + 2, column - 1 : column + 2]


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_every_environment_is_drawn_with_its_robot(make, name):
    task, drawer = make(name)
    for camera in drawer.cameras:
        picture = drawer.draw(task.sim.qpos[0], task.markers(0), camera)
        assert (picture.shape, picture.dtype) == ((SIZE, SIZE, 3), np.uint8)
        assert picture.std() > 5
        assert is_hue(picture, ROBOT).sum() > 5


def test_markers_lie_where_they_are_said_to(make):
    task, drawer = make()
    markers = [
        Marker("ball", (5, 4, 0.4), 0.4, FOOD),
        Marker("disc", (-6, 2, 0.1), 0.5, GOAL),
        Marker("line", (-8, -8, 0.1), 0.1, (*GOAL[:3], 1.0), (-2, -8, 0.1)),
    ]
    bare, picture, again = (drawer.draw(task.sim.qpos[0], each, "top") for each in ((), markers, ()))
    np.testing.assert_array_equal(bare, again)
    for x, y, color in ((5, 4, FOOD), (-6, 2, GOAL), (-5, -8, GOAL)):
        assert is_hue(around(picture, x, y, drawer.extent), color).any()
        assert not is_hue(around(bare, x, y, drawer.extent), color).any()
    assert not is_hue(around(picture, -5, -7, drawer.extent), GOAL).any()


def test_the_following_picture_has_the_robot_in_its_middle(make):
    task, drawer = make("point-gather")
    task.sim.qpos[0, :2] = (7, -3)
    picture = drawer.draw(task.sim.qpos[0], (), "follow")
    middle = slice(SIZE // 2 - 3, SIZE // 2 + 3)
    assert is_hue(picture[middle, middle], ROBOT).all()


@pytest.mark.render
@pytest.mark.parametrize("make", ["opengl"], indirect=True)
def test_the_opengl_found_is_used_whatever_the_environment_says(make, monkeypatch):
    monkeypatch.setenv("PYOPENGL_PLATFORM", "other")
    task, drawer = make("point-gather")
    assert drawer.draw(task.sim.qpos[0]).std() > 10
    assert os.environ["PYOPENGL_PLATFORM"] == find_opengl()


@pytest.mark.parametrize("make", ["flat"], indirect=True)
def test_walls_are_at_the_rim_and_legs_reach_out_of_the_torso(make):
    task, drawer = make(size=780)
    assert drawer.extent == pytest.approx((-13, -13, 13, 13))
    picture = drawer.draw(task.sim.model.qpos0, (), "top")
    for x, y, color in [
        (12.5, 0, WALL),
        *((i * reach, j * reach, ROBOT) for i in (-1, 1) for j in (-1, 1) for reach in (0.25, 0.4, 0.55, 0.78)),
    ]:
        near = around(picture, x, y, drawer.extent).astype(int)
        assert (np.abs(near - 255 * np.array(color[:3])).max(axis=2) <= 16).any(), (x, y)
    assert not is_hue(around(picture, 0.6, 0, drawer.extent), ROBOT).any()


def outlines_of(spec):
    model = spec.compile()
    return outlines(model, mujoco.MjData(model))


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_the_outlines_of_a_world_leave_its_start_free(name):
    found = outlines_of(make_task(name, 1).world_to_draw())
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
    assert extent_of(spec.compile())[:3:2] == (2.5, 3.5)
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 2, 3], pos=[9, 0, 3])
    block, table = outlines_of(spec)
    assert (block.kind, table.kind) == ("block", "wall")
    np.testing.assert_allclose(block.corners, [[2.5, -1], [3.5, -1], [3.5, 1], [2.5, 1]])


def test_a_pose_between_two_is_between_them():
    task = make_task("ant-gather", 1)
    task.reset(np.array([0]), [1])
    start, model = task.sim.qpos[0].copy(), task.sim.model
    end = start.copy()
    end[0] += 2
    end[3:7] = (np.cos(0.5), 0, 0, np.sin(0.5))
    half = between(model, start, end, 0.5)
    assert half[0] == pytest.approx(start[0] + 1)
    assert np.linalg.norm(half[3:7]) == pytest.approx(1)
    np.testing.assert_allclose(between(model, start, end, 0), start, atol=1e-12)
    np.testing.assert_allclose(between(model, start, end, 1), end, atol=1e-9)
