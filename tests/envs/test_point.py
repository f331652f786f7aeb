"""The point: its model against hand-written MJCF, how it moves, and walls that hold it."""

import mujoco
import numpy as np
from numpy.testing import assert_array_equal

from shes.envs.bodies.point import DAMPING, GEAR_N, Point
from shes.envs.registry import make_task
from shes.envs.tasks.gather import Gather
from shes.envs.tasks.task_options import TaskOptions
from tests.envs.compare_models import model_differences
from tests.envs.reference_gather import point_gather_xml


def start(num_episodes=1):
    task = make_task("point-gather", num_episodes, TaskOptions(reset_noise=0))
    task.reset(np.arange(num_episodes), range(num_episodes))
    return task


def test_the_model_equals_the_hand_written_one_but_for_what_cannot_act():
    reference = mujoco.MjModel.from_xml_string(point_gather_xml(gear=GEAR_N, damping=DAMPING))
    model = Gather.build_world(Point(), TaskOptions()).compile()
    cannot_act = (
        "opt.gravity",  # the slides are horizontal
        "geom_contype",  # of the floor, which the sphere never reaches
        "geom_conaffinity",
        "jnt_limited",  # the reference's limits are 100 m away
        "jnt_range",
    )
    assert model_differences(model, reference, but=cannot_act) == []


def test_the_point_is_a_sphere_of_330_g_half_a_metre_up():
    model = Gather.build_world(Point(), TaskOptions()).compile()
    torso = model.body("torso")
    assert (model.nq, model.nv, model.nu) == (2, 2, 2)
    assert torso.mass[0] == 0.33
    assert torso.pos[2] == 0.5
    assert model.geom("torso_geom").size[0] == 0.25


def test_the_slides_are_long_enough_for_every_world():
    model = Gather.build_world(Point(), TaskOptions()).compile()
    for i in range(2):
        joint = model.joint(i)
        assert not joint.limited[0] or (joint.range[0] <= -40 and joint.range[1] >= 40)


def test_nothing_pulls_at_a_resting_point():
    task = start()
    for _ in range(50):
        task.step(np.arange(1), np.zeros((1, 2)))
    assert_array_equal(task.sim.qpos, np.zeros((1, 2)))
    assert_array_equal(task.sim.qvel, np.zeros((1, 2)))


def test_the_point_does_not_touch_the_floor():
    model = Gather.build_world(Point(), TaskOptions()).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0


def test_each_control_pushes_along_its_own_axis():
    task = start(4)
    task.step(np.arange(4), np.array([[1, 0], [-1, 0], [0, 1], [0, -1]], dtype=float))
    assert_array_equal(np.sign(task.position), [[1, 0], [-1, 0], [0, 1], [0, -1]])


def test_the_speed_approaches_gear_over_damping():
    task = start()
    speeds = []
    for _ in range(15):
        task.step(np.arange(1), np.array([[1.0, 0.0]]))
        speeds.append(task.sim.qvel[0, 0])
    time = 0.1 * (1 + np.arange(15))
    # A force of 6 N on 0.33 kg with a damping of 0.8 N s/m, before the wall.
    np.testing.assert_allclose(speeds, 7.5 * (1 - np.exp(-time * 0.8 / 0.33)), rtol=0.05)


def test_the_heading_is_zero_and_it_cannot_fall():
    task = start(3)
    for _ in range(30):
        task.step(np.arange(3), np.array([[1.0, 0.3], [-1.0, 1.0], [0.2, -1.0]]))
        assert_array_equal(task.heading, np.zeros(3))
        assert not task.terminated.any()
