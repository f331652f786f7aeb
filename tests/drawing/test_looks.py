"""The looks of worlds and the camera that follows the robot, which need no OpenGL."""

from functools import cache

import mujoco
import numpy as np
import pytest

from shes.drawing.mujoco_renderer import FOLLOW_FIELD_OF_VIEW_DEG, decorate, follow
from shes.drawing.renderer import extent_of
from tests.envs.episodes import make_task

PLACES = [
    *(("ant-gather", place) for place in [(0, 0), (0, -11.3), (11.3, 0), (-11.3, -11.3)]),
    *(("point-gather", place) for place in [(0, -11.7), (11.7, 11.7)]),
    *(("ant-maze", place) for place in [(0, -3.2), (0, 12.8), (16, -3.2)]),
    *(("ant-push", place) for place in [(0, -3.2), (0, 12.8), (0, 19)]),
    *(("ant-fall", place) for place in [(0, 0), (0, 12.8, 0.75), (8, 12.8, 0.75)]),
]


@cache
def decorated(name):
    """Return the decorated world of an environment."""
    return decorate(make_task(name, 1).world_to_draw()).compile()


def look(name, place):
    """Return the model, the state, the camera that follows the robot at `place`, and its position."""
    model = decorated(name)
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
    plain, pretty = make_task("ant-gather", 1).world_to_draw().compile(), decorated("ant-gather")
    states = []
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
