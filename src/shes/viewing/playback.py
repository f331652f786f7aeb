"""Plays episodes of a trained agent step by step, for videos and the viewer."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from shes.envs.episode_batch import EpisodeBatch
from shes.envs.markers import GOAL, ROBOT, TRAIL, Marker, disc, line
from shes.runs.build import open_run
from shes.runs.evaluate import fresh_seeds
from shes.runs.loaded_agent import Agent
from shes.types import F64Array
from shes.viewing.controller_sight import ControllerSight

_TRAIL_STEPS = 150
_ABOVE_GROUND_M = 0.03
_LINE_RADIUS_M = 0.05
_GOAL_RADIUS_M = 0.45


@dataclass(frozen=True, kw_only=True)
class Moment:
    """One control step."""

    pose: Any
    """The pose to draw: qpos [nq] or a picture."""
    markers: list[Marker]
    """The task's markers, those of the sensors if asked for, the goal, and the robot's trail."""
    facts: tuple[str, ...]
    """Label of the agent, if any, its training so far, time, score, and how the episode ended."""
    seen: tuple[str, ...] = ()
    """Inputs of the controller in words if sensors are shown; see `ControllerSight`."""


class Playback:
    """Episodes of one checkpoint, under evaluation's conditions."""

    def __init__(
        self,
        run: Path | str,
        checkpoint: str,
        seed: int | None = None,
        steps: int | None = None,
        *,
        label: str = "",
        sensors: bool = False,
    ) -> None:
        """Load `checkpoint` of `run`, called `label`; for the other arguments and errors see `render`."""
        opened = open_run(run, checkpoint)
        config, state = opened.config, opened.state
        self._facts = (label, _age(state.generation)) if label else (_age(state.generation),)
        self.steps = steps or config.evaluation_steps
        self._agent = Agent(opened)
        self.task = opened.algorithm.problem.make_task(is_evaluation=True)
        """The environment; whoever plays it closes it."""
        self._state, self._seed, self._has_sensors = state, seed, sensors
        view = getattr(opened.algorithm.design, "controller_view", None)
        self._sight = ControllerSight(view, self.task) if sensors and view is not None else None

    def seed_of(self, episode: int) -> int:
        """Return the seed of episode `episode` of those that `evaluate` runs."""
        return fresh_seeds(self._state, episode + 1, self._seed)[episode]

    def play(self, seed: int) -> Iterator[Moment]:
        """Yield the moments of the episode with seed `seed`, beginning with its start."""
        task, one = self.task, np.array([0])
        task.reset(one, [seed])
        self._agent.reset()
        trail = deque([task.position[0].copy()], maxlen=_TRAIL_STEPS)
        for step in range(self.steps):
            control = self._agent.control(task.observe(), task.position, task.heading, task.goal)
            yield self._moment(step, trail, "")
            task.step(one, control)
            trail.append(task.position[0].copy())
            ending = _ending(task, step + 1 == self.steps)
            if ending:
                yield self._moment(step + 1, trail, ending)
                return

    def _moment(self, step: int, trail: deque[F64Array], ending: str) -> Moment:
        task = self.task
        sensed = task.sensor_markers(0) if self._has_sensors else []
        facts = (*self._facts, f"{step * task.step_s:.1f} s", f"score {task.score[0]:.1f}", ending)
        return Moment(
            pose=task.pose(0),
            markers=[*task.markers(0), *sensed, *_goal_and_trail(self._agent.goal, trail, task.ground_m)],
            facts=tuple(fact for fact in facts if fact),
            seen=() if self._sight is None else self._sight.look(),
        )


def _age(generation: int) -> str:
    """Return how long an agent was trained: `untrained`, `after 80 generations`."""
    if generation == 0:
        return "untrained"
    return f"after {generation} generation{'s' * (generation != 1)}"


def _ending(task: EpisodeBatch, is_last: bool) -> str:
    """Return why the episode has ended; an empty string if it has not."""
    if task.diverged[0]:
        return "diverged"
    if task.terminated[0]:
        return "ended"
    return "time is up" if is_last else ""


def _goal_and_trail(goals: F64Array | None, trail: deque[F64Array], ground: float) -> list[Marker]:
    """Return markers of the robot's trail and position, and of the goal and a line to it, if there is one."""
    height = ground + _ABOVE_GROUND_M
    places = [(*place, height) for place in trail]
    way = [line(*pair, _LINE_RADIUS_M, TRAIL) for pair in pairwise(places)]
    spot = disc(places[-1], _GOAL_RADIUS_M, (*ROBOT[:3], 0.35), height=0.01)
    if goals is None:
        return [*way, spot]
    goal = (*goals[0], height)
    return [*way, spot, line(places[-1], goal, _LINE_RADIUS_M / 2, GOAL), disc(goal, _GOAL_RADIUS_M, GOAL)]
