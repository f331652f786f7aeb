"""The hierarchical agent: a controller sets a goal every c steps, a primitive acts on it every step.

Source: SHES paper II-A to II-C; algorithm specification sections 1 to 3.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from shes.es.statistics import normalise
from shes.hierarchy.goal_reaching import GoalReachingAgent, GoalReachingDesign
from shes.hierarchy.outputs import ControllerOutput
from shes.hierarchy.views import ColumnsView, View
from shes.policies.mlp import MLP
from shes.types import CONTROLLER, PRIMITIVE, F32Array, F64Array, IntArray

__all__ = ["MIN_COMPONENT_M", "HierarchicalAgent", "HierarchicalDesign"]

MIN_COMPONENT_M: Final = np.sqrt(0.5)
"""With a minimum goal distance, each component of a goal vector is pushed out to this: the goal is 1 m away or more."""


@dataclass(frozen=True, kw_only=True)
class HierarchicalDesign(GoalReachingDesign):
    """What a hierarchical agent is made of."""

    controller: MLP
    controller_output: ControllerOutput
    goal_distance: float
    """Metres that an output of 1 of the controller stands for."""
    has_minimum_goal_distance: bool
    """Whether goals nearer than 1 m are pushed outward."""
    controller_view: View = field(default_factory=ColumnsView)
    """What the controller sees of the observation."""

    @property
    def level_names(self) -> tuple[str, ...]:
        """Controller and primitive."""
        return ("controller", "primitive")

    @property
    def policies(self) -> tuple[MLP, ...]:
        """The networks, controller first."""
        return (self.controller, self.primitive)

    @property
    def intrinsic_level(self) -> int:
        """The controller pays the primitive."""
        return PRIMITIVE

    @property
    def decision_size(self) -> int:
        """Outputs of the controller."""
        return self.controller_output.size

    @property
    def agent(self) -> type[HierarchicalAgent]:
        """The class of its agents."""
        return HierarchicalAgent


class HierarchicalAgent(GoalReachingAgent[HierarchicalDesign]):
    """P lanes of R episodes each, of policy pairs. Rows [N] are lane after lane."""

    def allocate(self) -> None:
        """Make room for what the controllers observe."""
        super().allocate()
        self._controller_view = self.design.controller_view.on(self.xp)
        size = self.design.observation_sizes[CONTROLLER]
        self._controller_inputs: F64Array = self.xp.zeros((self.num_rows, size))

    def choose_goals(
        self,
        due: slice | IntArray,
        rows: slice | IntArray,
        observation: F64Array,
        position: F64Array,
        heading: F64Array,
        goal: F64Array | None,
        noise: F32Array | None,
    ) -> F64Array:
        """Let the controllers of lanes `due` decide."""
        del goal
        design, seen = self.design, self._controller_inputs[rows]
        observed = observation[rows]
        self._controller_view.write(observed, self._controller_view.angle(observed, heading[rows]), seen)
        if self.is_recording:
            self.moments[CONTROLLER].add(rows, seen)
        scaled = normalise(seen, *self._normalisation[CONTROLLER])
        output = self._forward(CONTROLLER, self._by_lane(scaled), due)
        if noise is not None:
            output += noise[due]
        flat = output.reshape(len(scaled), -1)
        vector = design.controller_output.vector(flat.astype(np.float64), heading[rows], design.goal_distance)
        if design.has_minimum_goal_distance:
            vector = _push_outward(vector)
        return position[rows] + vector


def _push_outward(vector: F64Array) -> F64Array:
    """Return `vector` [N, 2] with every component moved, away from 0, to at least `MIN_COMPONENT_M`.

    Source: `outer_clamp` of the authors' code, which sends a component of exactly 0 to the positive side.
    """
    edge = np.full_like(vector, MIN_COMPONENT_M)
    return np.where(np.abs(vector) < MIN_COMPONENT_M, np.where(vector < 0, -edge, edge), vector)
