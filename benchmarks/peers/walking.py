"""The walking task on which learners are compared: Ant Flagrun for 500 steps, and our view of it for other learners."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

import shes
from shes.agents.agent import AgentInputs
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config

ENV, NAME, HORIZON = "shes/AntFlagrun-v0", "ant-flagrun", 500
EPISODES, SEED = 50, 10_000  # of an evaluation

assert shes  # registers the environments

Act = Callable[[np.ndarray], np.ndarray]
"""Returns the actions [N, A] in [-1, 1] for observations [N, O]; made anew for every evaluation."""


def make_envs(num_envs: int, num_threads: int = 0) -> Any:
    """Return a vector environment whose episodes begin anew in the step in which they end."""
    return gymnasium.make_vec(ENV, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, num_threads=num_threads)


def evaluate(act: Act) -> dict[str, float]:
    """Return the mean return of fresh episodes, and the mean of the steps until the ant falls."""
    envs = make_envs(EPISODES)
    observation, _ = envs.reset(seed=SEED)
    returns, steps, runs = np.zeros(EPISODES), np.zeros(EPISODES), np.ones(EPISODES, bool)
    for _ in range(HORIZON):
        observation, reward, terminated, truncated, _ = envs.step(act(observation))
        returns += reward * runs
        steps += runs
        runs &= ~(terminated | truncated)
    envs.close()
    return {"return_mean": float(returns.mean()), "steps_mean": float(steps.mean())}


class OwnView:
    """Observations and actions as in preset `laptop`: egocentric, in a frame chosen from the ant's symmetry group."""

    def __init__(self, num_envs: int) -> None:
        """Begin with new episodes in `num_envs` environments."""
        algorithm = build_algorithm(make_config(NAME, "laptop", {}))
        task = algorithm.problem.make_task(is_evaluation=True)
        self._reader = task.reader
        task.close()
        self._agent = algorithm.design.agent(algorithm.design, num_envs, 1)
        self.size: int = algorithm.design.observation_sizes[-1]
        self._agent.start(slice(None))

    def restart(self, envs: np.ndarray) -> None:
        """Begin new episodes in these environments."""
        if len(envs):
            self._agent.start(envs)

    def act(self, observation: np.ndarray, policy: Act) -> np.ndarray:
        """Return the actions [N, A] for `observation`; `policy` maps our inputs [N, I] to actions in our frame."""
        position, heading = self._reader.locate(observation, None)
        goal = self._reader.goal(observation, position, heading)
        self._agent.levels[-1].act = lambda inputs, _: policy(inputs)
        return self._agent.act(AgentInputs(observation, position, heading, goal))
