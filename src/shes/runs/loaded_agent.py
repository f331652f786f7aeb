"""Trained agents that act: parameters, observation statistics and current goals."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from shes.agents.agent import AgentInputs
from shes.agents.goal_agent import Frames
from shes.algorithms.contract import Algorithm
from shes.errors import ConfigError, PolicyError, ShapeError
from shes.es.level import LevelParameters
from shes.runs.build import OpenedRun, build_algorithm, open_run
from shes.runs.config import TrainConfig
from shes.settings import Ge, checked
from shes.types import F64Array, FloatArray, is_whole


class Agent:
    """The mean policies of a checkpoint, which act without noise in `num_envs` environments.

    The agent keeps its goals between calls: call `reset` when an episode begins. It can be pickled and copied.
    """

    @checked
    def __init__(self, run: OpenedRun, num_envs: Annotated[int, Ge(1)] = 1) -> None:
        self._build(run.config, run.algorithm, run.algorithm.parameters(run.state), num_envs)

    def __repr__(self) -> str:
        levels = ", ".join(f"{name} of {len(level.theta)} parameters" for name, level in self.levels.items())
        return f"<Agent of {self.config.run.env}: {levels}; num_envs {self.num_envs}>"

    def _build(
        self, config: TrainConfig, algorithm: Algorithm[Any], levels: tuple[LevelParameters, ...], num_envs: int
    ) -> None:
        self.config, self.num_envs = config, num_envs
        task = algorithm.problem.make_task(is_evaluation=True)
        self._reader, self.observation_size, self._scale = task.reader, task.observation_size, task.scale
        task.close()
        self.levels = dict(zip(algorithm.design.networks, levels, strict=True))
        """Parameters and observation statistics of each level, by its name. They are not to be changed."""
        # One policy per environment, so that each has a clock and can be reset separately.
        self._agent = algorithm.design.agent(algorithm.design, num_envs, 1)
        self._agent.centre_on(levels)
        for own, level in zip(self._agent.levels, levels, strict=True):
            own.theta[:] = level.theta
        self.reset()

    def __getstate__(self) -> dict[str, Any]:
        """Return the agent's settings, parameters and running episodes, for `pickle` and `copy`."""
        return {
            "config": self.config.to_dict(),
            "num_envs": self.num_envs,
            "levels": tuple(self.levels.values()),
            "episodes": [{name: array.copy() for name, array in part.items()} for part in self._episodes()],
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        config = TrainConfig.from_dict(state["config"])
        self._build(config, build_algorithm(config), state["levels"], state["num_envs"])
        for part, saved in zip(self._episodes(), state["episodes"], strict=True):
            for name, array in saved.items():
                part[name][...] = array

    def _episodes(self) -> list[dict[str, np.ndarray]]:
        """Return the arrays that change in an episode, by name: clocks and goals, and the frames of the goals."""
        batch = vars(self._agent)
        parts = [batch, *(vars(part) for part in batch.values() if isinstance(part, Frames))]
        return [{name: each for name, each in part.items() if isinstance(each, np.ndarray)} for part in parts]

    @property
    def goal(self) -> F64Array | None:
        """The current goals in world coordinates [num_envs, 2] in metres; None for flat S-ES, which has no goals."""
        held = self._agent.goal
        return None if held is None else held * self._scale

    @property
    def controller_inputs(self) -> F64Array | None:
        """Inputs of the controllers [num_envs, inputs] when they set the current goals; None without a controller."""
        seen = self._agent.controller_inputs
        return None if seen is None else seen.copy()

    def reset(self, env: int | None = None) -> None:
        """Begin a new episode in environment `env`, or in all: the next `act` sets new goals."""
        if env is not None and not (is_whole(env) and 0 <= env < self.num_envs):
            raise ConfigError(f"env must be the number of an environment, 0 to {self.num_envs - 1}, got {env!r}.")
        for number in range(self.num_envs) if env is None else (env,):
            self._agent.start(np.array([number]))

    def act(self, observation: Any, info: Mapping[str, Any] | None = None, env: Any = None) -> FloatArray:
        """Return the action for one step: in [-1, 1], or within the bounds of an external environment's action space.

        Args:
            observation: Observation [O], or [num_envs, O] of several environments; for an external environment also
                its own observation, such as a dictionary, or that of a vector environment.
            info: The info of an external environment, if the robot's position is read from it.
            env: An external environment, if the robot's position is read from its MuJoCo joints. S-ES needs neither
                `info` nor `env`.

        Returns:
            Action [A], or [num_envs, A] for several observations.
        """
        try:
            rows, is_single = self._reader.rows(observation, self.num_envs)
        except ShapeError as error:
            raise ShapeError(
                f"{error} This agent was trained on {self.config.run.env}; load it with num_envs=... for several."
            ) from error
        if not np.isfinite(rows).all():
            raise PolicyError(
                "the observation holds NaN or infinity: the simulation has blown up. Reset the environment."
            )
        position, heading, goal = np.zeros((len(rows), 2)), np.zeros(len(rows)), None
        if self._agent.goal is not None:
            position, heading = self._reader.locate(rows, info, env)
            goal = self._reader.goal(rows, position, heading)
        action = self._reader.to_action(self.control(rows, position, heading, goal))
        return action[0] if is_single else action

    def control(self, rows: F64Array, position: F64Array, heading: F64Array, goal: F64Array | None = None) -> F64Array:
        """Return the controls [num_envs, A] for one step.

        Args:
            rows: Flat observations [num_envs, O].
            position: Positions of the robots [num_envs, 2] in metres.
            heading: Yaw of the robots [num_envs] in radians.
            goal: Goals set by the environment [num_envs, 2] in metres, if it sets goals.
        """
        return self._agent.act(AgentInputs(rows, position, heading, goal)).astype(np.float64)


def load(run: Path | str, *, checkpoint: str = "best", num_envs: int = 1) -> Agent:
    """Return the agent of a run.

    Args:
        run: The run folder, or the name of a shipped agent.
        checkpoint: `best`, `last` or the number of a generation.
        num_envs: Number of environments in which it acts at once.
    """
    return Agent(open_run(run, checkpoint), num_envs)
