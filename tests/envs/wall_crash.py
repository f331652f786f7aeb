"""Throw robots against the walls of Gather: what the tests of both bodies share."""

import mujoco
import numpy as np

from shes.envs.registry import make_task
from shes.envs.task_options import TaskOptions

INNER_HALF_WIDTH_M = 12.0


def crash(name, num_episodes, steps, seed, integrator="euler"):
    """Start robots 1 to 2.5 m before a wall or corner at 4 to 10 units per second, with extreme actions toward it.

    Half of the robots fly in the eight main directions, half anywhere. Returns the furthest coordinate of each
    torso's centre, whether the robot touched a wall, and whether its simulation diverged.
    """
    task = make_task(name, num_episodes, TaskOptions(integrator=integrator))
    model, data = task.sim.model, mujoco.MjData(task.sim.model)
    walls = [g for g in range(model.ngeom) if model.geom(g).name.startswith("wall")]
    assert walls
    ids, rng = np.arange(num_episodes), np.random.default_rng(seed)
    task.reset(ids, ids)
    angle = rng.uniform(-np.pi, np.pi, num_episodes)
    angle[::2] = np.arange(len(angle[::2])) % 8 * np.pi / 4
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    to_wall = INNER_HALF_WIDTH_M / np.abs(direction).max(axis=1)
    task.sim.qpos[:, :2] = direction * (to_wall - rng.uniform(1, 2.5, num_episodes))[:, None]
    task.sim.qvel[:, :2] = direction * rng.uniform(4, 10, num_episodes)[:, None]
    furthest, has_touched = np.zeros(num_episodes), np.zeros(num_episodes, dtype=bool)
    for _ in range(steps):
        if task.body.name == "point":
            action = np.sign(direction) * task.control_limit
        else:
            action = rng.choice([-task.control_limit, task.control_limit], (num_episodes, task.action_size))
        task.step(ids, action)
        furthest = np.maximum(furthest, np.abs(task.position).max(axis=1))
        for i in np.flatnonzero(~has_touched):
            data.qpos[:] = task.sim.qpos[i]
            mujoco.mj_fwdPosition(model, data)
            has_touched[i] = np.isin(data.contact.geom, walls).any()
    return furthest, has_touched, task.diverged.copy()
