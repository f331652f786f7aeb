"""Goal encodings: what the primitive is told about its goal. Source: SHES paper II-C.

The goal is a point in the world; every step it is expressed anew from where the robot stands.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from shes.errors import UnknownNameError
from shes.types import F64Array

__all__ = ["GOAL_ENCODINGS", "AngleEncoding", "GoalEncoding", "make_goal_encoding"]

DISTANCE_SCALE = 1000.0
"""Distances are divided by this (paper II-C)."""


class GoalEncoding(ABC):
    """Turns the vector to the goal into features that stand in front of the primitive's observation."""

    name: ClassVar[str]
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

    name = "angle"
    size = 3

    def encode(self, vector: F64Array, distance: F64Array, heading: F64Array, out: F64Array) -> None:
        """Write sin, cos, distance / 1000."""
        angle = np.arctan2(vector[:, 1], vector[:, 0])
        angle -= heading
        np.sin(angle, out=out[:, 0])
        np.cos(angle, out=out[:, 1])
        np.divide(distance, DISTANCE_SCALE, out=out[:, 2])


GOAL_ENCODINGS: dict[str, type[GoalEncoding]] = {encoding.name: encoding for encoding in (AngleEncoding,)}


def make_goal_encoding(name: str) -> GoalEncoding:
    """Return the encoding of this name.

    Raises:
        UnknownNameError: `name` is not in `GOAL_ENCODINGS`.
    """
    if name not in GOAL_ENCODINGS:
        raise UnknownNameError("goal encoding", name, GOAL_ENCODINGS, "Set --goal-encoding.")
    return GOAL_ENCODINGS[name]()
