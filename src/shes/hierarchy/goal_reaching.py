"""Goal-reaching agents: how a primitive observes a goal, acts on it, and is rewarded, whoever sets the goal.

Source: SHES paper II-A to II-C; `docs/learning.md` (egocentric views and symmetry).
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np

from shes.envs.bodies.symmetry import SymmetryGroup
from shes.hierarchy.agent import AgentBatch, AgentDesign
from shes.hierarchy.frames import Frames, turned_back
from shes.hierarchy.goals import GoalEncoding
from shes.hierarchy.rewards import REACHED_M, PrimitiveReward
from shes.hierarchy.views import ColumnsView, View
from shes.policies.mlp import MLP
from shes.types import BoolArray, F32Array, F64Array, IntArray

_MIN_START_M = 1e-3  # a goal may be set where the robot stands; the relative progress must stay finite


@dataclass(frozen=True, kw_only=True)
class GoalReachingDesign(AgentDesign):
    """Design of an agent that reaches goals. The primitive observes goal features, clock and view, in this order."""

    primitive: MLP
    goal_encoding: GoalEncoding
    primitive_reward: PrimitiveReward
    primitive_view: View = field(default_factory=ColumnsView)
    """The part of the observation that the primitive sees."""
    symmetry: SymmetryGroup | None = None
    """Symmetry group from which a frame is chosen for every goal, if any. It requires an egocentric view."""


ReachingDesign = TypeVar("ReachingDesign", bound=GoalReachingDesign)


class StepInput(NamedTuple):
    """Input of a control step. For the fields see `AgentBatch.act`."""

    observation: F64Array
    position: F64Array
    heading: F64Array
    goal: F64Array | None


class GoalReachingAgent(AgentBatch[ReachingDesign]):
    """Primitives that pursue goals, in P lanes of R episodes. A subclass chooses the goals."""

    def allocate(self) -> None:
        """Allocate the goals and the inputs of the primitives."""
        design, rows, xp = self.design, self.num_rows, self.xp
        self.goal_origin: F64Array = xp.zeros((rows, 2))
        """Positions of the robots when their goals were set [N, 2]."""
        self.goal_start_distance: F64Array = xp.ones(rows)
        """Distance to the goal when it was set [N]."""
        self._distance: F64Array = xp.ones(rows)  # to the goal, before the step
        self._way: F64Array = xp.zeros((rows, 2))  # from where goals were set to the goals
        self._goal: F64Array = xp.ones((rows, 2))
        self._has_reached: BoolArray = xp.zeros(rows, dtype=np.bool_)
        self._encoding, self._reward = design.goal_encoding, design.primitive_reward
        self._view = design.primitive_view.on(xp)
        self._frames = None if design.symmetry is None else Frames(design.symmetry, rows, xp)
        self._clock_start = design.goal_encoding.size
        self._view_start = self._clock_start + design.clock_size
        self._inputs: F64Array = xp.zeros((rows, design.observation_sizes[-1]))
        self._seen: F64Array = xp.zeros((rows, design.observation_sizes[-1] - self._view_start))
        self._zero_angle: F64Array = xp.zeros(rows)

    @property
    def goal(self) -> F64Array:
        """Current goals in the world frame [N, 2] in metres."""
        return self._goal

    @abstractmethod
    def choose_goals(
        self, due: slice | IntArray, rows: slice | IntArray, given: StepInput, noise: F32Array | None
    ) -> F64Array:
        """Return new goals in the world frame [rows, 2] for the episodes `rows` of lanes `due`.

        `due` is an index of NumPy, `rows` one of `xp`; both are slices if all lanes are due.
        """

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
        inputs = self._inputs
        angle = self._view.write(
            observation, heading, inputs[:, self._view_start :] if self._frames is None else self._seen
        )
        is_due = self.clock % self.design.controller_interval == 0
        if is_due.any():
            due = slice(None) if is_due.all() else np.flatnonzero(is_due)
            rows = self._rows(due)
            given = StepInput(observation, position, heading, goal)
            self._hold(rows, self.choose_goals(due, rows, given, decision_noise), position)
            if self._frames is not None:
                self._frames.choose(rows, turned_back(self._way[rows], angle[rows]))
        self._observe_goal(position, angle, inputs[:, : self._clock_start])
        self._write_clock(inputs[:, self._clock_start : self._view_start])
        self.clock += 1
        if self._frames is None:
            return self._control(inputs, control_noise)
        self._frames.view(self._seen, inputs[:, self._view_start :])
        return self._frames.controls(self._control(inputs, control_noise))

    def _observe_goal(self, position: F64Array, angle: F64Array, out: F64Array) -> None:
        """Write the features of the goals into `out` [N, features].

        With an egocentric view, encodings receive the vector in the frame of that view instead of the world frame.
        """
        vector = self._goal - position
        distance = _length(vector)
        if self._view.is_egocentric:
            vector, angle = turned_back(vector, angle), self._zero_angle
        if self._frames is not None:
            vector = self._frames.turned(vector)
        self._encoding.encode(vector, distance, angle, out)

    def intrinsic_reward(self, position: F64Array) -> F64Array:
        """Return the primitives' reward [N] for moving to `position` [N, 2], and count the goals reached."""
        distance = _length(self._goal - position)
        near = distance < REACHED_M
        self.goals_reached += near & ~self._has_reached
        self._has_reached |= near
        before, self._distance = self._distance, distance
        moved = position - self.goal_origin
        return self._reward.of_step(distance, before, self.goal_start_distance, moved, self._way)

    def _hold(self, rows: slice | IntArray, goals: F64Array, position: F64Array) -> None:
        """Set the goals of episodes `rows`, whose robots are at `position[rows]`."""
        self.goal_origin[rows] = position[rows]
        self._goal[rows] = goals
        self._has_reached[rows] = False
        # Not the controller's vector: this must round as the distance after a step does.
        way = goals - position[rows]
        self._way[rows] = way
        self._distance[rows] = _length(way)
        self.goal_start_distance[rows] = np.maximum(self._distance[rows], _MIN_START_M)


def _length(vector: F64Array) -> F64Array:
    """Return the Euclidean length [N] of `vector` [N, 2]."""
    return np.sqrt(vector[:, 0] * vector[:, 0] + vector[:, 1] * vector[:, 1])
