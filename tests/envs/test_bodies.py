"""The ant and the point: numbers of their models, yaw and fall by hand, and how the point moves.

That the models equal hand-written ones is tested in `test_task_reference.py`.
"""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.envs.bodies.ant import Ant
from shes.envs.bodies.point import Point
from shes.envs.registry import make_task
from shes.envs.tasks.gather import Gather
from shes.envs.tasks.task_options import TaskOptions
from tests.envs.compare_models import model_differences
from tests.envs.reference_tasks import yaw
from tests.envs.reference_worlds import ant_gather_xml


def model_of(body):
    return Gather.build_world(body, TaskOptions()).compile()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('density="5"', 'density="6"'),
        ('axis="-1 1 0" range="30 70"', 'axis="1 1 0" range="30 70"'),
        ('armature="1"', 'armature="0.9"'),
        ('range="-70 -30"', 'range="-70 -20"'),
        ('friction="1 0.5 0.5"', 'friction="1 0.5 0.1"'),
        ('solimp="0.8 0.8 0.01"', 'solimp="0.9 0.9 0.01"'),
        ('size="0.25"', 'size="0.2"'),
        ('joint="hip_1"', 'joint="hip_2"'),
        ('ctrlrange="-30 30"', 'ctrlrange="-3 3"'),
        ('timestep="0.02"', 'timestep="0.01"'),
    ],
)
def test_the_comparison_of_models_sees_a_difference(old, new):
    text = ant_gather_xml()
    assert old in text
    assert model_differences(model_of(Ant()), mujoco.MjModel.from_xml_string(text)) == []
    assert model_differences(model_of(Ant()), mujoco.MjModel.from_xml_string(text.replace(old, new)))


def test_the_ants_motors_and_joints_have_the_published_order():
    model = model_of(Ant())
    assert (model.nq, model.nv, model.nu, model.qpos0[2]) == (15, 14, 8, 0.75)
    joints = [model.joint(i).name for i in range(1, model.njnt)]
    assert joints == [f"{part}_{leg}" for leg in (1, 2, 3, 4) for part in ("hip", "ankle")]
    motors = [model.joint(model.actuator(i).trnid[0]).name for i in range(model.nu)]
    assert motors == [f"{part}_{leg}" for leg in (4, 1, 2, 3) for part in ("hip", "ankle")]


def test_the_ant_does_not_collide_with_itself():
    data = mujoco.MjData(model_of(Ant()))
    data.qpos[2] = 3.0
    data.qpos[7:] = [0.5, 1.2, -0.5, -1.2, 0.5, -1.2, -0.5, 1.2]
    mujoco.mj_forward(data.model, data)
    assert data.ncon == 0


def test_a_standing_ant_stays_up():
    task = make_task("ant-gather", 5)
    task.reset(np.arange(5), range(5))
    for _ in range(100):
        task.step(np.arange(5), np.zeros((5, 8)))
        assert not task.terminated.any()


# The ant's yaw and fall.


def quaternion(angle_deg, axis):
    """Return w x y z of a rotation by `angle_deg` about `axis`."""
    half = np.deg2rad(angle_deg) / 2
    return np.array([np.cos(half), *(np.sin(half) * np.array(axis, dtype=float))])


def heading(*quaternions):
    """Return the headings in degrees of ants with these torso quaternions."""
    qpos = np.zeros((len(quaternions), 15))
    qpos[:, 3:7] = quaternions
    return np.rad2deg(Ant().heading(qpos))


@pytest.mark.parametrize("angle", [0, 30, 45, 89, 90, 91, 135, 179, -1, -45, -90, -135, -179])
def test_yaw_is_the_angle_of_a_turn_about_the_vertical(angle):
    turn = quaternion(angle, [0, 0, 1])
    assert heading(turn, -turn) == pytest.approx([angle, angle], abs=1e-9)


@pytest.mark.parametrize(
    ("angle", "axis", "expected"),
    [
        (30, [0, 1, 0], 60),  # nose down
        (40, [1, 0, 0], 60),  # rolled about its own x axis
        (180, [1, 0, 0], 60),  # on its back
        (120, [0, 1, 0], -120),  # pitched beyond the vertical: the nose points backward
    ],
)
def test_yaw_of_a_tilted_torso_is_the_direction_of_its_x_axis(angle, axis, expected):
    product = np.zeros(4)
    mujoco.mju_mulQuat(product, quaternion(60, [0, 0, 1]), quaternion(angle, axis))
    assert heading(product) == pytest.approx([expected])


def test_yaw_equals_the_reference_for_any_rotation():
    quaternions = np.random.default_rng(0).normal(size=(200, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    np.testing.assert_allclose(heading(*quaternions), [np.rad2deg(yaw(q)) for q in quaternions], atol=1e-9)


def test_the_ant_has_fallen_outside_20_cm_to_1_m():
    heights = [-1, 0.19, np.nextafter(0.2, 0), 0.2, 0.75, 1.0, np.nextafter(1.0, 2), 1.1, np.nan]
    qpos = np.zeros((len(heights), 15))
    qpos[:, 2] = heights
    assert_array_equal(Ant().fallen(qpos), [True, True, True, False, False, False, True, True, True])


# The point.


def start(num_episodes):
    task = make_task("point-gather", num_episodes, TaskOptions(reset_noise=0))
    task.reset(np.arange(num_episodes), range(num_episodes))
    return task


def test_the_point_is_a_sphere_of_330_g_that_touches_no_floor():
    data = mujoco.MjData(model_of(Point()))
    torso = data.model.body("torso")
    assert (data.model.nq, data.model.nv, data.model.nu) == (2, 2, 2)
    assert (torso.mass[0], torso.pos[2], data.model.geom("torso_geom").size[0]) == (0.33, 0.5, 0.25)
    mujoco.mj_forward(data.model, data)
    assert data.ncon == 0


def test_each_control_pushes_along_its_own_axis_and_nothing_else_does():
    task = start(5)
    task.step(np.arange(5), np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [0, 0]], dtype=float))
    assert_array_equal(np.sign(task.position), [[1, 0], [-1, 0], [0, 1], [0, -1], [0, 0]])
    assert_array_equal(task.heading, np.zeros(5))
    assert not task.terminated.any()


def test_the_speed_approaches_gear_over_damping():
    task, speeds = start(1), []
    for _ in range(15):
        task.step(np.arange(1), np.array([[1.0, 0.0]]))
        speeds.append(task.sim.qvel[0, 0])
    time = 0.1 * (1 + np.arange(15))
    # A force of 6 N on 0.33 kg with a damping of 0.8 N s/m, before the wall.
    np.testing.assert_allclose(speeds, 7.5 * (1 - np.exp(-time * 0.8 / 0.33)), rtol=0.05)
