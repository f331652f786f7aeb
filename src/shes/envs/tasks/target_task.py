"""Maze, Push and Fall: reach a target in a world with walls, a block or a chasm.

Source: Nachum et al. 2018 (HIRO); the SHES authors' HrlMuJoCoEnvs.jl.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from shes.envs.bodies.body import MIN_COS_TILT, ObservationElement, elements
from shes.envs.episode_batch import Places
from shes.envs.markers import TARGET, Marker
from shes.envs.tasks.task import TIME_ELEMENTS, TIME_SCALE, Coordinates, FallOptions, Task, TaskDescription
from shes.envs.worlds import CELL_SIZE_M, WALL_HEIGHT_M, Grid
from shes.settings import out_of_range
from shes.types import BoolArray, F64Array, IntArray, to_host

SUCCESS_DISTANCE_M = 5.0
"""An episode succeeds nearer to the target than this."""
PASSED_DISTANCE_M = 3.0
"""A waypoint is passed nearer than this,"""
BYPASSED_DISTANCE_M = CELL_SIZE_M
"""or nearer than this if the next one is nearer still: the path may keep to the other side of a corridor."""
CELL_M, BLOCK_CELL_M = 1.0, 2.0
"""Steps of a place in the robot's x and y, and in its height and the block's coordinates."""


@dataclass(frozen=True, kw_only=True)
class TargetOptions(FallOptions):
    """Options of a task with a target."""

    target: Coordinates | None = None
    """Target of training and evaluation in metres or, for a robot from a file, in multiples of its size; none is the
    task's own, which Maze draws for each episode of training."""


class TargetTask(Task):
    """The robot must come within 5 m of a target. The reward is the negative distance to it.

    For a robot from a file these are not metres, but multiples of its size, as all lengths here; see `Body.scale`.
    """

    Options: ClassVar[Any] = TargetOptions
    options: Any
    specs: ClassVar[tuple[str, ...]] = ("shes", "hiro")
    has_places: ClassVar[bool] = True
    block_axes: ClassVar[str] = ""
    """Axes along which the block moves, in the order of its coordinates; empty without a block."""
    leads_block: ClassVar[bool] = False
    """Whether a way that a search found leads the block, too."""
    own_target: ClassVar[tuple[float, ...]]
    """Default target: x and y, or x, y and z, in units of `scale`."""
    training_square: ClassVar[tuple[float, float] | None] = None
    """Range of both coordinates of a target drawn for each episode of training, unless an option fixes it."""
    target_scale: ClassVar[float] = 1.0
    """Factor on the target in observations, with specification shes."""
    description: ClassVar[TaskDescription] = TaskDescription(
        reward="minus the distance to the target, in metres",
        ends="never",
        score="1 if the last distance is below 5 m, else 0",
        success="the distance is below 5 m",
    )

    def allocate(self) -> None:
        """Allocate targets, the way to them, and the observation."""
        self.target: F64Array = self.xp.tile(self.xp.asarray(self.own_target, np.float64), (self.num_episodes, 1))
        """Targets [N, 2] or [N, 3], in units of `scale`."""
        self.falls_end = self.ends_early = self.min_cos_tilt is not None
        if self.options.spec == "hiro":
            self.primitive_view = self.primitive_view[: -len(self.own_target)]
        self.set_way(None)

    def set_way(self, way: F64Array | None) -> None:
        """Set the way of the reward; see `EpisodeBatch.set_way`."""
        target, points = self.options.target or self.own_target, [] if way is None else way.tolist()
        ends = np.array([*points, [*target, *points[-1][len(target) :]] if points else target])
        legs = np.sqrt(((ends[1:] - ends[:-1]) ** 2).sum(axis=1))
        self.num_waypoints = len(legs)
        self._way: F64Array = self.xp.asarray(ends)  # its points and, last, the target
        self._way_beyond: F64Array = self.xp.asarray(np.append(np.cumsum(legs[::-1])[::-1], 0.0) - SUCCESS_DISTANCE_M)
        self._next: IntArray = self.xp.zeros(self.num_episodes, np.int64)  # points of the way passed
        self._left: F64Array = self.xp.full(self.num_episodes, np.nan)  # of the path at the last step

    def places(self, states: F64Array) -> Places:
        """Return where robots in physics states [N, S] are; see `EpisodeBatch.places`."""
        nq, target = self.body.num_qpos, np.array(self.options.target or self.own_target)
        position = self.body.position(states, len(target))
        block = states[:, nq : nq + len(self.block_axes)] / self.scale
        steps = (position[:, :2] / CELL_M, position[:, 2:] / BLOCK_CELL_M, block / BLOCK_CELL_M)
        is_upright = ~self.body.fallen(states[:, :nq], self.ground_m * self.scale)
        if self.body.can_tilt:
            is_upright &= self.body.cos_tilt(states[:, :nq]) > MIN_COS_TILT
        return Places(
            cells=np.round(np.concatenate(steps, axis=1)).astype(np.int64),
            positions=np.concatenate([position, block], axis=1) if self.leads_block else position,
            is_upright=is_upright,
            is_success=np.sqrt(((position - target) ** 2).sum(axis=1)) < SUCCESS_DISTANCE_M,
        )

    @classmethod
    def check_options(cls, options: Any) -> None:
        """Check the number of coordinates of the target; see `Task.check_options`."""
        super().check_options(options)
        size = len(cls.own_target)
        if options.target is not None and len(options.target) != size:
            raise out_of_range(f"target of {cls.name}", options.target, f"{size} coordinates in metres", "--target")

    @property
    def _shown(self) -> tuple[str, float]:
        """The block's axes if it is observed, and the factor on the target; specification hiro has neither."""
        return (self.block_axes, self.target_scale) if self.options.spec == "shes" else ("", 1.0)

    @property
    def observation_spec(self) -> tuple[ObservationElement, ...]:
        """The robot's qpos and the block's, their qvel, time, target."""
        axes, factor = self._shown
        pose = elements([f"block_{axis}" for axis in axes], "{}: displacement of the block", "m")
        velocity = elements([f"block_v{axis}" for axis in axes], "{}: velocity of the block", "m/s")
        scale = "" if factor == 1 else f", times {factor}"
        return (
            *self.robot_elements(pose, velocity),
            *TIME_ELEMENTS,
            *elements([f"target_{axis}" for axis in "xyz"[: len(self.own_target)]], f"{{}}{scale}", "m"),
        )

    @property
    def distance(self) -> F64Array:
        """Distance to the target [N], in units of `scale`, in all coordinates that the target has."""
        return self._distance_to(self.target)

    def _distance_to(self, points: F64Array) -> F64Array:
        """Return the distances [..., N] to points [..., N or 1, X] of the robots and, with more coordinates, blocks."""
        size = len(self.own_target)
        offset = self.body.position(self.sim.qpos, size) - points[..., :size]
        if points.shape[-1] > size:
            blocks = self.sim.qpos[:, self.body.num_qpos :] / self.scale
            offset = self.xp.concatenate([offset, blocks - points[..., size:]], axis=-1)
        offset *= offset
        return np.sqrt(sum(offset[..., axis] for axis in range(offset.shape[-1])))

    @property
    def reward_after_end(self) -> F64Array:
        """The last reward of a robot that has fallen [N]: it would stay where it is, and make no progress on a path."""
        return np.where(self.terminated & (self.num_waypoints == 0), self.reward, 0.0)

    @property
    def success(self) -> BoolArray:
        """Whether the target is nearer than `SUCCESS_DISTANCE_M` [N]."""
        return (self.distance < SUCCESS_DISTANCE_M) & ~self.sim.diverged

    @property
    def score(self) -> F64Array:
        """1 where the target is nearer than `SUCCESS_DISTANCE_M`, else 0 [N]."""
        return self.success.astype(np.float64)

    def markers(self, episode: int) -> list[Marker]:
        """Return the target and the disc within which it counts as reached."""
        x, y, *_ = to_host(self.target[episode])
        ring = Marker("disc", (x, y, self.ground_m + 0.02), SUCCESS_DISTANCE_M, (*TARGET[:3], 0.25), height=0.01)
        return [ring, Marker("ball", (x, y, self.ground_m + 0.5), 0.5, TARGET)]

    def reset_features(self, ids: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        """Draw the targets of episodes `ids`; see `Task.reset_features`."""
        square = None if self.options.target or self.options.evaluation else self.training_square
        fixed = self.options.target or self.own_target
        chosen = np.array([fixed if square is None else rng.uniform(*square, 2) for rng in rngs])
        rows = self.xp.asarray(ids)
        self.target[rows] = self.xp.asarray(chosen)
        self._next[rows], self._left[rows] = 0, np.nan

    def reset(self, ids: IntArray, seeds: Sequence[int], states: Sequence[F64Array | None] = ()) -> None:
        """Start new episodes; those in a given state begin at the nearest point of the way."""
        super().reset(ids, seeds, states)
        if self.num_waypoints and (given := [i for i, state in enumerate(states) if state is not None]):
            rows = self.xp.asarray(ids[given])
            self._next[rows] = self._distance_to(self._way[:, None]).argmin(axis=0)[rows]

    def update_features(self) -> F64Array:
        """Return the reward [N]: minus the distance to the target, or the progress along the way up to success."""
        if not self.num_waypoints:
            return -self.distance
        distance = self._distance_to(self._way[self._next])
        beyond = self._distance_to(self._way[np.minimum(self._next + 1, self.num_waypoints)])
        passed = (distance < PASSED_DISTANCE_M) | ((distance < BYPASSED_DISTANCE_M) & (beyond < distance))
        self._next += passed & (self._next < self.num_waypoints)
        before, left = self._left, self._distance_to(self._way[self._next]) + self._way_beyond[self._next]
        self._left = np.maximum(left, 0.0)
        return np.where(np.isnan(before), 0.0, before - self._left)

    def observe(self) -> F64Array:
        """Return robot and block, time, and target [N, O]."""
        out, (axes, factor) = self._observation, self._shown
        end = self.write_robot(out, len(axes))
        np.multiply(self.time, TIME_SCALE, out=out[:, end])
        np.multiply(self.target, factor * self.scale, out=out[:, end + 1 :])
        return out


class Maze(TargetTask):
    """A U-shaped corridor. In training the target is random, in evaluation it lies behind the wall.

    Training's targets are uniform in a square that contains walls; 12 % of the episodes begin within 5 m of theirs.
    """

    name: ClassVar[str] = "maze"
    grid: ClassVar[Grid] = ("#####", "#r..#", "###.#", "#...#", "#####")
    own_target: ClassVar[tuple[float, ...]] = (0.0, 16.0)
    training_square: ClassVar[tuple[float, float] | None] = (-4.0, 20.0)
    target_scale: ClassVar[float] = 0.01


class Push(TargetTask):
    """A block stands in the way. Pushed straight ahead it closes the passage; pushed aside it opens it.

    The block weighs 0.2 g, as published, which makes its contacts soft: when rammed against a wall, a point's centre
    sinks in by up to 0.35 m and an ant's foot by up to 0.54 m. Then it is pushed out again.
    """

    name: ClassVar[str] = "push"
    grid: ClassVar[Grid] = ("#####", "#.r##", "#.B.#", "##.##", "#####")
    block_axes: ClassVar[str] = "xy"
    own_target: ClassVar[tuple[float, ...]] = (0.0, 19.0)


class Fall(TargetTask):
    """A chasm lies between robot and target, which stand on platforms 4 m high. A block pushed into it is a bridge.

    An episode never terminates: a robot that has fallen into the chasm stays there until the time limit.
    """

    name: ClassVar[str] = "fall"
    grid: ClassVar[Grid] = ("####", "#r.#", "#.B#", "#CC#", "#..#", "####")
    ground_m = WALL_HEIGHT_M
    block_axes: ClassVar[str] = "yz"
    leads_block: ClassVar[bool] = True
    own_target: ClassVar[tuple[float, ...]] = (0.0, 27.0, 4.5)
