"""Plays episodes of a trained agent step by step, for videos and for `shes watch`, which shows them in a window."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from shes.drawing.window import open_window
from shes.envs.markers import GOAL, ROBOT, TRAIL, Marker
from shes.runs.build import open_run
from shes.runs.evaluate import fresh_seeds
from shes.runs.loaded_agent import Agent
from shes.settings import Ge, checked
from shes.types import F64Array

_TRAIL_STEPS = 150
_ABOVE_GROUND_M, _LINE_RADIUS_M, _GOAL_RADIUS_M = 0.03, 0.05, 0.45
_FEW_ALIKE = 3
"""Inputs of a controller that begin with one word, up to which each is listed; more are summed up."""


@dataclass(frozen=True, kw_only=True)
class PlayedStep:
    """One control step of an episode, ready to be shown."""

    pose: Any
    """The pose to draw: qpos [nq] or a picture."""
    markers: list[Marker]
    """The task's markers, those of the sensors if asked for, the goal, and the robot's trail."""
    facts: tuple[str, ...]
    """Label of the agent, if any, its training so far, time, score, and how the episode ended."""
    inputs: tuple[str, ...]
    """Inputs of the controller in words, before normalisation; empty unless sensors are shown."""
    is_last: bool
    """Whether the episode ends with this step."""


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
        self._state, self._seed, self._shows_sensors = opened.state, seed, sensors
        made = opened.state.generation
        age = f"after {made} generation{'s' * (made != 1)}" if made else "untrained"
        self._facts = (label, age)
        self.steps = steps or opened.config.evaluation_steps
        """Most control steps of an episode."""
        self._agent = Agent(opened)
        self.task = opened.algorithm.problem.make_task(is_evaluation=True)
        """The environment; whoever plays it closes it."""
        view = opened.algorithm.design.controller_view if sensors else None
        self._names = () if view is None else view.names(self.task.observation_names)

    @property
    def goal(self) -> F64Array | None:
        """The current goal [2] in metres; None if the agent has none."""
        return None if self._agent.goal is None else self._agent.goal[0]

    def seed_of(self, episode: int) -> int:
        """Return the seed of episode `episode` of those that `evaluate` runs."""
        return fresh_seeds(self._state, episode + 1, self._seed)[episode]

    def play(self, seed: int) -> Iterator[PlayedStep]:
        """Yield the steps of the episode with seed `seed`, beginning with its start."""
        task, one = self.task, np.array([0])
        task.reset(one, [seed])
        self._agent.reset()
        trail = deque([task.position[0].copy()], maxlen=_TRAIL_STEPS)
        for step in range(self.steps):
            control = self._agent.control(task.observe(), task.position, task.heading, task.goal)
            yield self._played(step, trail, "")
            task.step(one, control)
            trail.append(task.position[0].copy())
            end = "diverged" if task.diverged[0] else "ended" if task.terminated[0] else ""
            end = end or ("time is up" if step + 1 == self.steps else "")
            if end:
                yield self._played(step + 1, trail, end)
                return

    def _played(self, step: int, trail: deque[F64Array], end: str) -> PlayedStep:
        task, height, seen = self.task, self.task.ground_m + _ABOVE_GROUND_M, self._agent.controller_inputs
        sensed = task.sensor_markers(0) if self._shows_sensors else []
        places = [(*place, height) for place in trail]
        way = [Marker("line", start, _LINE_RADIUS_M, TRAIL, stop) for start, stop in pairwise(places)]
        spot = Marker("disc", places[-1], _GOAL_RADIUS_M, (*ROBOT[:3], 0.35), height=0.01)
        goals = [] if self.goal is None else [(*(self.goal / task.scale), height)]
        to_goal = [Marker("line", places[-1], _LINE_RADIUS_M / 2, GOAL, goal) for goal in goals]
        to_goal += [Marker("disc", goal, _GOAL_RADIUS_M, GOAL) for goal in goals]
        facts = (*self._facts, f"{step * task.step_s:.1f} s", f"score {task.score[0]:.1f}", end)
        return PlayedStep(
            pose=task.pose(0),
            markers=[*task.markers(0), *sensed, *way, spot, *to_goal],
            facts=tuple(filter(None, facts)),
            inputs=() if seen is None or not self._names else input_words(self._names, seen[0]),
            is_last=bool(end),
        )


def input_words(names: Sequence[str], values: F64Array) -> tuple[str, ...]:
    """Return `names` and `values` of what a controller saw; of many that begin with one word, number and largest."""
    alike: dict[str, dict[str, float]] = {}
    for name, value in zip(names, values.tolist(), strict=True):
        word = re.match(r"[^\W\d_]+", name)
        alike.setdefault(word[0] if word else name, {})[name] = value
    found = [f"controller saw {len(names)} value{'s' * (len(names) != 1)}"]
    for word, group in alike.items():
        if len(group) <= _FEW_ALIKE:
            found += [f"{name.replace('_', ' ')} {value:.2f}" for name, value in group.items()]
        else:
            found.append(f"{len(group)} of {word} up to {max(group.values()) + 0.0:.2f}")
    return tuple(found)


@checked
def watch(run: Path | str, *, checkpoint: str = "best", seed: Annotated[int, Ge(0)] | None = None) -> None:
    """Show the episodes that `evaluate` runs in a window, in real time, until it is closed. It needs a display.

    The window also shows in words what the controller saw when it set its goal, and the agent's sensors (Gather).

    Args:
        run: The run folder, or the name of a shipped agent.
        checkpoint: Checkpoint: `best`, `last` or the number of a generation.
        seed: Seed of the episodes, as for `evaluate`.
    """
    playback = Playback(run, checkpoint, seed, sensors=True)
    window = open_window(playback.task)
    try:
        for episode in count():
            for number, step in enumerate(playback.play(playback.seed_of(episode))):
                if not window.is_open:
                    return
                lines = (*step.facts, *step.inputs)
                window.show(step.pose, step.markers, is_new_episode=number == 0, lines=lines)
    finally:
        window.close()
        playback.task.close()
