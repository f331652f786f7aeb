"""Episodes of one task by a plain loop over steps: nothing of `Rollout` but what it says of a task's numbers."""

from types import SimpleNamespace

import numpy as np

from shes.agents.agent import AgentInputs
from shes.rollout.episodes import empty_outcomes, wander

EXPLORATION_STD = 0.01


def _stream(seed, key):
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(key,))))


def added(design, generation, seed, horizon, action_size):
    """Return what is added in an episode to the outputs of the controller [D, .] and to the controls [T, A]."""
    decisions, size = -(-horizon // design.controller_interval), design.decision_size
    explores = generation.kind == "training"
    shapes, rng = ((decisions, size), (horizon, action_size)), _stream(seed, 1)
    decision, control = (
        rng.standard_normal(shape, dtype=np.float32) * np.float32(EXPLORATION_STD * explores) for shape in shapes
    )
    if generation.has_frozen_control:
        control[:] = 0
    if generation.decisions == "zero":
        decision[:] = 0
    elif generation.decisions is not None:
        angles = {
            "random": lambda: _stream(seed, 2).uniform(0, 2 * np.pi, decisions),
            "wander": lambda: wander(_stream(seed, 3), decisions, 1)[:, 0],
        }.get(generation.decisions, lambda: np.full(decisions, generation.decisions))
        decision[:] = design.direction_outputs(angles())
    return decision, control


def play(design, make_batch, task, generation, table, horizon):
    """Play the episodes of `task` in a lane and an environment of their own, for at most `horizon` steps.

    Returns the outcomes and moments of the episodes, and what was seen on the way: `states` and `goals` (from where the
    robots are), each [T] of [R, ...], after the agent has decided and before the physics; and the states at the `ends`.
    """
    rows, slots = generation.rows_per_lane, list(task.slots)
    batch, agent = make_batch(rows), design.agent(design, 1, rows, shares_noise=generation.members_per_lane > 1)
    agent.centre_on(generation.levels)
    for level, (own, mean) in enumerate(zip(agent.levels, generation.levels, strict=True)):
        noise = table.slice(task.noise_index[level], len(mean.theta))
        scales = [generation.sigma * signs[level] for signs in task.signs]
        if generation.members_per_lane > 1:
            own.theta[0] = noise
            own.scale[0, :, 0] = np.repeat(np.array(scales, np.float32), rows // len(scales))
        else:
            own.theta[0] = mean.theta + np.float32(scales[0]) * noise
        own.is_recording = True
    start = None if task.start is None else task.start.state
    batch.reset(np.array(slots), list(task.seeds), [start] * len(slots) if start is not None else ())
    agent.start(slice(None))
    if task.start is not None:
        agent.go_on(0, task.start.steps, task.start.goals)
    interval = design.controller_interval
    decision = np.zeros((rows, -(-horizon // interval), design.decision_size), np.float32)
    control = np.zeros((rows, horizon, batch.action_size), np.float32)
    for slot, seed in zip(slots, task.seeds, strict=True):
        decision[slot], control[slot] = added(design, generation, seed, horizon, batch.action_size)
    is_running, steps = np.isin(np.arange(rows), slots), np.zeros(rows, int)
    intrinsic, tilt = np.zeros((2, rows))
    outcomes, moments = empty_outcomes(len(design.dims), rows), [sums_of(level.moments) for level in agent.levels]
    seen = SimpleNamespace(states=[], goals=[], ends=[None] * rows)
    for step in range(horizon):
        noise = {"decision_noise": decision[None, :, step // interval]} if design.decision_size else {}
        seen_now = batch.observe(), batch.position, batch.heading, batch.goal
        action = agent.act(AgentInputs(*seen_now, control_noise=control[None, :, step], **noise))
        if hasattr(batch, "states"):
            seen.states.append(batch.states(np.arange(rows)))
            seen.goals.append(None if agent.goal is None else agent.goal - batch.position)
        batch.step(np.flatnonzero(is_running), action)
        steps[is_running] += 1
        intrinsic += agent.intrinsic_reward(batch.position) * ~batch.diverged * is_running
        if design.has_intrinsic_reward:
            tilt = np.where(is_running & ~batch.diverged & (batch.tilt > tilt), batch.tilt, tilt)
        for row in np.flatnonzero(is_running & (batch.terminated | batch.diverged | (steps == horizon))):
            is_running[row] = False
            outcomes[row] = _outcome(batch, agent, row, steps[row], intrinsic[row], tilt[row], horizon)
            for kept, level in zip(moments, agent.levels, strict=True):
                kept[row] = sums_of(level.moments)[row]
            if hasattr(batch, "states"):
                seen.ends[row] = batch.states(np.array([row]))[0]
        if not is_running.any():
            break
    seen.outcomes, seen.moments = outcomes[slots], [each[slots].tolist() for each in moments]
    return seen


def sums_of(moments):
    """Return the number, the sum and the sum of squares of the observations of each episode [K, 1 + 2 O]."""
    return np.column_stack([moments.count, moments.total, moments.total_squares])


def _outcome(batch, agent, row, steps, intrinsic, tilt, horizon):
    """Return all quantities of the episode in `row`, which has just ended, as a row of `empty_outcomes`."""
    paid, names = batch.running_return[row] + batch.reward_after_end[row] * (horizon - steps), [*agent.design.networks]
    returns, is_sound = [intrinsic if name == "primitive" else paid for name in names], not batch.diverged[row]
    ends = batch.terminated[row] and is_sound, not is_sound, 1.0 if batch.fallen[row] and is_sound else tilt
    return (
        *(returns, paid, batch.score[row], batch.success[row], steps),
        *(*ends, agent.goals_reached[row], batch.position[row]),
    )


def assert_equal(results, played):
    """Check that the results of a task have the bits of the plain loop, with what is recorded of it."""
    assert np.array_equal(results.outcomes, played.outcomes)
    assert results.moments is None or [sums_of(each).tolist() for each in results.moments] == played.moments
