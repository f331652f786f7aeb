"""The ant: yaw and fall by hand. That the models equal hand-written ones is tested in `test_task_reference.py`."""

import numpy as np
from numpy.testing import assert_array_equal

from shes.envs.bodies.ant import Ant
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
