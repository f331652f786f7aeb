"""Episodes of one task by a plain loop over steps: nothing of `Rollout` but what it says of a task's numbers."""

from typing import NamedTuple

import numpy as np

EXPLORATION_STD = 0.01


class Played(NamedTuple):
    """What came of the R rows of a task, after every step: lists [T] of arrays of all rows."""

    states: list
    """Whole physics states [R, S], after the agent has decided and before the physics."""
    goals: list
    """Goals that are held then [R, 2], from where the robots are."""
    steps: np.ndarray
    """Steps that each row made [R]."""
    returns: np.ndarray
    """Internal return [R]."""
    fell: np.ndarray
    """Whether the task's own rule ended it [R]."""
    ends: np.ndarray
    """Whole physics states at the end [R, S]."""
    positions: np.ndarray
    """Where the robots are then [R, 2]."""


def _noise(seeds, decisions, decision_size, horizon, action_size):
    """Return the exploration noise of each episode: decisions [R, D, .] and controls [R, T, A]."""
    drawn = []
    for seed in seeds:
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(1,))))
        shapes = ((decisions, decision_size), (horizon, action_size))
        drawn.append([rng.standard_normal(shape, dtype=np.float32) * np.float32(EXPLORATION_STD) for shape in shapes])
    return [np.array(each) for each in zip(*drawn, strict=True)]


def play(design, make_batch, task, generation, table, horizon):
    """Play all episodes of `task`, in a lane and an environment of their own, for at most `horizon` steps."""
    rows = len(task.slots)
    assert task.slots == tuple(range(generation.rows_per_lane))
    batch, agent = make_batch(rows), design.make(1, rows, shares_noise=generation.members_per_lane > 1)
    agent.normalise_by(generation.levels)
    if agent.shares_noise:
        agent.centre_on(generation.levels)
    for level, mean in enumerate(generation.levels):
        noise = table.slice(task.noise_index[level], len(mean.theta))
        scales = [generation.sigma * signs[level] for signs in task.signs]
        if agent.shares_noise:
            agent.theta[level][0] = noise
            agent.scale[level][0, :, 0] = np.repeat(np.array(scales, np.float32), rows // len(scales))
        else:
            agent.theta[level][0] = mean.theta + np.float32(scales[0]) * noise
    batch.reset(np.arange(rows), list(task.seeds), [None if task.start is None else task.start.state] * rows)
    agent.start(slice(None))
    if task.start is not None:
        agent.go_on(0, task.start.steps, task.start.goals)
    interval, explores = design.controller_interval, not generation.branch_steps
    if explores:
        decision, control = _noise(
            task.seeds, -(-horizon // interval), design.decision_size, horizon, batch.action_size
        )
    found = Played([], [], np.zeros(rows, int), np.zeros(rows), np.zeros(rows, bool), *[None] * 2)
    is_running, ends, positions = np.ones(rows, bool), [None] * rows, [None] * rows
    for step in range(horizon):
        noise = {}
        if explores:
            if not generation.has_frozen_control:
                noise["control_noise"] = control[None, :, step]
            if design.decision_size:
                noise["decision_noise"] = decision[None, :, step // interval]
        action = agent.act(batch.observe(), batch.position, batch.heading, goal=batch.goal, **noise)
        found.states.append(batch.states(np.arange(rows)))
        found.goals.append(agent.goal - batch.position)
        batch.step(np.flatnonzero(is_running), action)
        found.steps[is_running] += 1
        found.returns[:] += agent.intrinsic_reward(batch.position) * is_running
        for row in np.flatnonzero(is_running & (batch.terminated | (found.steps == horizon))):
            is_running[row] = False
            found.fell[row] = batch.fallen[row]
            ends[row], positions[row] = batch.states(np.array([row]))[0], batch.position[row].copy()
        if not is_running.any():
            break
    return found._replace(ends=np.array(ends), positions=np.array(positions))
