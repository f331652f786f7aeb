"""Episodes of a run's agent on the task of its evaluation, step by step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import shes
from shes.runs.build import open_run


def play(
    run: Path | str,
    checkpoint: str,
    episodes: int,
    steps: int = 500,
    goal: Callable[[Any], np.ndarray] = lambda task: task.goal,
) -> Iterator[Any]:
    """Yield the task [episodes] after every step, with seeds 0, 1, ...; robots whose episodes have ended go on.

    `goal` returns the goals [episodes, 2] in metres that the agent has in a task that sets goals.
    """
    problem, agent = (
        open_run(run, checkpoint).algorithm.problem,
        shes.load(run, checkpoint=checkpoint, num_envs=episodes),
    )
    task, robots = problem.env.make(episodes, problem.evaluation), np.arange(episodes)
    task.reset(robots, robots.tolist())
    for _ in range(steps):
        task.step(robots, agent.control(task.observe(), task.position, task.heading, goal(task)))
        yield task
    task.close()
