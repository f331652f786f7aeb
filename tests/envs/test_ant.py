"""The ant: its model against hand-written MJCF, its yaw and its fall by hand, and walls that hold it."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.envs.bodies.ant import Ant
from shes.envs.registry import make_task
from shes.envs.tasks.gather import Gather
from shes.envs.tasks.task_options import TaskOptions
from tests.envs.compare_models import model_differences
from tests.envs.reference_gather import ant_gather_xml, yaw


def quaternion(angle_deg, axis):
    """Return w x y z of a rotation by `angle_deg` about `axis`."""
    half = np.deg2rad(angle_deg) / 2
    return np.array([np.cos(half), *(np.sin(half) * np.array(axis, dtype=float))])


def times(first, then):
    """Return the product of two quaternions: the rotation `then`, followed by `first`."""
    result = np.zeros(4)
    mujoco.mju_mulQuat(result, first, then)
    return result


def heading(*quaternions):
    """Return the headings in degrees of ants with these torso quaternions."""
    qpos = np.zeros((len(quaternions), 15))
    qpos[:, 3:7] = quaternions
    return np.rad2deg(Ant().heading(qpos))


def test_the_model_equals_the_hand_written_one():
    reference = mujoco.MjModel.from_xml_string(ant_gather_xml())
    assert model_differences(Gather.build_world(Ant(), TaskOptions()).compile(), reference) == []


def test_the_comparison_of_models_sees_every_kind_of_difference():
    for old, new in (
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
        ('pos="0 16 2"', 'pos="0 16.5 2"'),
    ):
        assert old in ant_gather_xml()
        changed = mujoco.MjModel.from_xml_string(ant_gather_xml().replace(old, new))
        assert model_differences(Gather.build_world(Ant(), TaskOptions()).compile(), changed), new


def test_numbers_of_the_ant():
    model = Gather.build_world(Ant(), TaskOptions()).compile()
    assert (model.nq, model.nv, model.nu) == (15, 14, 8)
    assert model.opt.timestep == 0.02
    assert model.qpos0[2] == 0.75
    joints = [model.joint(i).name for i in range(model.njnt)]
    assert joints[1:] == [f"{part}_{leg}" for leg in (1, 2, 3, 4) for part in ("hip", "ankle")]
    motors = [model.joint(model.actuator(i).trnid[0]).name for i in range(model.nu)]
    assert motors == ["hip_4", "ankle_4", "hip_1", "ankle_1", "hip_2", "ankle_2", "hip_3", "ankle_3"]
    assert_array_equal(model.actuator_ctrlrange, np.tile([-30, 30], (8, 1)))
    assert_array_equal(model.actuator_gear[:, 0], np.ones(8))


def test_the_ant_does_not_collide_with_itself():
    model = Gather.build_world(Ant(), TaskOptions()).compile()
    data = mujoco.MjData(model)
    data.qpos[2] = 3.0
    data.qpos[7:] = [0.5, 1.2, -0.5, -1.2, 0.5, -1.2, -0.5, 1.2]
    mujoco.mj_forward(model, data)
    assert data.ncon == 0


@pytest.mark.parametrize("angle", [0, 30, 45, 89, 90, 91, 135, 179, -1, -45, -90, -135, -179])
def test_yaw_is_the_angle_of_a_turn_about_the_vertical(angle):
    assert heading(quaternion(angle, [0, 0, 1])) == pytest.approx([angle], abs=1e-9)


def test_yaw_of_quaternions_worked_by_hand():
    root = np.sqrt(0.5)
    assert_array_equal(heading([1, 0, 0, 0]), [0])
    assert heading([root, 0, 0, root]) == pytest.approx([90])
    assert heading([root, 0, 0, -root]) == pytest.approx([-90])
    assert np.abs(heading([0, 0, 0, 1])) == pytest.approx([180])


def test_a_quaternion_and_its_negative_have_the_same_yaw():
    q = quaternion(70, [0, 0, 1])
    assert_array_equal(heading(q), heading(-q))


def test_yaw_of_a_tilted_torso_is_the_direction_of_its_x_axis():
    turn = quaternion(60, [0, 0, 1])
    assert heading(times(turn, quaternion(30, [0, 1, 0]))) == pytest.approx([60])  # nose down
    assert heading(times(turn, quaternion(40, [1, 0, 0]))) == pytest.approx([60])  # rolled about its own x axis
    assert heading(times(turn, quaternion(180, [1, 0, 0]))) == pytest.approx([60])  # on its back
    # Pitched beyond the vertical, the nose points backward.
    assert heading(times(turn, quaternion(120, [0, 1, 0]))) == pytest.approx([-120])
    # Rolled first, then turned about its own z axis: x axis = (cos 50, sin 50 cos 40, sin 50 sin 40).
    expected = np.rad2deg(np.arctan2(np.sin(np.deg2rad(50)) * np.cos(np.deg2rad(40)), np.cos(np.deg2rad(50))))
    assert heading(times(quaternion(40, [1, 0, 0]), quaternion(50, [0, 0, 1]))) == pytest.approx([expected])


def test_yaw_equals_the_reference_for_any_rotation():
    quaternions = np.random.default_rng(0).normal(size=(200, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    expected = [np.rad2deg(yaw(q)) for q in quaternions]
    np.testing.assert_allclose(heading(*quaternions), expected, atol=1e-9)


def test_the_ant_has_fallen_when_its_torso_is_lower_than_20_cm_or_higher_than_1_m():
    heights = [-1, 0.19, np.nextafter(0.2, 0), 0.2, 0.75, 1.0, np.nextafter(1.0, 2), 1.1, np.nan]
    qpos = np.zeros((len(heights), 15))
    qpos[:, 2] = heights
    assert_array_equal(Ant().fallen(qpos), [True, True, True, False, False, False, True, True, True])


def test_a_standing_ant_stays_up():
    task = make_task("ant-gather", 5)
    task.reset(np.arange(5), range(5))
    for _ in range(100):
        task.step(np.arange(5), np.zeros((5, 8)))
        assert not task.terminated.any()
