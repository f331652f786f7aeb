"""The goal-reaching agent: every c steps a goal is set, and a primitive acts on it every step.

The goals are those of a controller, of the environment (SHES paper II-D: a primitive trained alone), or recorded ones.

Source: SHES paper II-A to II-D; `docs/learning.md` (egocentric views and symmetry).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import ModuleType
from typing import Any, Final

import numpy as np

from shes.agents.agent import AgentBatch, AgentDesign, AgentInputs
from shes.agents.goals import ControllerOutput, GoalEncoding
from shes.agents.rewards import REACHED_M, PrimitiveReward
from shes.agents.views import ColumnsView, View, turned_back
from shes.envs.bodies.body import SymmetryGroup
from shes.types import BoolArray, F32Array, F64Array, IntArray

_MIN_START_M = 1e-3  # a goal may be set where the robot stands; the relative progress must stay finite
MIN_COMPONENT_M: Final = np.sqrt(0.5)
"""Minimum size of each component of a goal vector, if goals have a minimum distance of 1 m."""


class Frames:
    """The frames of N robots, in which primitives observe and act, chosen from the symmetry group of the body.

    When a goal is set, its frame is rotated and mirrored so that the goal lies as straight ahead as the symmetry
    allows. A skill learned for one direction is thereby learned for all. Arrays belong to `xp`.

    Source: `docs/learning.md`, "The body's symmetry".
    """

    def __init__(self, group: SymmetryGroup, num_robots: int, xp: ModuleType = np) -> None:
        self._group, self._xp = group, xp
        cosine, sine, mirror = (xp.asarray(table) for table in group.direction())
        self._direction = xp.stack([cosine, sine, mirror])  # [3, T]
        self._view_index, self._view_sign = xp.asarray(group.view_index), xp.asarray(group.view_sign)
        self._control_index = xp.asarray(group.control_index)
        self._control_sign = xp.asarray(group.control_sign.astype(np.float32))
        size, num_controls = group.view_index.shape[1], group.control_index.shape[1]
        self._own_direction: F64Array = xp.zeros((3, num_robots))
        self._own_view: IntArray = xp.zeros((num_robots, size), dtype=np.int64)  # places in all robots' flat views
        self._own_view_sign: F64Array = xp.zeros((num_robots, size))
        self._own_control: IntArray = xp.zeros((num_robots, num_controls), dtype=np.int64)
        self._own_control_sign: F32Array = xp.zeros((num_robots, num_controls), dtype=np.float32)
        matrix = group.view_matrix
        self._view_matrix = None if matrix is None else xp.asarray(matrix)
        self._own_view_matrix: F64Array = xp.zeros((num_robots, size, size) if matrix is not None else 0)
        self.clock_sign: F64Array | None = xp.ones((num_robots, 1)) if group.shifts_clock else None
        """-1 for robots whose frame is reflected, which are half a period ahead; None if the clock is the same."""
        self._robots = xp.arange(num_robots)[:, None]

    def choose(self, robots: slice | IntArray, vector: F64Array) -> None:
        """Choose the frames of `robots` for goals at `vector` [robots, 2] (ahead, left) in the robots' own frames."""
        element, number = self._group.choose(vector[:, 0], vector[:, 1]), self._robots[robots]
        self._own_direction[:, robots] = self._direction[:, element]
        self._own_view[robots] = self._view_index[element] + number * self._view_index.shape[1]
        self._own_view_sign[robots] = self._view_sign[element]
        self._own_control[robots] = self._control_index[element] + number * self._control_index.shape[1]
        self._own_control_sign[robots] = self._control_sign[element]
        if self._view_matrix is not None:
            self._own_view_matrix[robots] = self._view_matrix[element]
        if self.clock_sign is not None:
            self.clock_sign[robots, 0] = self._direction[2, element]

    def turned(self, vector: F64Array) -> F64Array:
        """Return vectors [N, 2], given in the robots' own frames, in these frames."""
        cosine, sine, mirror = self._own_direction
        x, y = vector[:, 0], vector[:, 1]
        return np.stack([cosine * x + sine * y, mirror * (cosine * y - sine * x)], axis=1)

    def view(self, values: F64Array, out: F64Array) -> None:
        """Write egocentric views [N, V], given in the robots' own frames, into `out` [N, V] in these frames."""
        if self._view_matrix is None:
            np.multiply(values.ravel()[self._own_view], self._own_view_sign, out=out)
        else:
            out[:] = (self._own_view_matrix @ values[:, :, None])[:, :, 0]

    def controls(self, control: F32Array) -> F32Array:
        """Return controls [N, A], given in these frames, in the robots' own frames."""
        return control.ravel()[self._own_control] * self._own_control_sign


class GoalAgent(AgentBatch["GoalDesign"]):
    """Agents that pursue goals, in P lanes of R episodes."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        design, rows, xp = self.design, self.num_rows, self.xp
        self.goal = self._goal = xp.ones((rows, 2))
        self._way: F64Array = xp.zeros((rows, 2))  # to the goals from `_origin`
        self._origin: F64Array = xp.zeros((rows, 2))  # positions of the robots when their goals were set
        self._start_distance: F64Array = xp.ones(rows)  # to the goal when it was set
        self._distance: F64Array = xp.ones(rows)  # to the goal, before the step
        self._has_reached: BoolArray = xp.zeros(rows, dtype=np.bool_)
        self._recorded: F64Array = np.ones((self.num_lanes, design.num_recorded_goals, 2))
        self._num_used: IntArray = np.zeros(self.num_lanes, dtype=np.int64)  # of the recorded goals
        if design.controller_view is not None:
            self._controller_view = design.controller_view.on(xp)
            self.controller_inputs = self._controller_inputs = xp.zeros((rows, design.observation_sizes[0]))
        self._view = design.primitive_view.on(xp)
        self._frames = None if design.symmetry is None else Frames(design.symmetry, rows, xp)
        self._inputs: F64Array = xp.zeros((rows, design.observation_sizes[-1]))  # of the primitives
        clock_start = design.goal_encoding.size
        view_start = clock_start + (0 if design.clock is None else design.clock.size)
        self._goal_features = self._inputs[:, :clock_start]
        self._clock_features = self._inputs[:, clock_start:view_start]
        self._seen = self._inputs[:, view_start:]
        self._unturned = self._seen if self._frames is None else xp.zeros_like(self._seen)  # in the robots' own frames
        self._zero_angle: F64Array = xp.zeros(rows)

    def start(self, lanes: slice | IntArray) -> None:
        """Start new episodes in `lanes`, in which no goal has been set."""
        super().start(lanes)
        self._way[self.rows(lanes)] = 0.0

    def go_on(self, lane: int, steps: int, goals: F64Array) -> None:
        """Let the episodes of `lane` pursue recorded `goals` [J, 2]; see `AgentBatch.go_on`."""
        super().go_on(lane, steps, goals)
        if self.design.num_recorded_goals:
            self._recorded[lane], self._num_used[lane] = goals, 0

    def act(self, inputs: AgentInputs) -> F32Array:
        """Return the controls [N, A] of one step, after setting new goals where due."""
        design, frames, position = self.design, self._frames, inputs.position
        angle = self._view.write(inputs.observation, inputs.heading, self._unturned)
        is_due = self.clock % design.controller_interval == 0
        if is_due.any():
            due = slice(None) if is_due.all() else np.flatnonzero(is_due)
            rows = self.rows(due)
            if design.controller_output is not None:
                new = position[rows] + self._decide(due, rows, inputs)
            elif design.num_recorded_goals:
                new = position[rows] + self._next_recorded(due)
            else:
                assert inputs.goal is not None, "only an environment that sets goals trains a primitive alone"
                new = inputs.goal[rows]
            self._set_goals(rows, new, position[rows])
            if frames is not None:
                frames.choose(rows, turned_back(self._way[rows], angle[rows]))
        vector = self._goal - position
        distance = _length(vector)
        if self._view.is_egocentric:  # encodings receive the vector in the frame of the view, not of the world
            vector, angle = turned_back(vector, angle), self._zero_angle
        if frames is not None:
            vector = frames.turned(vector)
            frames.view(self._unturned, self._seen)
        design.goal_encoding.encode(vector, distance, angle, self._goal_features)
        if design.clock is not None:
            design.clock.write(self.xp.asarray(self.clock), self._clock_features)
            if frames is not None and frames.clock_sign is not None:
                self._clock_features *= frames.clock_sign
        self.clock += 1
        control = self.levels[-1].act(self._inputs, inputs.control_noise)
        return control if frames is None else frames.controls(control)

    def _decide(self, due: slice | IntArray, rows: slice | IntArray, inputs: AgentInputs) -> F64Array:
        """Return the vectors [rows, 2] to the goals that the controllers of lanes `due` set for episodes `rows`."""
        own, seen, heading = self.design, self._controller_inputs[rows], inputs.heading[rows]
        assert own.controller_output is not None
        observation = inputs.observation[rows]
        if self._controller_view.sees_last_goal:
            observation = np.concatenate([observation, self._way[rows] / own.goal_distance], axis=1)
        self._controller_view.write(observation, heading, seen)
        self._controller_inputs[rows] = seen
        output = self.levels[0].act(seen, inputs.decision_noise, rows, due)
        vector = own.controller_output.vector(output.astype(np.float64), heading, own.goal_distance)
        return _push_outward(vector) if own.has_minimum_goal_distance else vector

    def _next_recorded(self, due: slice | IntArray) -> F64Array:
        """Return the vectors [rows, 2] to the next recorded goal of lanes `due`, or to the last if none is left."""
        lanes = np.arange(self.num_lanes)[due]
        number = np.minimum(self._num_used[lanes], self.design.num_recorded_goals - 1)
        self._num_used[lanes] += 1
        return self.xp.asarray(np.repeat(self._recorded[lanes, number], self.rows_per_lane, axis=0))

    def _set_goals(self, rows: slice | IntArray, goals: F64Array, position: F64Array) -> None:
        """Set the goals of episodes `rows`, whose robots are at `position` [rows, 2]."""
        way = goals - position  # not the controller's vector: this must round as the distance after a step does
        self._goal[rows], self._origin[rows], self._way[rows] = goals, position, way
        self._distance[rows] = _length(way)
        self._start_distance[rows] = np.maximum(self._distance[rows], _MIN_START_M)
        self._has_reached[rows] = False

    def intrinsic_reward(self, position: F64Array) -> F64Array:
        """Return the primitives' reward [N] for moving to `position` [N, 2], and count the goals reached."""
        distance = _length(self._goal - position)
        near = distance < REACHED_M
        self.goals_reached += near & ~self._has_reached
        self._has_reached |= near
        reward = self.design.primitive_reward
        start = self._distance if reward.starts_with_step else self._start_distance
        self._distance = distance
        return reward(distance, start, position - self._origin, self._way)


@dataclass(frozen=True, kw_only=True)
class GoalDesign(AgentDesign):
    """Design of an agent that reaches goals. The primitive observes goal features, clock and view, in this order."""

    agent = GoalAgent
    has_intrinsic_reward = True
    goal_encoding: GoalEncoding
    primitive_reward: PrimitiveReward
    primitive_view: View = field(default_factory=ColumnsView)
    """The part of the observation that the primitive sees."""
    symmetry: SymmetryGroup | None = None
    """Symmetry group from which a frame is chosen for every goal, if any. It requires an egocentric view."""
    controller_output: ControllerOutput | None = None
    """Makes goals of the controller's outputs; None for a primitive alone, on goals of the environment or recorded."""
    goal_distance: float = 1.0
    """Goal distance in metres for an output of 1 of the controller."""
    has_minimum_goal_distance: bool = False
    """Whether the controller's goals nearer than 1 m are moved outward."""
    num_recorded_goals: int = 0
    """Number of recorded goals in a branch, J; 0 if the goals are not recorded."""

    def direction_outputs(self, angles: F64Array) -> F64Array:
        """Return the outputs [K, decision_size] of the controller for goals in directions `angles` [K]."""
        assert self.controller_output is not None, "only a controller decides"
        return self.controller_output.of_direction(angles)


def _push_outward(vector: F64Array) -> F64Array:
    """Return `vector` [N, 2] with every component moved away from 0 to at least `MIN_COMPONENT_M`.

    Source: `outer_clamp` of the authors' code, which moves a component of exactly 0 to the positive side.
    """
    edge = np.full_like(vector, MIN_COMPONENT_M)
    return np.where(np.abs(vector) < MIN_COMPONENT_M, np.where(vector < 0, -edge, edge), vector)


def _length(vector: F64Array) -> F64Array:
    return np.sqrt(vector[:, 0] * vector[:, 0] + vector[:, 1] * vector[:, 1])
