"""The two deviations of Fall's world, merged boxes and a stiff limit, each against a model that has only the other."""

import mujoco
import numpy as np
import pytest

from shes.envs.bodies.point import DAMPING, GEAR_N
from shes.envs.named_environments import make_task
from shes.envs.worlds import CELL_SIZE_M
from tests.envs.reference_worlds import FALL, world_xml

STIFF, SOFT = "0.995 0.995 0.01", "0.9 0.95 0.001"
TOUCH_M = 0.3
"""A point that is nearer to a seam than its radius and the margins may touch both boxes."""
LIMIT_M = 8.0


def compare(body, seed, **deviation):
    """Return qpos [T, nq] of our model and of the independent one with `deviation`, from the same random actions."""
    task = make_task(f"{body}-fall", 1)
    task.reset(np.array([0]), [seed])
    limit, shape = task.control_limit, (25, task.action_size)
    actions = np.repeat(np.random.default_rng(seed).uniform(-limit, limit, shape), 20, axis=0)
    text = world_xml(FALL, body, gear=GEAR_N, damping=DAMPING, **deviation)
    for model in (task.sim.model, mujoco.MjModel.from_xml_string(text)):
        data, found = mujoco.MjData(model), []
        data.qpos[:], data.qvel[:] = task.sim.qpos[0], task.sim.qvel[0]
        for action in actions:
            data.ctrl[:] = action
            mujoco.mj_step(model, data, 5)
            found.append(data.qpos.copy())
        yield np.array(found)


def before(condition):
    """Return the steps before the first of which `condition` [T] is true."""
    return slice(int(np.argmax(condition)) if condition.any() else len(condition))


@pytest.mark.parametrize("seed", range(6))
def test_deviations_change_nothing_before_they_matter(seed):
    """Merging, before the point is at a seam of two boxes; the stiff limit, before the block is there."""
    ours, cells = compare("point", seed, merged=False, limit_solimp=STIFF)
    seam = before(np.abs(ours[:, :2] % CELL_SIZE_M - CELL_SIZE_M / 2).min(axis=1) < TOUCH_M)
    np.testing.assert_array_equal(ours[seam], cells[seam])
    ours, soft = compare("point", seed, merged=True, limit_solimp=SOFT)
    there = before(ours[:, -2] > LIMIT_M - 0.1)
    np.testing.assert_array_equal(ours[there], soft[there])


def test_a_point_at_a_seam_drifts_where_boxes_are_not_merged():
    ours, cells = compare("point", 3, merged=False, limit_solimp=STIFF)
    assert np.abs(ours - cells).max() > 0.1


@pytest.mark.parametrize("seed", range(6))
def test_an_ant_on_merged_boxes_differs_by_rounding(seed):
    ours, cells = compare("ant", seed, merged=False, limit_solimp=STIFF)
    np.testing.assert_allclose(ours, cells, rtol=0, atol=1e-9)
