"""Goal encodings: what the primitive is told about its goal. Source: SHES paper II-C.

The goal is a point in the world; every step it is expressed anew from where the robot stands.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from shes.envs.entries import check_class, check_name_is_free
from shes.errors import ConfigError, UnknownNameError
from shes.types import F64Array

__all__ = [
    "GOAL_ENCODINGS",
    "AngleEncoding",
    "GoalEncoding",
    "check_goal_encoding",
    "make_goal_encoding",
    "register_goal_encoding",
]

DISTANCE_SCALE = 1000.0
"""Distances are divided by this (paper II-C)."""


class GoalEncoding(ABC):
    """Turns the vector to the goal into features that stand in front of the primitive's observation."""

    size: ClassVar[int]
    """Number of features."""

    @abstractmethod
    def encode(self, vector: F64Array, distance: F64Array, heading: F64Array, out: F64Array) -> None:
        """Write the features of goals into `out` [N, size].

        Args:
            vector: From the robot to the goal, world frame [N, 2], in metres.
            distance: Its length [N].
            heading: Yaw of the robot [N] in radians.
            out: Where the features go.
        """


class AngleEncoding(GoalEncoding):
    """Sine and cosine of the goal's bearing relative to the heading, and the distance over 1000."""

    size = 3

    def encode(self, vector: F64Array, distance: F64Array, heading: F64Array, out: F64Array) -> None:
        """Write sin, cos, distance / 1000."""
        angle = np.arctan2(vector[:, 1], vector[:, 0])
        angle -= heading
        np.sin(angle, out=out[:, 0])
        np.cos(angle, out=out[:, 1])
        np.divide(distance, DISTANCE_SCALE, out=out[:, 2])


GOAL_ENCODINGS: dict[str, type[GoalEncoding]] = {"angle": AngleEncoding}


def register_goal_encoding(name: str, encoding: type[GoalEncoding]) -> None:
    """Make `encoding` known as `name`, in this process; then `shes.train(..., goal_encoding=name)` uses it.

    Args:
        name: Lower-case words joined by `-` or `_`.
        encoding: A complete subclass of `GoalEncoding`, made without arguments.

    Raises:
        ConfigError: The class is none or not complete, or the name is malformed or stands for another class.
    """
    check_class("goal encoding", encoding, GoalEncoding)
    check_name_is_free("goal encoding", name, encoding, GOAL_ENCODINGS)
    GOAL_ENCODINGS[name] = encoding


def check_goal_encoding(name: str) -> None:
    """Refuse an unknown encoding.

    Raises:
        UnknownNameError: `name` is not in `GOAL_ENCODINGS`.
    """
    if name not in GOAL_ENCODINGS:
        fix = "Set --goal-encoding. Register your own first: shes.register_goal_encoding, or --import MODULE."
        raise UnknownNameError("goal encoding", name, GOAL_ENCODINGS, fix)


def make_goal_encoding(name: str) -> GoalEncoding:
    """Return the encoding of this name.

    Raises:
        UnknownNameError: `name` is not in `GOAL_ENCODINGS`.
        ConfigError: It does not write as many features as its size says.
    """
    check_goal_encoding(name)
    encoding = GOAL_ENCODINGS[name]()
    features = np.full((2, encoding.size), np.nan)
    encoding.encode(np.ones((2, 2)), np.full(2, np.sqrt(2)), np.zeros(2), features)
    if not np.isfinite(features).all():
        raise ConfigError(
            f"goal encoding {name!r} must write a number for each of its {encoding.size} features into `out`; "
            f"for the goal (1, 1) it left {features[0].tolist()}. Write them all, or change its `size`."
        )
    return encoding
