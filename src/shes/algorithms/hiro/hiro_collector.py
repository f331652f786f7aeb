"""The collector of HIRO: transitions of a controller and of its primitive.

N environments, O observed values, V values of the primitive's view, G coordinates of a goal, A controls, c steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from shes.algorithms.hiro.agent import HiroDesign
from shes.algorithms.hiro.collector import Actor, Collector, Step, as_float32
from shes.algorithms.hiro.goal_space import goal_transition, primitive_reward
from shes.algorithms.hiro.replay import Rows
from shes.envs.episode_batch import EpisodeBatch
from shes.types import BoolArray, F32Array, F64Array, IntArray


class HiroCollector(Collector):
    """Collects the transitions of a controller and its primitive.

    The first goal of an episode is the controller's. The primitive's transition at the end of an interval leads to the
    next goal. An interval that the time limit cuts short is left out.

    Deviation: in HIRO's code the goal of the first step of an episode is zero.
    """

    def __init__(
        self,
        batch: EpisodeBatch,
        actors: Mapping[str, Actor],
        horizon: int,
        design: HiroDesign,
        *,
        bootstraps: bool,
        reward_scale: float = 1.0,
    ) -> None:
        """See `Collector`; `actors` are those of `controller` and `primitive`."""
        super().__init__(batch, actors, horizon, bootstraps=bootstraps, reward_scale=reward_scale)
        n, c, size = batch.num_episodes, design.controller_interval, design.goals.size
        self._space, self._interval = design.goals, c
        self._columns = list(design.primitive_view.indices or ())
        self._goal, self._coordinates = np.zeros((n, size)), np.zeros((n, size))
        self._intrinsic_return = np.zeros(n)
        # Of the interval that is running: observation, coordinates and goal at its start, reward, and its steps.
        self._first = {"inputs": np.zeros((n, batch.observation_size)), "goal": np.zeros((n, size))}
        self._origin, self._earned = np.zeros((n, size)), np.zeros(n)
        self._played = {
            "moved": np.zeros((n, c, size)),
            "view": np.zeros((n, c, len(self._columns))),
            "actions": np.zeros((n, c, batch.action_size)),
        }

    def begin(self, rows: IntArray, seeds: Iterator[int], rng: np.random.Generator) -> None:
        """Start new episodes in `rows`, with goals."""
        super().begin(rows, seeds, rng)
        self._intrinsic_return[rows] = 0
        self._decide(rows, rng)

    def observe(self) -> None:
        """Copy the current observations and coordinates."""
        super().observe()
        self._coordinates = self._space.coordinates(self._observation, self._batch.position)

    def control(self, rng: np.random.Generator) -> F64Array:
        """Return the controls of a step [N, A], and note the step for the off-policy correction."""
        self._before, self._inputs_before = self._coordinates, self._inputs()
        control = self._actors["primitive"].act(self._inputs_before, rng)
        every, step = np.arange(len(control)), self._steps % self._interval
        self._played["moved"][every, step] = self._coordinates - self._origin
        self._played["view"][every, step] = self._observation[:, self._columns]
        self._played["actions"][every, step] = control
        return control

    def transitions(self, step: Step, rng: np.random.Generator) -> dict[str, Rows]:
        """Return the transitions of both levels, after setting new goals where due."""
        rows = step.rows
        self._goal = goal_transition(self._goal, self._before, self._coordinates)
        reward = primitive_reward(self._goal)
        sound = rows[step.is_sound]
        self._intrinsic_return[sound] += reward[sound]
        self._earned[rows] += self.reward()[rows]
        is_over = self._steps[rows] % self._interval == 0
        self.summary.goal_distances += (-reward[rows[is_over & step.is_sound]]).tolist()
        of_controller = self._intervals(step, is_over)
        self._decide(rows[is_over & ~step.ended], rng)
        # Its rewards are negative: if a fall cut its return, it would learn to fall.
        goes_on = np.ones(len(step.terminated), dtype=bool)
        of_primitive = self.rows(step, self._inputs_before, reward, goes_on, self._inputs())
        return {"controller": of_controller, "primitive": of_primitive}

    def returns(self) -> dict[str, F64Array]:
        """Return the undiscounted returns of the episodes so far [N], by level."""
        return {"controller": self._batch.running_return, "primitive": self._intrinsic_return}

    def _inputs(self) -> F64Array:
        """Return the current inputs of the primitive [N, G + V]: the goal, then its view."""
        return np.concatenate([self._goal, self._observation[:, self._columns]], axis=1)

    def _decide(self, rows: IntArray, rng: np.random.Generator) -> None:
        """Let the controllers of episodes `rows` set new goals."""
        if not len(rows):
            return
        self._goal[rows] = self._actors["controller"].act(self._observation, rng)[rows]
        self._first["inputs"][rows], self._first["goal"][rows] = self._observation[rows], self._goal[rows]
        self._origin[rows], self._earned[rows] = self._coordinates[rows], 0

    def _intervals(self, step: Step, is_over: BoolArray) -> dict[str, F32Array]:
        """Return the controller's transitions: the intervals that have passed, or that a terminal state has ended."""
        is_kept = step.is_sound & (is_over | step.terminated)
        kept = step.rows[is_kept]
        num_steps = (self._steps[kept] - 1) % self._interval + 1
        rows = {
            **{name: values[kept] for name, values in self._first.items()},
            "reward": self._earned[kept],
            "goes_on": self.goes_on(step.terminated[is_kept]),
            "next_inputs": self._observation[kept],
            "change": self._coordinates[kept] - self._origin[kept],
            **{name: values[kept] for name, values in self._played.items()},
            "is_step": np.arange(self._interval) < num_steps[:, None],
        }
        return as_float32(rows)
