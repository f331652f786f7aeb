"""The walking task on which learners are compared, Flagrun, and our view of it for other learners."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

import shes
from shes.agents.agent import AgentInputs
from shes.evolution.strategies import EvolutionAlgorithm
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config

SEED = 10_000  # of an evaluation

assert shes  # registers the environments

Act = Callable[[np.ndarray], np.ndarray]
"""Returns the actions [N, A] in [-1, 1] for observations [N, O]; made anew for every evaluation."""


class Walk:
    """Flagrun with the ant for 500 steps, or with a robot from its file as in its preset."""

    def __init__(self, robot: str | None = None, episodes: int = 50) -> None:
        """Read the settings of preset `laptop`; an evaluation has `episodes` episodes."""
        self.robot: dict[str, Any] = {} if robot is None else {"robot": robot}
        self.name, self.env, self.episodes = "flagrun", "shes/Flagrun-v0", episodes
        if robot is None:
            self.name, self.env = "ant-flagrun", "shes/AntFlagrun-v0"
        self.values = make_config(self.name, "laptop", self.robot).values
        self.horizon: int = self.values["horizon"]

    @cached_property
    def algorithm(self) -> EvolutionAlgorithm:
        """The evolution strategy of the preset."""
        algorithm = build_algorithm(make_config(self.name, "laptop", self.robot))
        assert isinstance(algorithm, EvolutionAlgorithm)
        return algorithm

    @cached_property
    def reader(self) -> Any:
        """Reads positions and goals from observations."""
        task = self.algorithm.problem.make_task(is_evaluation=True)
        task.close()
        return task.reader

    def make_envs(self, num_envs: int, num_threads: int = 0) -> Any:
        """Return a vector environment whose episodes begin anew in the step in which they end."""
        options = {name: self.values[name] for name in ("controller_interval", "goal_distance")}
        return gymnasium.make_vec(
            self.env,
            num_envs,
            autoreset_mode=AutoresetMode.SAME_STEP,
            max_episode_steps=self.horizon,
            num_threads=num_threads,
            **options,
            **self.robot,
        )

    def goals(self, observation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and goals [N, 2] in the world."""
        position, heading = self.reader.locate(observation, None)
        return position, self.reader.goal(observation, position, heading)

    def evaluate(self, act: Act) -> dict[str, float]:
        """Return means over fresh episodes: return, steps until a fall, metres per second towards the goals."""
        envs = self.make_envs(self.episodes)
        observation, _ = envs.reset(seed=SEED)
        scale, step_s = envs.unwrapped.task.scale, envs.unwrapped.task.step_s
        returns, steps, metres = np.zeros((3, self.episodes))
        runs = np.ones(self.episodes, bool)
        for _ in range(self.horizon):
            position, goal = self.goals(observation)
            observation, reward, terminated, truncated, _ = envs.step(act(observation))
            returns += reward * runs
            steps += runs
            runs &= ~(terminated | truncated)
            after = self.goals(observation)[0]
            metres += np.where(runs, np.linalg.norm(goal - position, axis=1) - np.linalg.norm(goal - after, axis=1), 0)
        envs.close()
        return {
            "return_mean": float(returns.mean()),
            "steps_mean": float(steps.mean()),
            "speed_to_goals_m_s": round(float(metres.sum() * scale / (steps.sum() * step_s)), 3),
            "upright_to_the_end": float((steps == self.horizon).mean()),
        }


class OwnView:
    """Observations and actions as in preset `laptop`: egocentric, in a frame chosen from the robot's symmetry group."""

    def __init__(self, walk: Walk, num_envs: int) -> None:
        """Begin with new episodes in `num_envs` environments."""
        design = walk.algorithm.design
        self._reader, self._agent = walk.reader, design.agent(design, num_envs, 1)
        self.size: int = design.observation_sizes[-1]
        self._agent.start(slice(None))

    def restart(self, envs: np.ndarray) -> None:
        """Begin new episodes in these environments."""
        if len(envs):
            self._agent.start(envs)

    def act(self, observation: np.ndarray, policy: Act) -> np.ndarray:
        """Return the actions [N, A] for `observation`; `policy` maps our inputs [N, I] to actions in our frame."""
        position, heading = self._reader.locate(observation, None)
        goal = self._reader.goal(observation, position, heading)
        self._agent.levels[-1].act = lambda inputs, *_: policy(inputs)  # type: ignore[method-assign]
        return self._agent.act(AgentInputs(observation, position, heading, goal))
