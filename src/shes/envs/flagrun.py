"""Flagrun: follow goals that move. Source: algorithm specification section 6, environment specification, Flagrun."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import mujoco
import numpy as np

from shes.drawing.markers import TARGET, Marker, ball
from shes.envs.body import Body
from shes.envs.layout import ObservationElement, elements
from shes.envs.task import SimulatorFactory, Task, TaskDescription, TaskOptions
from shes.envs.worlds import GATHER, add_grid, empty_world
from shes.sim.cpu import CpuSimulator
from shes.types import BoolArray, F64Array, IntArray

__all__ = ["Flagrun"]

GOAL_RANGE_M = 4.0
"""Each component of a goal is uniform in plus and minus this, relative to the robot."""
NEAR_M = 1.0
"""Goals are drawn at least this far away; nearer to one is worth 1 more in each step."""
DISTANCE_SCALE = 0.001


class Flagrun(Task):
    """A goal within 4 m along x and y that moves every 25 control steps, between walls at 12 m.

    Trains a primitive alone, under a random controller. A goal moves after the reward was paid for the old one, so that
    an observation always shows the goal that the next action is for.
    """

    name: ClassVar[str] = "flagrun"
    heeds: ClassVar[frozenset[str]] = frozenset({"goal_interval"})
    description: ClassVar[TaskDescription] = TaskDescription(
        reward="1 - d/d_c, where d is the distance to the goal and d_c what it was when the goal was drawn; "
        "1 more where d is below 1 m",
        ends="when the robot falls over (the ant: its torso leaves heights of 0.2 to 1.0 m; the point cannot)",
        score="the return",
        success="the goal is nearer than 1 m",
    )

    def __init__(
        self, body: Body, num_episodes: int, options: TaskOptions, simulator: SimulatorFactory = CpuSimulator
    ) -> None:
        """Build the arena for `body` and `num_episodes` simulations of it."""
        super().__init__(body, num_episodes, options, simulator)
        self.goal: F64Array = np.ones((num_episodes, 2))
        """Goals in the world [N, 2] in metres."""
        self._start_distance: F64Array = np.ones(num_episodes)
        self._rngs: list[np.random.Generator | None] = [None] * num_episodes
        self._observation: F64Array = np.zeros((num_episodes, self.observation_size))

    @classmethod
    def build_spec(cls, body: Body, options: TaskOptions) -> mujoco.MjSpec:
        """Return the arena of Gather."""
        spec = empty_world(f"{body.name}-{cls.name}", options.integrator)
        add_grid(spec, GATHER)
        body.add_to(spec)
        return spec

    @property
    def layout(self) -> tuple[ObservationElement, ...]:
        """Three features of the goal, the robot's qpos and clipped qvel."""
        angle = "of the goal's bearing from the heading"
        return (
            ObservationElement(name="goal_sin", meaning=f"sine {angle}", low=-1.0, high=1.0),
            ObservationElement(name="goal_cos", meaning=f"cosine {angle}", low=-1.0, high=1.0),
            *elements(["goal_distance"], "distance to the goal, in km", "km", low=0.0),
            *self._robot_layout(),
        )

    @property
    def terminated(self) -> BoolArray:
        """Whether the robot has fallen [N]."""
        return self.body.fallen(self.sim.qpos)

    @property
    def distance(self) -> F64Array:
        """Distance to the goal [N]."""
        offset = self.goal - self.position
        offset *= offset
        return np.sqrt(offset[:, 0] + offset[:, 1])

    @property
    def score(self) -> F64Array:
        """The return [N]; 0 after a divergence."""
        return self.running_return * ~self.sim.diverged

    @property
    def success(self) -> BoolArray:
        """Whether the goal is nearer than 1 m [N]."""
        return (self.distance < NEAR_M) & ~self.sim.diverged

    def markers(self, episode: int) -> list[Marker]:
        """Return the goal."""
        return [ball((*self.goal[episode], 0.5), 0.4, TARGET)]

    def _reset_features(self, ids: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        for i, rng in zip(ids.tolist(), rngs, strict=True):
            self._rngs[i] = rng
            self._draw_goal(i, rng)

    def _draw_goal(self, i: int, rng: np.random.Generator) -> None:
        """Move the goal of episode `i`."""
        while True:
            offset = rng.uniform(-GOAL_RANGE_M, GOAL_RANGE_M, 2)
            if offset[0] * offset[0] + offset[1] * offset[1] >= NEAR_M**2:
                break
        self.goal[i] = self.position[i] + offset
        # Not the length of `offset`: rounding must not make the goal's distance differ from its start distance.
        self._start_distance[i] = self.distance[i]

    def _update_features(self) -> F64Array:
        distance = self.distance
        reward = 1 - distance / self._start_distance + (distance < NEAR_M)
        for i in np.flatnonzero(self.time % self.options.goal_interval == 0).tolist():
            rng = self._rngs[i]
            if rng is not None:  # an episode that has never begun has none
                self._draw_goal(i, rng)
        return reward

    def observe(self) -> F64Array:
        """Return goal and robot [N, O]."""
        nq, nv = self.body.num_qpos, self.body.num_qvel
        offset = self.goal - self.position
        angle = np.arctan2(offset[:, 1], offset[:, 0]) - self.heading
        out = self._observation
        np.sin(angle, out=out[:, 0])
        np.cos(angle, out=out[:, 1])
        np.multiply(self.distance, DISTANCE_SCALE, out=out[:, 2])
        out[:, 3 : 3 + nq] = self.sim.qpos
        self._write_velocity(self.sim.qvel, out[:, 3 + nq : 3 + nq + nv])
        return out
