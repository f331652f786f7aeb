"""Primitive rewards: what a controller pays its primitive each step. Source: SHES paper II-B."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

from shes.errors import UnknownNameError
from shes.types import F64Array

__all__ = ["PRIMITIVE_REWARDS", "PrimitiveReward", "ProgressReward", "make_primitive_reward"]

REACHED_M = 1.0
"""A goal nearer than this is reached (L in the paper)."""


class PrimitiveReward(ABC):
    """Reward of one step from where the robot was when the goal was set, where it is, and where the goal is."""

    name: ClassVar[str]

    @abstractmethod
    def __call__(
        self, distance: F64Array, start_distance: F64Array, displacement: F64Array, goal: F64Array
    ) -> F64Array:
        """Return the reward [N] of a step.

        Args:
            distance: From the robot to the goal after the step [N], in metres.
            start_distance: The same when the goal was set [N].
            displacement: What the robot has moved since the goal was set [N, 2].
            goal: From where the goal was set to the goal [N, 2].
        """


class ProgressReward(PrimitiveReward):
    """`1 - d_t / d_c`, plus 1 within 1 m of the goal (paper, equation 1)."""

    name = "progress"

    def __call__(
        self, distance: F64Array, start_distance: F64Array, displacement: F64Array, goal: F64Array
    ) -> F64Array:
        """Return the share of the way covered, plus the bonus at the goal [N]."""
        del displacement, goal
        return 1 - distance / start_distance + (distance < REACHED_M)


PRIMITIVE_REWARDS: dict[str, type[PrimitiveReward]] = {reward.name: reward for reward in (ProgressReward,)}


def make_primitive_reward(name: str) -> PrimitiveReward:
    """Return the primitive reward of this name.

    Raises:
        UnknownNameError: `name` is not in `PRIMITIVE_REWARDS`.
    """
    if name not in PRIMITIVE_REWARDS:
        raise UnknownNameError("primitive reward", name, PRIMITIVE_REWARDS, "Set --primitive-reward.")
    return PRIMITIVE_REWARDS[name]()
