"""The hierarchical agent: a controller sets a goal every c steps, a primitive acts on it every step.

Source: SHES paper II-A to II-C; algorithm specification sections 1 to 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType
from typing import Final

import numpy as np

from shes.es.statistics import normalise
from shes.hierarchy.goal_reaching import GoalReachingAgent, GoalReachingDesign
from shes.hierarchy.outputs import ControllerOutput
from shes.policies.mlp import MLP, aligned_rows
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

    @property
    def level_names(self) -> tuple[str, ...]:
        """Controller and primitive."""
        return ("controller", "primitive")

    @property
    def policies(self) -> tuple[MLP, ...]:
        """The networks, controller first."""
        return (self.controller, self.primitive)

    @property
    def internal_level(self) -> int:
        """The controller pays the primitive."""
        return PRIMITIVE

    @property
    def decision_size(self) -> int:
        """Outputs of the controller."""
        return self.controller_output.size

    def make(self, num_policies: int, num_episodes: int, xp: ModuleType = np) -> HierarchicalAgent:
        """Return an agent of `num_policies` pairs, each in `num_episodes` episodes."""
        return HierarchicalAgent(self, num_policies, num_episodes, xp)


class HierarchicalAgent(GoalReachingAgent):
    """P policy pairs acting in E episodes each. Rows [N] are pair after pair."""

    def __init__(self, design: HierarchicalDesign, num_policies: int, num_episodes: int, xp: ModuleType = np) -> None:
        """Make room for `num_policies` pairs of `num_episodes` episodes, with arrays of `xp`."""
        super().__init__(design, num_policies, num_episodes, xp)
        self._design = design

    def _choose_goals(
        self,
        due: slice | IntArray,
        rows: slice | IntArray,
        observation: F64Array,
        position: F64Array,
        heading: F64Array,
        goal: F64Array | None,
        noise: F32Array | None,
    ) -> F64Array:
        """Let the controllers of pairs `due` decide."""
        del goal
        design, seen = self._design, observation[rows]
        if self.is_recording:
            self.moments[CONTROLLER].add(rows, seen)
        scaled = normalise(seen, *self._normalisation[CONTROLLER])
        layers = self._layers[CONTROLLER]
        if not isinstance(due, slice):
            layers = design.controller.layers(_aligned_copy(self.theta[CONTROLLER], due))
        output = design.controller.forward(layers, self._by_policy(scaled))
        if noise is not None:
            output += noise[due]
        flat = output.reshape(len(scaled), -1)
        vector = design.controller_output.vector(flat.astype(np.float64), heading[rows], design.goal_distance)
        if design.has_minimum_goal_distance:
            vector = _push_outward(vector)
        return position[rows] + vector


def _aligned_copy(theta: F32Array, policies: IntArray) -> F32Array:
    """Return the rows of `policies`, each on a cache line as in `theta`."""
    out = aligned_rows(len(policies), theta.shape[1])
    np.take(theta, policies, axis=0, out=out)
    return out


def _push_outward(vector: F64Array) -> F64Array:
    """Return `vector` [N, 2] with every component moved, away from 0, to at least `MIN_COMPONENT_M`.

    Source: `outer_clamp` of the authors' code, which sends a component of exactly 0 to the positive side.
    """
    edge = np.full_like(vector, MIN_COMPONENT_M)
    return np.where(np.abs(vector) < MIN_COMPONENT_M, np.where(vector < 0, -edge, edge), vector)
