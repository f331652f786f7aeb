"""Primitive rewards: what a controller pays its primitive each step. Source: SHES paper II-B."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from shes.errors import ConfigError
from shes.registry import Registry, subclass_of
from shes.types import F64Array

__all__ = [
    "PRIMITIVE_REWARDS",
    "CosineReward",
    "MetresReward",
    "NegativeDistanceReward",
    "PrimitiveReward",
    "ProgressReward",
    "make_primitive_reward",
    "register_primitive_reward",
]

METRE_REWARD, NEAR_REWARD = 4.0, 0.2
"""With `metres`: of a metre nearer to the goal, and of a step near it."""
REACHED_M = 1.0
"""A goal nearer than this is reached (L in the paper)."""


class PrimitiveReward(ABC):
    """Reward of one step from where the robot was when the goal was set, where it is, and where the goal is."""

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

    def of_step(
        self, distance: F64Array, before: F64Array, start_distance: F64Array, displacement: F64Array, goal: F64Array
    ) -> F64Array:
        """Return the reward [N] of a step that began `before` metres [N] from the goal; see `__call__`."""
        del before
        return self(distance, start_distance, displacement, goal)


class ProgressReward(PrimitiveReward):
    """`1 - d_t / d_c`, plus 1 within 1 m of the goal (paper, equation 1)."""

    def __call__(
        self, distance: F64Array, start_distance: F64Array, displacement: F64Array, goal: F64Array
    ) -> F64Array:
        """Return the share of the way covered, plus the bonus at the goal [N]."""
        del displacement, goal
        return 1 - distance / start_distance + (distance < REACHED_M)


class MetresReward(PrimitiveReward):
    """Four times the metres that a step came nearer to the goal, plus 0.2 within 1 m of it.

    What a step is worth does not depend on how far away the goal was set, so that a near goal is not worth more effort
    than a far one, and speed pays everywhere.

    Deviation: not the paper's equation 1, which pays for the share of the way in every step.
    Source: learning specification, section 3; Ng et al. 1999 (a reward by potential differences).
    """

    def __call__(
        self, distance: F64Array, start_distance: F64Array, displacement: F64Array, goal: F64Array
    ) -> F64Array:
        """Return what the way since the goal was set is worth [N], if it was set a step ago."""
        del displacement, goal
        return METRE_REWARD * (start_distance - distance) + NEAR_REWARD * (distance < REACHED_M).astype(np.float64)

    def of_step(
        self, distance: F64Array, before: F64Array, start_distance: F64Array, displacement: F64Array, goal: F64Array
    ) -> F64Array:
        """Return what the step's own way is worth [N]."""
        del start_distance
        return self(distance, before, displacement, goal)


class NegativeDistanceReward(PrimitiveReward):
    """Minus the distance to the goal in metres, `-d_t`: never above 0, so that a robot that dies at once loses least.

    Source: HIRO (Nachum et al. 2018), of which paper II-B tells the local minimum.
    Deviation: HIRO's goal is a whole state, its distance that between states; ours is a point on the floor.
    """

    def __call__(
        self, distance: F64Array, start_distance: F64Array, displacement: F64Array, goal: F64Array
    ) -> F64Array:
        """Return minus the distance [N], in metres."""
        del start_distance, displacement, goal
        return -distance


class CosineReward(PrimitiveReward):
    """Cosine of the angle between what the robot has moved since the goal was set and the way to the goal from there.

    It is in [-1, 1] and pays for the direction, not for how far. Where the robot has not moved, or the goal was set
    where the robot stood, there is no angle: it is 0.

    Source: FuN (Vezhnevets et al. 2017), as told in paper II-B.
    Deviation: FuN averages over the goals of the last c steps, because it sets one each step, and measures in a learned
    space; ours is held for c steps, so that there is one to compare with, on the floor.
    """

    def __call__(
        self, distance: F64Array, start_distance: F64Array, displacement: F64Array, goal: F64Array
    ) -> F64Array:
        """Return the cosine [N]."""
        del distance, start_distance
        moved, way = _direction(displacement), _direction(goal)
        cosine = moved[:, 0] * way[:, 0] + moved[:, 1] * way[:, 1]
        return np.clip(cosine, -1, 1)  # rounding may exceed 1 by a bit


def _direction(vector: F64Array) -> F64Array:
    """Return `vector` [N, 2] with length 1, or (0, 0) where it has none."""
    length = np.hypot(vector[:, 0], vector[:, 1])  # its squares would vanish for very short vectors
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


def register_primitive_reward(name: str, reward: type[PrimitiveReward]) -> None:
    """Make `reward` known as `name`, in this process; then `shes.train(..., primitive_reward=name)` uses it.

    Args:
        name: Lower-case words joined by `-` or `_`.
        reward: A complete subclass of `PrimitiveReward`, made without arguments.

    Raises:
        ConfigError: The class is none or not complete, or the name is malformed or stands for another class.
    """
    PRIMITIVE_REWARDS.register(name, reward)


def make_primitive_reward(name: str) -> PrimitiveReward:
    """Return the primitive reward of this name.

    Raises:
        UnknownNameError: `name` is not in `PRIMITIVE_REWARDS`.
        ConfigError: It does not return one number for each episode.
    """
    reward = PRIMITIVE_REWARDS.find(name)()
    shape = np.shape(reward(np.ones(2), np.ones(2), np.ones((2, 2)), np.ones((2, 2))))
    if shape != (2,):
        raise ConfigError(
            f"primitive reward {name!r} must return an array [N], one number for each of N episodes; "
            f"for 2 episodes it returned shape {shape}, not (2,)."
        )
    return reward
