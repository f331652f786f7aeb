"""A primitive alone, in an environment that sets the goals: the first phase of transfer.

Source: SHES paper II-D; algorithm specification section 6. What it learns goes into any task of the same robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np

from shes.hierarchy.goal_reaching import GoalReachingAgent, GoalReachingDesign
from shes.policies.mlp import MLP
from shes.types import F32Array, F64Array, IntArray

__all__ = ["PrimitiveAgent", "PrimitiveDesign"]


@dataclass(frozen=True, kw_only=True)
class PrimitiveDesign(GoalReachingDesign):
    """What a primitive is made of that learns without a controller."""

    @property
    def level_names(self) -> tuple[str, ...]:
        """The primitive."""
        return ("primitive",)

    @property
    def policies(self) -> tuple[MLP, ...]:
        """The primitive's network."""
        return (self.primitive,)

    @property
    def internal_level(self) -> int:
        """The primitive is paid as under a controller."""
        return 0

    def make(
        self, num_lanes: int, num_episodes: int, xp: ModuleType = np, *, shares_noise: bool = False
    ) -> PrimitiveAgent:
        """Return an agent of `num_lanes` lanes of `num_episodes` episodes; see `Agent`."""
        return PrimitiveAgent(self, num_lanes, num_episodes, xp, shares_noise=shares_noise)


class PrimitiveAgent(GoalReachingAgent):
    """P lanes of R episodes each, on the environment's goals."""

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
        """Take the environment's goals, which change when these are due."""
        del due, observation, position, heading, noise
        assert goal is not None, "only an environment that sets goals trains a primitive alone"
        return goal[rows]
