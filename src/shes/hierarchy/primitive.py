"""A primitive alone, on goals set by its environment or recorded under a controller.

Source: SHES paper II-D. A trained primitive can be transferred to any task with the same robot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from shes.hierarchy.goal_reaching import GoalReachingAgent, GoalReachingDesign, StepInput
from shes.types import F32Array, F64Array, IntArray


@dataclass(frozen=True, kw_only=True)
class PrimitiveDesign(GoalReachingDesign):
    """Design of a primitive without a controller."""

    level_names: ClassVar[tuple[str, ...]] = ("primitive",)

    @property
    def agent(self) -> type[GoalReachingAgent[Any]]:
        """The class of the agents."""
        return PrimitiveAgent


class PrimitiveAgent(GoalReachingAgent[PrimitiveDesign]):
    """Primitives that pursue the environment's goals."""

    def choose_goals(
        self, due: slice | IntArray, rows: slice | IntArray, given: StepInput, noise: F32Array | None
    ) -> F64Array:
        """Return the environment's goals."""
        assert given.goal is not None, "only an environment that sets goals trains a primitive alone"
        return given.goal[rows]


@dataclass(frozen=True, kw_only=True)
class BranchDesign(PrimitiveDesign):
    """Design of a primitive that pursues goals recorded under a controller."""

    num_goals: int
    """Number of goals in a branch, J."""

    @property
    def agent(self) -> type[BranchAgent]:
        """The class of the agents."""
        return BranchAgent


class BranchAgent(GoalReachingAgent[BranchDesign]):
    """Primitives that pursue the goals given to `go_on`, which all episodes of a lane share."""

    def allocate(self) -> None:
        """Allocate the recorded goals as well."""
        super().allocate()
        self._planned: F64Array = np.ones((self.num_lanes, self.design.num_goals, 2))
        self._num_used: IntArray = np.zeros(self.num_lanes, dtype=np.int64)

    def start(self, lanes: slice | IntArray) -> None:
        """Start new episodes in `lanes`."""
        super().start(lanes)
        self._num_used[lanes] = 0

    def go_on(self, lane: int, steps: int, goals: F64Array) -> None:
        """Let the episodes of `lane` pursue `goals` [J, 2]; see `AgentBatch.go_on`."""
        super().go_on(lane, steps, goals)
        self._planned[lane] = goals

    def choose_goals(
        self, due: slice | IntArray, rows: slice | IntArray, given: StepInput, noise: F32Array | None
    ) -> F64Array:
        """Return the next goal of each lane that is `due`, or its last goal if none is left."""
        lanes = np.arange(self.num_lanes)[due]
        number = np.minimum(self._num_used[lanes], self._planned.shape[1] - 1)
        self._num_used[lanes] += 1
        planned = np.repeat(self._planned[lanes, number], self.rows_per_lane, axis=0)
        return given.position[rows] + self.xp.asarray(planned)
