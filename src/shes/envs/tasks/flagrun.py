"""Flagrun: reach goals that move at regular intervals. Source: SHES paper II-D; the authors' ScalableHrlEs.jl."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from shes.envs.bodies.body import ObservationElement, elements
from shes.envs.markers import TARGET, Marker
from shes.envs.tasks.task import FURTHEST_M, BodyReader, FallOptions, Task, TaskDescription
from shes.settings import Ge, Le, Shared
from shes.types import BoolArray, F64Array, IntArray, to_host

NEAR_M = 1.0
"""Least distance of a new goal, in units of `scale`. Within it, the reward of a step is 1 higher."""
DISTANCE_SCALE = 0.001
"""Factor on the distance to the goal in observations."""


@dataclass(frozen=True, kw_only=True)
class FlagrunOptions(FallOptions):
    """Options of Flagrun.

    They share the names of the controller's settings, because random goals replace the controller.
    """

    controller_interval: Annotated[int, Ge(1), Shared()] = 25
    """Control steps between two goals."""
    goal_distance: Annotated[float, Ge(NEAR_M), Le(FURTHEST_M), Shared()] = 4.0
    """Half width of the square around the robot from which goals are drawn, in metres or, for a robot from a file, in
    multiples of its size."""
    stiff_contacts: bool = False
    """Whether contacts are as stiff as in Push and Fall, to train a primitive for these tasks."""


class FlagrunReader(BodyReader):
    """Reads the goal from the sine and cosine of its bearing and from its distance."""

    def goal(self, rows: F64Array, position: F64Array, heading: F64Array) -> F64Array:
        """Return the goals [N, 2] in the world; see `Reader.goal`."""
        bearing = np.arctan2(rows[:, 0], rows[:, 1]) + heading
        distance = rows[:, 2] / DISTANCE_SCALE
        return position + np.stack([distance * np.cos(bearing), distance * np.sin(bearing)], axis=1)


class Flagrun(Task):
    """A goal within 4 m along x and y moves every 25 control steps. The walls are at 12 m.

    The task trains a primitive alone, under a random controller. A goal moves after the reward of a step is computed,
    so an observation always shows the goal of the next action. In the step in which the goal moves, reward and success
    refer to the old goal; `distance`, also in `info`, refers to the new one.

    Nachum et al. 2018 have no such task: `hiro` is `shes` with RK4 and unclipped velocities, to train a primitive for
    the hiro tasks.
    """

    name: ClassVar[str] = "flagrun"
    specs: ClassVar[tuple[str, ...]] = ("shes", "hiro")
    sets_goals: ClassVar[bool] = True
    falls_end = True
    Options = FlagrunOptions
    options: FlagrunOptions
    description: ClassVar[TaskDescription] = TaskDescription(
        reward="1 - d/d_c, where d is the distance to the goal and d_c its value when the goal was drawn; "
        "1 more if d is below 1 m",
        ends="when the robot falls over, by the rule of its body",
        score="the return",
        success="the distance to the goal of the step is below 1 m",
    )

    def allocate(self) -> None:
        """Allocate goals, distances and the observation."""
        num_episodes = self.num_episodes
        self.goal = self._goal = self.xp.ones((num_episodes, 2))
        self._offset: F64Array = self.xp.zeros((2, num_episodes))  # from robot to goal along x and y
        self._distance: F64Array = self.xp.ones(num_episodes)
        self._start_distance: F64Array = self.xp.ones(num_episodes)
        self._is_near: BoolArray = self.xp.zeros(num_episodes, dtype=np.bool_)
        self._rngs: list[np.random.Generator | None] = [None] * num_episodes  # None before the first reset
        # Copy of `time` on the host, where goals are drawn: no need to wait for a device.
        self._host_time: IntArray = np.zeros(num_episodes, dtype=np.int64)
        self.reader = FlagrunReader(self.body, self.observation_size, self.proprioception)

    @property
    def observation_spec(self) -> tuple[ObservationElement, ...]:
        """Bearing and distance of the goal, the robot's qpos and qvel."""
        angle = "of the goal's bearing from the heading"
        return (
            ObservationElement(name="goal_sin", meaning=f"sine {angle}", low=-1.0, high=1.0),
            ObservationElement(name="goal_cos", meaning=f"cosine {angle}", low=-1.0, high=1.0),
            *elements(["goal_distance"], "distance to the goal, in km", "km", low=0.0),
            *self.robot_elements(),
        )

    @property
    def distance(self) -> F64Array:
        """Distance to the goal of the next step [N], in units of `scale`."""
        return self._distance.copy()

    @property
    def score(self) -> F64Array:
        """The return [N]; 0 after a divergence."""
        return np.where(self.sim.diverged, 0.0, self.running_return)

    @property
    def success(self) -> BoolArray:
        """Whether the last step ended within `NEAR_M` of its goal [N], even if the goal has moved since."""
        return self._is_near & ~self.sim.diverged

    def markers(self, episode: int) -> list[Marker]:
        """Return the goal."""
        return [Marker("ball", (*to_host(self._goal[episode]), 0.5), 0.4, TARGET)]

    def reset_features(self, ids: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        """Draw the goals of episodes `ids`; see `Task.reset_features`."""
        self._is_near[self.xp.asarray(ids)] = False
        self._host_time[ids] = 0
        for i, rng in zip(ids.tolist(), rngs, strict=True):
            self._rngs[i] = rng
        self._move_goals(ids)

    def _move_goals(self, ids: IntArray) -> None:
        offsets = np.array([self._draw_offset(self._rngs[i]) for i in ids.tolist()])
        rows = self.xp.asarray(ids)
        self._goal[rows] = self.position[rows] + self.xp.asarray(offsets)
        # Not the lengths of the offsets: rounding must not make the distance differ from the start distance.
        self._measure()
        self._start_distance[rows] = self._distance[rows]

    def _measure(self) -> None:
        np.subtract(self._goal.T, self.position.T, out=self._offset)
        squares = self._offset * self._offset
        np.add(squares[0], squares[1], out=self._distance)
        np.sqrt(self._distance, out=self._distance)

    def _draw_offset(self, rng: Any) -> tuple[float, float]:
        while True:
            x, y = rng.uniform(-self.options.goal_distance, self.options.goal_distance, 2).tolist()
            if x * x + y * y >= NEAR_M**2:
                return x, y

    def update_features(self) -> F64Array:
        """Return the reward [N] of a step, then move the goals whose interval has ended."""
        self._measure()
        np.less(self._distance, NEAR_M, out=self._is_near)
        reward = 1 - self._distance / self._start_distance + self._is_near
        self._host_time += 1
        is_due = self._host_time % self.options.controller_interval == 0
        due = np.array([i for i in np.flatnonzero(is_due).tolist() if self._rngs[i] is not None], np.int64)
        if len(due):
            self._move_goals(due)
        return reward

    def observe(self) -> F64Array:
        """Return goal and robot [N, O]."""
        angle = np.arctan2(self._offset[1], self._offset[0])
        angle -= self.heading
        out = self._observation
        np.sin(angle, out=out[:, 0])
        np.cos(angle, out=out[:, 1])
        np.multiply(self._distance, DISTANCE_SCALE, out=out[:, 2])
        self.write_robot(out[:, 3:])
        return out
