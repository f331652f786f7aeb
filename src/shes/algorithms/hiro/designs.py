"""Levels and agents of HIRO and TD3, from the settings of a run and its environment."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import Any

import numpy as np

from shes.algorithms.hiro.agent import HiroDesign
from shes.algorithms.hiro.goal_space import GoalSpace, primitive_columns
from shes.algorithms.hiro.levels import Level, UpdateHyperparameters
from shes.algorithms.hiro.replay import Replay
from shes.algorithms.problem import Problem
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import CheckpointError, ConfigError
from shes.es.statistics import CLIP
from shes.free_space import free_memory
from shes.hierarchy.agent import FlatDesign
from shes.hierarchy.views import ColumnsView
from shes.policies.mlp import MLP, RectifiedMLP
from shes.types import ArrayHeader


def check_problem(problem: Problem) -> EpisodeBatch:
    """Return the environment for one episode, closed; raise ConfigError unless TD3 can learn in it."""
    if problem.device != "cpu":
        raise ConfigError(
            f"device is {problem.device!r}, but {problem.settings.run.algorithm} collects its experience on the CPU. "
            "Set --device cpu."
        )
    if not problem.settings.learner.hidden:
        raise ConfigError(
            "hidden must be at least one layer, because a linear critic cannot rank actions. Set --hidden."
        )
    learner = problem.settings.learner
    if learner.batch_size > learner.replay_size:
        raise ConfigError(
            f"batch_size is {learner.batch_size:,}, more than the {learner.replay_size:,} transitions of replay_size: "
            "nothing would ever be learned. Set --batch-size lower, or --replay-size higher."
        )
    task = problem.sample()
    if task.ends_early:
        raise ConfigError(
            f"max_tilt ends episodes of {problem.name} that the task does not end; every reward there is negative, so "
            f"that {problem.settings.run.algorithm} would learn to fall. Omit --max-tilt, or set --algorithm shes."
        )
    if np.issubdtype(task.reader.to_action(np.zeros((1, task.action_size))).dtype, np.integer):
        raise ConfigError(
            f"the actions of {problem.name} are discrete, but TD3 needs continuous ones. Set --algorithm es."
        )
    return task


def flat_design(problem: Problem) -> FlatDesign:
    """Return the design of a policy without goals; raise ConfigError if TD3 cannot learn in this problem."""
    task, own = check_problem(problem), problem.settings.learner
    policy = RectifiedMLP(task.observation_size, own.hidden, task.action_size)
    return FlatDesign(policy=policy, control_limit=task.control_limit, input_clip=input_clip(own))


def hiro_design(problem: Problem) -> HiroDesign:
    """Return the design of HIRO's agent.

    Raises:
        ConfigError: TD3 cannot learn in this problem, or the robot's position is unknown.
    """
    task, own, goals = check_problem(problem), problem.settings.learner, problem.settings.goals
    if goals.controller_interval > problem.horizon:
        raise ConfigError(
            f"controller_interval is {goals.controller_interval}, but episodes have {problem.horizon} steps (horizon): "
            "the controller would never learn. Set --controller-interval lower, or --horizon higher."
        )
    space, view = GoalSpace.of(task, goals.goal_distance), ColumnsView(primitive_columns(task))
    return HiroDesign(
        controller=RectifiedMLP(task.observation_size, own.hidden, space.size),
        primitive=RectifiedMLP(space.size + view.size(task.observation_size), own.hidden, task.action_size),
        primitive_view=view,
        goals=space,
        control_limit=task.control_limit,
        controller_interval=goals.controller_interval,
        input_clip=input_clip(own),
    )


def input_clip(settings: Any) -> float:
    """Return the largest absolute value of an input of the networks."""
    return CLIP if settings.normalise_inputs else float("inf")


def flat_levels(problem: Problem, design: FlatDesign) -> tuple[Level, ...]:
    """Return the only level of a flat agent."""
    inputs, actions = design.policy.sizes[0], design.policy.sizes[-1]
    noise = problem.settings.learner.exploration_noise
    shapes = _transition(inputs, actions)
    return (_level(problem, "policy", design.policy, (design.control_limit,) * actions, noise, shapes),)


def hiro_levels(problem: Problem, design: HiroDesign) -> tuple[Level, ...]:
    """Return the controller and the primitive."""
    settings, interval = problem.settings, design.controller_interval
    actions, size, view = design.primitive.sizes[-1], design.goals.size, design.primitive.sizes[0] - design.goals.size
    of_interval = {
        "goal": (size,),
        "change": (size,),
        "moved": (interval, size),
        "view": (interval, view),
        "actions": (interval, actions),
        "is_step": (interval,),
    }
    seen = _transition(design.controller.sizes[0], size)
    del seen["action"]  # the correction chooses it
    controller = _level(
        problem,
        "controller",
        design.controller,
        design.goals.half_range,
        settings.goals.goal_noise,
        seen | of_interval,
    )
    limits = (design.control_limit,) * actions
    shapes = _transition(design.primitive.sizes[0], actions)
    noise = settings.learner.exploration_noise
    return controller, _level(problem, "primitive", design.primitive, limits, noise, shapes)


def _transition(inputs: int, actions: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of a transition."""
    return {"inputs": (inputs,), "action": (actions,), "reward": (), "goes_on": (), "next_inputs": (inputs,)}


def _level(
    problem: Problem,
    name: str,
    actor: MLP,
    half_range: tuple[float, ...],
    exploration_noise: float,
    shapes: dict[str, tuple[int, ...]],
) -> Level:
    """Return a level whose transitions have arrays of these `shapes`."""
    own = problem.settings.learner
    unit = np.ones(len(half_range)) if own.noise_unit == "raw" else np.array(half_range)
    # In the worst case, every environment begins a last episode when the generation is about to end.
    slack = max(own.generation_steps, own.warmup_steps) + own.num_envs * problem.horizon
    return Level(
        name=name,
        actor=actor,
        hyperparameters=UpdateHyperparameters(
            half_range=tuple(map(float, half_range)),
            noise_std=tuple((unit * own.target_noise).tolist()),
            noise_clip=tuple((unit * own.target_noise_clip).tolist()),
            actor_learning_rate=own.actor_learning_rate,
            critic_learning_rate=own.critic_learning_rate,
            target_rate=own.target_rate,
            policy_delay=own.policy_delay,
            has_huber_loss=own.critic_loss == "huber",
        ),
        exploration_std=tuple((unit * exploration_noise).tolist()),
        replay=Replay(shapes=shapes, capacity=own.replay_size, slack=slack),
    )


def check_num_envs(problem: Problem) -> None:
    """Raise ConfigError for more environments than a generation has steps: they take memory, and most play nothing."""
    own = problem.settings.learner
    if own.num_envs > own.generation_steps:
        raise ConfigError(
            f"num_envs is {own.num_envs:,}, but a generation has {own.generation_steps:,} environment steps "
            f"(generation_steps). Set --num-envs {own.generation_steps} or less."
        )


def check_memory(levels: tuple[Level, ...], replay_size: int) -> None:
    """Raise ConfigError, with the largest size that fits, unless the replay buffers fit the free memory."""
    need, free = sum(level.replay.num_bytes for level in levels), free_memory()
    if need <= free:
        return
    rows = sum(level.replay.num_bytes / (level.replay.capacity + level.replay.slack) for level in levels)
    fits = int(free / rows - max(level.replay.slack for level in levels))
    lower = f"--replay-size {fits} or less" if fits > 0 else "--generation-steps, --warmup-steps or --num-envs lower"
    raise ConfigError(
        f"replay_size is {replay_size:,}, which takes {need / 1e9:,.1f} GB of memory, but {free / 1e9:,.1f} GB are "
        f"free. Set {lower}."
    )


def check_restoring(headers: Mapping[str, ArrayHeader]) -> None:
    """Raise CheckpointError unless the memory holds a checkpoint's replay buffers twice: as read, and as restored."""
    replays = [header for name, header in headers.items() if "/replay/" in name]
    need, free = 2 * sum(prod(each.shape) * each.dtype.itemsize for each in replays), free_memory()
    if need > free:
        raise CheckpointError(
            f"has replay buffers that take {need / 1e9:,.1f} GB of memory while they are restored, but "
            f"{free / 1e9:,.1f} GB are free. To evaluate, choose --checkpoint best, which has none. To resume, take a "
            "machine with more memory, or copy best.npz over last.npz: what was learned since then is lost."
        )
