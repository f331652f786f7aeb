"""The goal-reaching agent: every c steps a goal is set, and a primitive acts on it every step.

The goals are those of a controller, of the environment (SHES paper II-D: a primitive trained alone), or recorded ones.

Source: SHES paper II-A to II-D; `docs/learning.md` (egocentric views and symmetry).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from shes.agents.agent import AgentBatch, AgentDesign
from shes.agents.frames import Frames, turned_back
from shes.agents.goals import GoalEncoding
from shes.agents.mlp import MLP
from shes.agents.outputs import ControllerOutput
from shes.agents.rewards import REACHED_M, PrimitiveReward
from shes.agents.views import ColumnsView, View
from shes.envs.bodies.symmetry import SymmetryGroup
from shes.types import BoolArray, F32Array, F64Array, IntArray

_MIN_START_M = 1e-3  # a goal may be set where the robot stands; the relative progress must stay finite
MIN_COMPONENT_M: Final = np.sqrt(0.5)
"""Minimum size of each component of a goal vector, if goals have a minimum distance of 1 m."""


@dataclass(frozen=True, kw_only=True)
class Controller:
    """Design of the level that sets a goal every c steps. Source: SHES paper II-A to II-C."""

    network: MLP
    output: ControllerOutput
    goal_distance: float
    """Goal distance in metres for an output of 1."""
    has_minimum_goal_distance: bool
    """Whether goals nearer than 1 m are moved outward."""
    view: View = field(default_factory=ColumnsView)
    """The part of the observation that it sees."""


@dataclass(frozen=True, kw_only=True)
class GoalDesign(AgentDesign):
    """Design of an agent that reaches goals. The primitive observes goal features, clock and view, in this order."""

    primitive: MLP
    goal_encoding: GoalEncoding
    primitive_reward: PrimitiveReward
    primitive_view: View = field(default_factory=ColumnsView)
    """The part of the observation that the primitive sees."""
    symmetry: SymmetryGroup | None = None
    """Symmetry group from which a frame is chosen for every goal, if any. It requires an egocentric view."""
    controller: Controller | None = None
    """The controller; None for a primitive alone, on goals of the environment or recorded ones."""
    num_recorded_goals: int = 0
    """Number of recorded goals in a branch, J; 0 if the goals are not recorded."""

    @property
    def networks(self) -> dict[str, MLP]:
        """The network of each level by name."""
        above = {} if self.controller is None else {"controller": self.controller.network}
        return {**above, "primitive": self.primitive}

    @property
    def controller_view(self) -> View | None:
        """The part of the observation that the controller sees; None without one."""
        return None if self.controller is None else self.controller.view

    @property
    def decision_size(self) -> int:
        """Number of outputs of the controller; 0 without one."""
        return 0 if self.controller is None else self.controller.output.size

    def direction_outputs(self, angles: F64Array) -> F64Array:
        """Return the outputs [K, decision_size] of the controller for goals in directions `angles` [K]."""
        assert self.controller is not None, "only a controller decides"
        return self.controller.output.of_direction(angles)

    @property
    def agent(self) -> type[GoalAgent]:
        """The class of the agents."""
        return GoalAgent


class GoalAgent(AgentBatch[GoalDesign]):
    """Agents that pursue goals, in P lanes of R episodes."""

    def allocate(self) -> None:
        """Allocate the goals and the inputs of the levels."""
        design, rows, xp = self.design, self.num_rows, self.xp
        self._controller = design.controller
        self._goal: F64Array = xp.ones((rows, 2))
        self._way: F64Array = xp.zeros((rows, 2))  # from where goals were set to the goals
        self.goal_origin: F64Array = xp.zeros((rows, 2))
        """Positions of the robots when their goals were set [N, 2]."""
        self.goal_start_distance: F64Array = xp.ones(rows)
        """Distance to the goal when it was set [N]."""
        self._distance: F64Array = xp.ones(rows)  # to the goal, before the step
        self._has_reached: BoolArray = xp.zeros(rows, dtype=np.bool_)
        self._recorded: F64Array = np.ones((self.num_lanes, design.num_recorded_goals, 2))
        self._num_used: IntArray = np.zeros(self.num_lanes, dtype=np.int64)  # of the recorded goals
        if self._controller is not None:
            self._controller_view = self._controller.view.on(xp)
            self._controller_inputs: F64Array = xp.zeros((rows, design.observation_sizes[0]))
        self._view = design.primitive_view.on(xp)
        self._frames = None if design.symmetry is None else Frames(design.symmetry, rows, xp)
        size = design.observation_sizes[-1]
        self._inputs: F64Array = xp.zeros((rows, size))  # of the primitives
        clock_start = design.goal_encoding.size
        view_start = clock_start + design.clock_size
        self._goal_features, self._clock_features = (
            self._inputs[:, :clock_start],
            self._inputs[:, clock_start:view_start],
        )
        self._seen = self._inputs[:, view_start:]
        self._unturned = self._seen if self._frames is None else xp.zeros_like(self._seen)  # in the robots' own frames
        self._zero_angle: F64Array = xp.zeros(rows)

    @property
    def goal(self) -> F64Array:
        """Current goals in the world frame [N, 2] in metres."""
        return self._goal

    def start(self, lanes: slice | IntArray) -> None:
        """Start new episodes in `lanes`."""
        super().start(lanes)
        self._num_used[lanes] = 0

    def go_on(self, lane: int, steps: int, goals: F64Array) -> None:
        """Let the episodes of `lane` pursue recorded `goals` [J, 2]; see `AgentBatch.go_on`."""
        super().go_on(lane, steps, goals)
        if self.design.num_recorded_goals:
            self._recorded[lane] = goals

    def act(
        self,
        observation: F64Array,
        position: F64Array,
        heading: F64Array,
        *,
        goal: F64Array | None = None,
        decision_noise: F32Array | None = None,
        control_noise: F32Array | None = None,
    ) -> F32Array:
        """Return the controls [N, A] of one step, after setting new goals where due; see `AgentBatch.act`."""
        frames = self._frames
        angle = self._view.write(observation, heading, self._unturned)
        is_due = self.clock % self.design.controller_interval == 0
        if is_due.any():
            due = slice(None) if is_due.all() else np.flatnonzero(is_due)
            rows = self._rows(due)
            if self._controller is not None:
                new = position[rows] + self._decide(due, rows, observation[rows], heading[rows], decision_noise)
            elif self.design.num_recorded_goals:
                new = position[rows] + self._next_recorded(due)
            else:
                assert goal is not None, "only an environment that sets goals trains a primitive alone"
                new = goal[rows]
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
        self.design.goal_encoding.encode(vector, distance, angle, self._goal_features)
        self._write_clock(self._clock_features)
        self.clock += 1
        control = self._control(self._inputs, control_noise)
        return control if frames is None else frames.controls(control)

    def _decide(
        self,
        due: slice | IntArray,
        rows: slice | IntArray,
        observation: F64Array,
        heading: F64Array,
        noise: F32Array | None,
    ) -> F64Array:
        """Return the vectors [rows, 2] to the goals that the controllers of lanes `due` set for episodes `rows`."""
        own = self._controller
        assert own is not None
        seen = self._controller_inputs[rows]
        self._controller_view.write(observation, heading, seen)
        output = self._outputs(0, seen, rows, due)
        if noise is not None:
            output += noise[due]
        flat = output.reshape(len(seen), -1).astype(np.float64)
        vector = own.output.vector(flat, heading, own.goal_distance)
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
        self._goal[rows], self.goal_origin[rows], self._way[rows] = goals, position, way
        self._distance[rows] = _length(way)
        self.goal_start_distance[rows] = np.maximum(self._distance[rows], _MIN_START_M)
        self._has_reached[rows] = False

    def intrinsic_reward(self, position: F64Array) -> F64Array:
        """Return the primitives' reward [N] for moving to `position` [N, 2], and count the goals reached."""
        distance = _length(self._goal - position)
        near = distance < REACHED_M
        self.goals_reached += near & ~self._has_reached
        self._has_reached |= near
        before, self._distance = self._distance, distance
        moved = position - self.goal_origin
        return self.design.primitive_reward.of_step(distance, before, self.goal_start_distance, moved, self._way)


def _push_outward(vector: F64Array) -> F64Array:
    """Return `vector` [N, 2] with every component moved away from 0 to at least `MIN_COMPONENT_M`.

    Source: `outer_clamp` of the authors' code, which moves a component of exactly 0 to the positive side.
    """
    edge = np.full_like(vector, MIN_COMPONENT_M)
    return np.where(np.abs(vector) < MIN_COMPONENT_M, np.where(vector < 0, -edge, edge), vector)


def _length(vector: F64Array) -> F64Array:
    """Return the Euclidean length [N] of `vector` [N, 2]."""
    return np.sqrt(vector[:, 0] * vector[:, 0] + vector[:, 1] * vector[:, 1])
