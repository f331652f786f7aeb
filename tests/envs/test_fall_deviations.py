"""The two deviations of Fall's world, merged boxes and a stiff limit, each against a model that has only the other."""

import mujoco
import numpy as np
import pytest

from shes.envs.bodies.point import DAMPING, GEAR_N
from shes.envs.registry import make_task
from shes.envs.worlds import CELL_SIZE_M
from tests.envs.reference_worlds import FALL, world_xml

STIFF, SOFT = "0.995 0.995 0.01", "0.9 0.95 0.001"
TOUCH_M = 0.3
"""A point that is nearer to a seam than its radius and the margins may touch both boxes."""
LIMIT_M = 8.0


def trajectory(model, qpos, qvel, actions):
    """Return qpos [T, nq] after every control step."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    found = []
    for action in actions:
        data.ctrl[:] = action
        mujoco.mj_step(model, data, 5)
        found.append(data.qpos.copy())
    return np.array(found)


def compare(body, seed, **deviation):
    """Return the trajectories of our model and of the independent one with `deviation`, from random actions."""
    task = make_task(f"{body}-fall", 1)
    task.reset(np.array([0]), [seed])
    limit, shape = task.control_limit, (25, task.action_size)
    actions = np.repeat(np.random.default_rng(seed).uniform(-limit, limit, shape), 20, axis=0)
    text = world_xml(FALL, body, gear=GEAR_N, damping=DAMPING, **deviation)
    start = task.sim.qpos[0].copy(), task.sim.qvel[0].copy(), actions
    return trajectory(task.sim.model, *start), trajectory(mujoco.MjModel.from_xml_string(text), *start)


def first(condition):
    """Return the first step of which `condition` [T] is true, or the number of steps."""
    return int(np.argmax(condition)) if condition.any() else len(condition)


@pytest.mark.parametrize("seed", range(6))
def test_merging_changes_nothing_before_the_point_is_at_a_seam(seed):
    ours, cells = compare("point", seed, merged=False, limit_solimp=STIFF)
    distance = np.abs(ours[:, :2] % CELL_SIZE_M - CELL_SIZE_M / 2).min(axis=1)
    seam = first(distance < TOUCH_M)
    different = first((ours != cells).any(axis=1))
    assert different >= seam


def test_a_point_at_a_seam_drifts_where_boxes_are_not_merged():
    ours, cells = compare("point", 3, merged=False, limit_solimp=STIFF)
    assert np.abs(ours - cells).max() > 0.1


@pytest.mark.parametrize("seed", range(6))
def test_an_ant_on_merged_boxes_differs_by_rounding(seed):
    ours, cells = compare("ant", seed, merged=False, limit_solimp=STIFF)
    np.testing.assert_allclose(ours, cells, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_the_stiff_limit_changes_nothing_before_the_block_is_there(seed):
    ours, soft = compare("point", seed, merged=True, limit_solimp=SOFT)
    there = first(ours[:, -2] > LIMIT_M - 0.1)
    np.testing.assert_array_equal(ours[:there], soft[:there])
