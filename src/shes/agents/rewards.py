"""Primitive rewards: the intrinsic reward that the primitive receives each step. Source: SHES paper II-B."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from shes.errors import ConfigError
from shes.options import subclass_of
from shes.registry import Registry
from shes.types import F64Array

METRE_REWARD, NEAR_REWARD = 4.0, 0.2
"""Rewards of `metres`: per metre of approach, and per step near the goal."""
REACHED_M = 1.0
"""A goal nearer than this is reached (L in the paper)."""


class PrimitiveReward(ABC):
    """Reward of a step, from the robot's movement since the goal was set.

    A subclass that is also a `shes.settings.Settings` dataclass has its fields as flags of `shes train`.
    """

    starts_with_step: ClassVar[bool] = False
    """Whether `start_distance` is the distance before the step, instead of that when the goal was set."""

    @abstractmethod
    def __call__(self, distance: F64Array, start_distance: F64Array, moved: F64Array, goal: F64Array) -> F64Array:
        """Return the reward [N] of a step.

        Args:
            distance: From the robot to the goal after the step [N], in metres.
            start_distance: From the robot to the goal when the goal was set [N], in metres; see `starts_with_step`.
            moved: Movement of the robot since the goal was set [N, 2], in metres.
            goal: Goal relative to the robot's position when it was set [N, 2], in metres.
        """

    def check_result(self, name: str) -> None:
        """Raise ConfigError unless this reward, registered as `name`, returns numbers [N]."""
        shape = np.shape(self(np.ones(2), np.ones(2), np.ones((2, 2)), np.ones((2, 2))))
        if shape != (2,):
            raise ConfigError(
                f"primitive reward {name!r} must return an array [N], one number for each of N episodes; "
                f"for 2 episodes it returned shape {shape}, not (2,)."
            )


class ProgressReward(PrimitiveReward):
    """Fraction of the distance covered, `1 - d_t / d_c`, plus 1 within 1 m of the goal. Source: paper, equation 1."""

    def __call__(self, distance: F64Array, start_distance: F64Array, moved: F64Array, goal: F64Array) -> F64Array:
        """Return the covered fraction plus the bonus at the goal [N]."""
        return 1 - distance / start_distance + (distance < REACHED_M)


class MetresReward(PrimitiveReward):
    """Four times the metres by which the step approached the goal, plus 0.2 within 1 m of it.

    The reward of a step does not depend on the initial distance of the goal, so near goals are not preferred.

    Source: Ng et al. 1999 (rewards by potential differences).
    Deviation: the paper's equation 1 rewards the covered fraction of the distance in every step.
    """

    starts_with_step = True

    def __call__(self, distance: F64Array, start_distance: F64Array, moved: F64Array, goal: F64Array) -> F64Array:
        """Return the reward [N] of a step that began at `start_distance`."""
        return METRE_REWARD * (start_distance - distance) + NEAR_REWARD * (distance < REACHED_M).astype(np.float64)


class NegativeDistanceReward(PrimitiveReward):
    """Minus the distance to the goal in metres.

    The reward is never positive, so that ending an episode early has the highest return.

    Source: HIRO (Nachum et al. 2018); paper II-B describes the local minimum.
    Deviation: HIRO's goal is a state and its distance that between states. Here the goal is a point on the floor.
    """

    def __call__(self, distance: F64Array, start_distance: F64Array, moved: F64Array, goal: F64Array) -> F64Array:
        """Return minus the distance [N] in metres."""
        return -distance


class CosineReward(PrimitiveReward):
    """Cosine of the angle between the movement since the goal was set and the vector to the goal from there.

    It is in [-1, 1] and does not depend on the distance moved. It is 0 if one of the two vectors is zero.

    Source: FuN (Vezhnevets et al. 2017), as described in paper II-B.
    Deviation: FuN sets a goal each step, averages over the goals of the last c steps, and measures in a learned space.
    Here a goal is held for c steps and lies on the floor.
    """

    def __call__(self, distance: F64Array, start_distance: F64Array, moved: F64Array, goal: F64Array) -> F64Array:
        """Return the cosine [N]."""
        own, way = _direction(moved), _direction(goal)
        cosine = own[:, 0] * way[:, 0] + own[:, 1] * way[:, 1]
        return np.clip(cosine, -1, 1)  # rounding may exceed 1


def _direction(vector: F64Array) -> F64Array:
    """Return `vector` [N, 2] scaled to length 1, or (0, 0) if it is zero."""
    length = np.hypot(vector[:, 0], vector[:, 1])  # squares of very small components would underflow
    return vector / np.where(length > 0, length, 1)[:, None]


PRIMITIVE_REWARDS: Registry[type[PrimitiveReward]] = Registry(
    "primitive reward",
    {
        "progress": ProgressReward,
        "metres": MetresReward,
        "negative_distance": NegativeDistanceReward,
        "cosine": CosineReward,
    },
    fix="Set --primitive-reward. Register your own first: shes.register_primitive_reward, or --import MODULE.",
    check=subclass_of(PrimitiveReward),
)
"""Primitive rewards by name: the choices of `--primitive-reward`."""
register_primitive_reward = PRIMITIVE_REWARDS.register
"""Registers a class under a name in this process, for `shes.train(..., primitive_reward=name)`."""
