"""Three-dimensional pictures. They need OpenGL, so these tests are extras."""

import mujoco
import numpy as np
import pytest

from shes.drawing.mujoco_renderer import MujocoRenderer
from shes.drawing.opengl import find_opengl
from shes.drawing.renderer import between
from shes.drawing.scenery import decorate
from shes.envs.markers import FOOD, GOAL, ROBOT, ball, disc, line
from shes.envs.registry import ENVIRONMENTS, make_task

SIZE = 200


def make(name="ant-gather"):
    found = find_opengl()
    if found is None:
        pytest.skip("there is no OpenGL here (EGL or OSMesa)")
    task = make_task(name, 1)
    task.reset(np.array([0]), [1])
    return task, MujocoRenderer(task.build_world(task.body, task.options), SIZE, SIZE, found)


def share(picture, color):
    """Return the share of pixels with about the hue of `color`."""
    wanted = np.array(color[:3]) / np.linalg.norm(color[:3])
    seen = picture / np.maximum(np.linalg.norm(picture, axis=2, keepdims=True), 1)
    return float(((seen @ wanted) > 0.985).mean())


@pytest.mark.render
@pytest.mark.parametrize("name", ENVIRONMENTS)
@pytest.mark.parametrize("camera", ["follow", "top"])
def test_every_environment_is_drawn_with_its_robot(name, camera):
    task, renderer = make(name)
    picture = renderer.draw(task.sim.qpos[0], task.markers(0), camera)
    renderer.close()
    assert picture.shape == (SIZE, SIZE, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 10
    assert share(picture, ROBOT) > 1e-4


@pytest.mark.render
def test_markers_are_seen():
    task, renderer = make()
    bare = renderer.draw(task.sim.qpos[0], (), "top")
    markers = [
        ball((5, 4, 0.4), 1.4, FOOD),
        disc((-6, 2, 0.1), 1.5, GOAL),
        line((-8, -8, 0.1), (8, -8, 0.1), 0.1, GOAL),
    ]
    shown = renderer.draw(task.sim.qpos[0], markers, "top")
    again = renderer.draw(task.sim.qpos[0], (), "top")
    renderer.close()
    np.testing.assert_array_equal(bare, again)
    for color in (FOOD, GOAL):
        assert share(shown, color) > share(bare, color) + 0.002
    row = round((13 + 8) / 26 * SIZE)  # of the line
    assert share(shown[row - 2 : row + 3], GOAL) > 0.1


@pytest.mark.render
def test_the_camera_follows_the_robot():
    task, renderer = make("point-gather")
    pictures = []
    for x in (-8.0, 8.0):
        task.sim.qpos[0, :2] = (x, 0)
        picture = renderer.draw(task.sim.qpos[0], (), "follow")
        middle = picture[SIZE * 2 // 5 : SIZE * 3 // 5, SIZE * 2 // 5 : SIZE * 3 // 5]
        assert share(middle, ROBOT) > 0.01
        pictures.append(picture)
    renderer.close()
    assert (pictures[0] != pictures[1]).any()


@pytest.mark.render
@pytest.mark.parametrize(("name", "place"), [("point-gather", (0, -11.7)), ("ant-fall", (8, 12.8, 0.75))])
def test_the_following_camera_sees_the_robot_behind_a_wall(name, place):
    task, renderer = make(name)
    task.sim.qpos[0, : len(place)] = place
    picture = renderer.draw(task.sim.qpos[0], (), "follow")
    renderer.close()
    assert share(picture, ROBOT) > 0.002


def test_looks_are_for_a_copy_and_change_nothing_that_a_robot_in_the_open_feels():
    task = make_task("ant-gather", 1)
    plain = task.build_world(task.body, task.options).compile()
    pretty = decorate(task.build_world(task.body, task.options)).compile()
    assert (plain.nq, plain.nv, plain.nu, plain.ngeom) == (pretty.nq, pretty.nv, pretty.nu, pretty.ngeom)
    states = []
    for model in (plain, pretty):
        data = mujoco.MjData(model)
        data.ctrl[:] = 20
        for _ in range(100):
            mujoco.mj_step(model, data)
        states.append(data.qpos.copy())
    np.testing.assert_array_equal(*states)


def test_walls_are_drawn_low_and_stand_where_they_stood():
    task = make_task("ant-gather", 1)
    plain = task.build_world(task.body, task.options).compile()
    pretty = decorate(task.build_world(task.body, task.options)).compile()
    walls = [i for i in range(plain.ngeom) if plain.geom(i).name.startswith("wall")]
    assert walls
    for wall in walls:
        np.testing.assert_array_equal(pretty.geom_pos[wall, :2], plain.geom_pos[wall, :2])
        np.testing.assert_array_equal(pretty.geom_size[wall, :2], plain.geom_size[wall, :2])
        for model, height in ((plain, 4.0), (pretty, 0.8)):
            assert model.geom_pos[wall, 2] - model.geom_size[wall, 2] == pytest.approx(0)
            assert model.geom_pos[wall, 2] + model.geom_size[wall, 2] == pytest.approx(height)


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
