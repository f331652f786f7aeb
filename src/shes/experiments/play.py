"""Trained agents, ready to act: parameters, observation statistics and the goal they hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from shes.errors import ConfigError, PolicyError, ShapeError
from shes.es.level import LevelParameters, LevelState
from shes.experiments.build import build_design, build_task
from shes.experiments.config import TrainConfig
from shes.experiments.run_folder import RunFolder
from shes.hierarchy.agent import HierarchicalAgent
from shes.types import F64Array

__all__ = ["Agent", "load"]


class Agent:
    """The mean policies of a checkpoint, acting without noise in `num_envs` environments of the trained kind.

    It holds the controller's goal between calls: call `reset` when an episode begins.
    """

    def __init__(self, config: TrainConfig, levels: tuple[LevelState, ...], num_envs: int = 1) -> None:
        """Take the policies of `levels`; see `load`."""
        if num_envs < 1:
            raise ConfigError(f"num_envs must be a whole number of at least 1, got {num_envs}.")
        self.config = config
        self.num_envs = num_envs
        task = build_task(config, 1, is_evaluation=True)
        self._body = task.body
        self._robot = task.proprioception[: task.body.num_qpos]
        self.observation_size = task.observation_size
        # One policy per environment, so that each has its own clock and can be reset alone.
        self._agent = HierarchicalAgent(build_design(config), num_envs, 1)
        parameters = tuple(LevelParameters.of(level.theta, level.statistics) for level in levels)
        self._agent.normalise_by(parameters)
        for theta, level in zip(self._agent.theta, parameters, strict=True):
            theta[:] = level.theta
        self.reset()

    @property
    def goal(self) -> F64Array:
        """The goals being held, in the world [num_envs, 2], in metres."""
        return self._agent.goal.copy()

    def reset(self, env: int | None = None) -> None:
        """Begin a new episode in environment `env`, or in all of them: the next `act` sets a new goal."""
        if env is not None and not 0 <= env < self.num_envs:
            raise ConfigError(f"env must be from 0 to {self.num_envs - 1}, got {env}: there are {self.num_envs}.")
        for number in range(self.num_envs) if env is None else (env,):
            self._agent.start(number)

    def act(self, observation: ArrayLike) -> F64Array:
        """Return the action for one step, scaled to [-1, 1] as Gymnasium's action spaces are.

        Args:
            observation: What the environment shows: [O], or [num_envs, O] for several.

        Returns:
            [A], or [num_envs, A] if several observations were given.

        Raises:
            ShapeError: `observation` has another shape.
            PolicyError: `observation` holds NaN or infinity.
        """
        seen = np.asarray(observation, dtype=np.float64)
        rows = seen[None] if seen.ndim == 1 else seen
        if rows.shape != (self.num_envs, self.observation_size):
            raise ShapeError(
                f"observation must have shape ({self.observation_size},) or "
                f"({self.num_envs}, {self.observation_size}), got {seen.shape}. "
                f"This agent was trained on {self.config.env}; load it with num_envs=... for several."
            )
        if not np.isfinite(rows).all():
            raise PolicyError(
                "the observation holds NaN or infinity: the simulation has blown up. Reset the environment."
            )
        qpos = rows[:, self._robot]
        control = self._agent.act(rows, self._body.position(qpos), self._body.heading(qpos))
        action = np.clip(control.astype(np.float64) / self._body.control_limit, -1, 1)
        return action[0] if seen.ndim == 1 else action


def load(run: Path | str, *, checkpoint: str = "best", num_envs: int = 1) -> Agent:
    """Return the agent of a run.

    Args:
        run: The run folder.
        checkpoint: `best`, `last` or the number of a generation.
        num_envs: Environments that it acts in at once.

    Raises:
        RunFolderError: `run` is not a run folder.
        CheckpointError: The checkpoint is missing or damaged.
    """
    folder = RunFolder.open(Path(run))
    return Agent(folder.read_config(), folder.load(checkpoint).state.levels, num_envs)
