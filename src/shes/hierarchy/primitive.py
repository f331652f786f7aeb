"""A primitive alone, on goals that come from elsewhere: from its environment, or written down beforehand.

Source: SHES paper II-D; algorithm specification section 6; learning specification, section 2. What it learns goes into
any task of the same robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from shes.hierarchy.goal_reaching import GoalReachingAgent, GoalReachingDesign
from shes.policies.mlp import MLP
from shes.types import F32Array, F64Array, IntArray

__all__ = ["BranchAgent", "BranchDesign", "PrimitiveAgent", "PrimitiveDesign"]


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
    def intrinsic_level(self) -> int:
        """The primitive is paid as under a controller."""
        return 0

    @property
    def agent(self) -> type[GoalReachingAgent[Any]]:
        """The class of its agents."""
        return PrimitiveAgent


class PrimitiveAgent(GoalReachingAgent[PrimitiveDesign]):
    """P lanes of R episodes each, on the environment's goals."""

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
        """Take the environment's goals, which change when these are due."""
        del due, observation, position, heading, noise
        assert goal is not None, "only an environment that sets goals trains a primitive alone"
        return goal[rows]


@dataclass(frozen=True, kw_only=True)
class BranchDesign(PrimitiveDesign):
    """What a primitive is made of that pursues goals which were written down when a controller set them."""

    num_goals: int
    """Goals of a branch, J."""

    @property
    def agent(self) -> type[BranchAgent]:
        """The class of its agents."""
        return BranchAgent


class BranchAgent(GoalReachingAgent[BranchDesign]):
    """P lanes of R episodes each, on goals that `go_on` gives to a lane: the same for all its episodes."""

    def allocate(self) -> None:
        """Make room for the planned goals."""
        super().allocate()
        self._planned: F64Array = np.ones((self.num_lanes, self.design.num_goals, 2))
        self._num_used: IntArray = np.zeros(self.num_lanes, dtype=np.int64)

    def start(self, lanes: slice | IntArray) -> None:
        """Begin new episodes in `lanes`."""
        super().start(lanes)
        self._num_used[lanes] = 0

    def go_on(self, lane: int, steps: int, goals: F64Array) -> None:
        """Let the episodes of `lane` pursue `goals` [J, 2]; see `AgentBatch.go_on`."""
        super().go_on(lane, steps, goals)
        self._planned[lane] = goals

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
        """Take the next goal of each lane that is `due`; one that has none left, because it is over, the last."""
        del observation, heading, goal, noise
        lanes = np.arange(self.num_lanes)[due]
        number = np.minimum(self._num_used[lanes], self._planned.shape[1] - 1)
        self._num_used[lanes] += 1
        planned = np.repeat(self._planned[lanes, number], self.rows_per_lane, axis=0)
        return position[rows] + self.xp.asarray(planned)
