"""Three-dimensional pictures, which need OpenGL; and the looks of worlds and the following camera, which do not."""

import os

import mujoco
import numpy as np
import pytest

from shes.drawing.make_drawer import find_opengl
from shes.drawing.mujoco_renderer import FOLLOW_FIELD_OF_VIEW_DEG, MujocoRenderer, decorate, follow
from shes.drawing.renderer import between, extent_of
from shes.envs.markers import FOOD, GOAL, ROBOT, ball, disc, line
from shes.envs.named_environments import ENVIRONMENTS, make_task

SIZE = 200
PLACES = [
    *(("ant-gather", place) for place in [(0, 0), (0, -11.3), (11.3, 0), (-11.3, -11.3)]),
    *(("point-gather", place) for place in [(0, -11.7), (11.7, 11.7)]),
    *(("ant-maze", place) for place in [(0, -3.2), (0, 12.8), (16, -3.2)]),
    *(("ant-push", place) for place in [(0, -3.2), (0, 12.8), (0, 19)]),
    *(("ant-fall", place) for place in [(0, 0), (0, 12.8, 0.75), (8, 12.8, 0.75)]),
]


def make(name="ant-gather"):
    found = find_opengl()
    if found is None:
        pytest.skip("there is no OpenGL here (EGL or OSMesa)")
    task = make_task(name, 1)
    task.reset(np.array([0]), [1])
    return task, MujocoRenderer(task.world_to_draw(), SIZE, SIZE, found)


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
    assert (picture.shape, picture.dtype) == ((SIZE, SIZE, 3), np.uint8)
    assert picture.std() > 10
    assert share(picture, ROBOT) > 1e-4


@pytest.mark.render
def test_the_opengl_found_is_used_whatever_the_environment_says(monkeypatch):
    monkeypatch.setenv("PYOPENGL_PLATFORM", "other")
    task, renderer = make("point-gather")
    assert renderer.draw(task.sim.qpos[0]).std() > 10
    renderer.close()
    assert os.environ["PYOPENGL_PLATFORM"] == find_opengl()


@pytest.mark.render
def test_markers_are_seen():
    task, renderer = make()
    markers = [
        ball((5, 4, 0.4), 1.4, FOOD),
        disc((-6, 2, 0.1), 1.5, GOAL),
        line((-8, -8, 0.1), (8, -8, 0.1), 0.1, GOAL),
    ]
    bare, shown, again = (renderer.draw(task.sim.qpos[0], each, "top") for each in ((), markers, ()))
    renderer.close()
    np.testing.assert_array_equal(bare, again)
    for color in (FOOD, GOAL):
        assert share(shown, color) > share(bare, color) + 0.002
    row = round((13 + 8) / 26 * SIZE)  # of the line
    assert share(shown[row - 2 : row + 3], GOAL) > 0.1


def look(name, place):
    """Return the model, the state, the camera that follows the robot at `place`, and its position."""
    model = decorate(make_task(name, 1).world_to_draw()).compile()
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    data.qpos[: len(place)] = place
    mujoco.mj_forward(model, data)
    follow(camera, model, data, extent_of(model))
    azimuth, elevation = np.deg2rad((camera.azimuth, camera.elevation))
    direction = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    return model, data, camera, camera.lookat - camera.distance * np.array(direction)


@pytest.mark.parametrize(("name", "place"), PLACES)
def test_the_robot_is_in_the_picture_and_nothing_hides_it(name, place):
    model, data, camera, eye = look(name, place)
    robot, found = data.xpos[1], np.array([-1], dtype=np.int32)
    assert 0 <= mujoco.mj_ray(model, data, eye, robot - eye, None, True, -1, found) <= 1
    assert not model.geom(int(found[0])).name.startswith(("wall", "block", "platform", "floor"))
    forward, right = (camera.lookat - eye) / camera.distance, np.array([1.0, 0.0, 0.0])
    sides = [(robot - eye) @ right, (robot - eye) @ np.cross(right, forward)]
    limit = np.tan(np.deg2rad(FOLLOW_FIELD_OF_VIEW_DEG / 2))
    assert np.abs(sides).max() < 0.9 * limit * ((robot - eye) @ forward)


def test_the_camera_is_behind_and_moves_smoothly_to_a_wall():
    _, data, camera, eye = look("ant-gather", (3, -4))
    np.testing.assert_array_equal(camera.lookat, data.xpos[1])
    np.testing.assert_allclose(eye - camera.lookat, 11 * np.array([0, -np.cos(0.733), np.sin(0.733)]), atol=1e-2)
    eyes = np.array([look("point-fall", (0, y, 0.5))[3] for y in np.arange(12.3, 16, 0.1)])
    assert np.linalg.norm(np.diff(eyes, axis=0), axis=1).max() < 2


def test_looks_change_nothing_that_a_robot_in_the_open_feels():
    task, states = make_task("ant-gather", 1), []
    plain, pretty = task.world_to_draw().compile(), decorate(task.world_to_draw()).compile()
    assert (plain.nq, plain.nv, plain.nu, plain.ngeom) == (pretty.nq, pretty.nv, pretty.nu, pretty.ngeom)
    for model in (plain, pretty):
        data = mujoco.MjData(model)
        data.ctrl[:] = 20
        for _ in range(100):
            mujoco.mj_step(model, data)
        states.append(data.qpos.copy())
    np.testing.assert_array_equal(*states)
    walls = [i for i in range(plain.ngeom) if plain.geom(i).name.startswith("wall")]
    for wall in walls:  # drawn low, where they stood
        np.testing.assert_array_equal(pretty.geom_pos[wall, :2], plain.geom_pos[wall, :2])
        assert pretty.geom_pos[wall, 2] - pretty.geom_size[wall, 2] == pytest.approx(0)
        assert pretty.geom_pos[wall, 2] + pretty.geom_size[wall, 2] == pytest.approx(0.8)


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
