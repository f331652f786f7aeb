"""The problem that a learning algorithm is given: the environment and the settings of the run."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from shes.agents.agent import FlatDesign
from shes.agents.mlp import MLP
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import ShapeError
from shes.rollout.worker import EpisodeSetup
from shes.sim.warp_device import WarpDevice


@dataclass(frozen=True, kw_only=True)
class Problem(EpisodeSetup):
    """An environment to learn in, with the settings of the run."""

    name: str
    settings: Any
    noise_table_size: int
    num_threads: int = 1
    """Number of threads that the parent process may use."""

    @property
    def xp(self) -> ModuleType:
        """Module of the arrays on the device: NumPy or CuPy."""
        return np if self.device == "cpu" else WarpDevice(self.device).xp

    def make_task(self, *, is_evaluation: bool = False) -> EpisodeBatch:
        """Return the environment for one episode. The caller closes it."""
        return self.env.make(1, self.evaluation if is_evaluation else self.training)

    def sample(self) -> EpisodeBatch:
        """Return the environment for one episode, closed; raise ShapeError if its observation has a wrong size."""
        task = self.make_task()
        task.reset(np.array([0]), [0])
        shape = task.observe().shape
        if shape != (1, task.observation_size):
            raise ShapeError(
                f"environment {self.name!r} must observe [N, {task.observation_size}], as many values as its "
                f"observation_spec names; for 1 episode it observed {shape}. Change observation_spec or observe()."
            )
        task.close()
        return task

    def flat_design(self, hidden: tuple[int, ...]) -> FlatDesign:
        """Return the design of an agent with a single policy without goals, with these hidden layers."""
        task = self.sample()
        policy = MLP(task.observation_size, hidden, task.action_size)
        return FlatDesign(policy=policy, control_limit=task.control_limit)
