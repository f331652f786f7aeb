"""What a learner is given: the environment, in training and in evaluation, and the run's settings."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from shes.algorithms.worker import WorkerPlan
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.registry import EnvironmentMaker
from shes.envs.tasks.options import TaskOptions
from shes.errors import ShapeError
from shes.es.noise import NoiseTable
from shes.hierarchy.agent import AgentDesign
from shes.hierarchy.flat import FlatDesign
from shes.policies.mlp import MLP
from shes.sim.warp_device import WarpDevice

__all__ = ["Problem"]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """An environment to learn in."""

    name: str
    """What the environment is called."""
    env: EnvironmentMaker
    """What makes its episodes."""
    training: TaskOptions
    """Options of the environment in training."""
    evaluation: TaskOptions
    """Options of the environment in evaluation."""
    horizon: int
    """Control steps after which an episode of training is over."""
    evaluation_horizon: int
    """Control steps after which an episode of evaluation is over."""
    settings: Any
    """The settings of the run."""
    noise_table_size: int
    """Normals in the shared noise table."""
    num_threads: int = 1
    """Threads that the parent process may use."""
    chunk_size: int = 0
    """Policies that a worker runs in lockstep; 0 chooses."""
    device: str = "cpu"
    """What computes the physics."""
    nconmax: int | None = None
    """Contacts that a device has room for, per simulation; none chooses."""
    njmax: int | None = None
    """Constraint rows that a device has room for, per simulation; none chooses."""

    @property
    def xp(self) -> ModuleType:
        """Module of the arrays on the device: NumPy or CuPy."""
        return np if self.device == "cpu" else WarpDevice(self.device).xp

    def make_task(self, num_episodes: int = 1, *, is_evaluation: bool = False) -> EpisodeBatch:
        """Return the environment for `num_episodes` episodes; close it after use."""
        return self.env.make(num_episodes, self.evaluation if is_evaluation else self.training)

    def sample(self) -> EpisodeBatch:
        """Return one episode of the environment, closed: what it observes and how it is controlled.

        Raises:
            ShapeError: It observes another number of values than it says.
        """
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
        """Return the design of one policy without goals, with these hidden layers."""
        task = self.sample()
        policy = MLP(task.observation_size, hidden, task.action_size)
        return FlatDesign(policy=policy, control_limit=task.control_limit)

    def noise_table(self, design: AgentDesign) -> NoiseTable:
        """Open the noise table, building it where it is missing.

        Raises:
            ConfigError: It is too small for the policies of `design`.
        """
        table = NoiseTable.open(self.noise_table_size)
        for dim in design.dims:
            table.check_dim(dim)
        return table

    def plan(self, design: AgentDesign, branch_design: AgentDesign | None = None) -> WorkerPlan:
        """Return what every worker needs to know: this problem, and what acts in it."""
        table = self.noise_table(design)
        assert table.path is not None
        return WorkerPlan(
            env=self.env,
            training=self.training,
            evaluation=self.evaluation,
            design=design,
            noise_table=table.path,
            horizon=self.horizon,
            evaluation_horizon=self.evaluation_horizon,
            chunk_size=self.chunk_size,
            device=self.device,
            nconmax=self.nconmax,
            njmax=self.njmax,
            branch_design=branch_design,
        )
