"""The hierarchical agent: a controller sets a goal every c steps, and a primitive acts on it every step.

Source: SHES paper II-A to II-C.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np

from shes.es.statistics import normalise
from shes.hierarchy.goal_reaching import GoalReachingAgent, GoalReachingDesign, StepInput
from shes.hierarchy.outputs import ControllerOutput
from shes.hierarchy.views import ColumnsView, View
from shes.policies.mlp import MLP
from shes.types import CONTROLLER, F32Array, F64Array, IntArray

MIN_COMPONENT_M: Final = np.sqrt(0.5)
"""Minimum size of each component of a goal vector, if goals have a minimum distance of 1 m."""


@dataclass(frozen=True, kw_only=True)
class HierarchicalDesign(GoalReachingDesign):
    """Design of a hierarchical agent."""

    level_names: ClassVar[tuple[str, ...]] = ("controller", "primitive")
    controller: MLP
    controller_output: ControllerOutput
    goal_distance: float
    """Goal distance in metres for a controller output of 1."""
    has_minimum_goal_distance: bool
    """Whether goals nearer than 1 m are moved outward."""
    controller_view: View = field(default_factory=ColumnsView)
    """The part of the observation that the controller sees."""

    @property
    def decision_size(self) -> int:
        """Number of outputs of the controller."""
        return self.controller_output.size

    def direction_outputs(self, angles: F64Array) -> F64Array:
        """Return the outputs [K, decision_size] of the controller for goals in directions `angles` [K]."""
        return self.controller_output.of_direction(angles)

    @property
    def agent(self) -> type[HierarchicalAgent]:
        """The class of the agents."""
        return HierarchicalAgent


class HierarchicalAgent(GoalReachingAgent[HierarchicalDesign]):
    """Controllers with their primitives, in P lanes of R episodes each."""

    def allocate(self) -> None:
        """Allocate the inputs of the controllers as well."""
        super().allocate()
        self._controller_view = self.design.controller_view.on(self.xp)
        size = self.design.observation_sizes[CONTROLLER]
        self._controller_inputs: F64Array = self.xp.zeros((self.num_rows, size))

    def choose_goals(
        self, due: slice | IntArray, rows: slice | IntArray, given: StepInput, noise: F32Array | None
    ) -> F64Array:
        """Return the goals that the controllers set."""
        design, seen = self.design, self._controller_inputs[rows]
        observation, heading = given.observation[rows], given.heading[rows]
        self._controller_view.write(observation, heading, seen)
        if self.is_recording:
            self.moments[CONTROLLER].add(rows, seen)
        scaled = normalise(seen, *self._normalisation[CONTROLLER], design.input_clip)
        output = self._forward(CONTROLLER, self._by_lane(scaled), due)
        if noise is not None:
            output += noise[due]
        flat = output.reshape(len(scaled), -1).astype(np.float64)
        vector = design.controller_output.vector(flat, heading, design.goal_distance)
        if design.has_minimum_goal_distance:
            vector = _push_outward(vector)
        return given.position[rows] + vector


def _push_outward(vector: F64Array) -> F64Array:
    """Return `vector` [N, 2] with every component moved away from 0 to at least `MIN_COMPONENT_M`.

    Source: `outer_clamp` of the authors' code, which moves a component of exactly 0 to the positive side.
    """
    edge = np.full_like(vector, MIN_COMPONENT_M)
    return np.where(np.abs(vector) < MIN_COMPONENT_M, np.where(vector < 0, -edge, edge), vector)
