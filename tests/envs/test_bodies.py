"""The ant and the point: yaw and fall by hand, and how they move.

That the models equal hand-written ones is tested in `test_task_reference.py`.
"""

import numpy as np
from numpy.testing import assert_array_equal

from shes.envs.bodies.ant import Ant
from shes.envs.named_environments import make_task
from shes.envs.tasks.task_options import TaskOptions
from tests.envs.reference_tasks import yaw


def test_yaw_equals_the_reference_for_any_rotation():
    qpos = np.random.default_rng(0).normal(size=(200, 15))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    np.testing.assert_allclose(Ant().heading(qpos), [yaw(each[3:7]) for each in qpos], atol=1e-9)


def test_the_ant_has_fallen_outside_20_cm_to_1_m():
    heights = [-1, 0.19, np.nextafter(0.2, 0), 0.2, 0.75, 1.0, np.nextafter(1.0, 2), 1.1, np.nan]
    qpos = np.zeros((len(heights), 15))
    qpos[:, 2] = heights
    assert_array_equal(Ant().fallen(qpos), [True, True, True, False, False, False, True, True, True])


def test_the_speed_of_a_point_approaches_gear_over_damping():
    task, speeds = make_task("point-gather", 5, TaskOptions(reset_noise=0)), []
    push = np.array([[1, 0], [-1, 0], [0, 1], [0, -1], [0, 0]], dtype=float)
    for _ in range(15):
        task.step(np.arange(5), push)
        assert_array_equal(np.sign(task.position), push)  # each control pushes along its own axis
        speeds.append(task.sim.qvel[0, 0])
    time = 0.1 * (1 + np.arange(15))
    # A force of 6 N on 0.33 kg with a damping of 0.8 N s/m, before the wall.
    np.testing.assert_allclose(speeds, 7.5 * (1 - np.exp(-time * 0.8 / 0.33)), rtol=0.05)
