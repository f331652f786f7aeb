"""Goal encodings: the features of the goal that the primitive observes. Source: SHES paper II-C.

A goal is a point in the world. Every step it is encoded relative to the robot's current position.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from shes.errors import ConfigError
from shes.options import make, subclass_of
from shes.registry import Registry
from shes.types import F64Array

DISTANCE_UNIT_M = 1000.0
"""Distances are divided by this (paper II-C)."""


class GoalEncoding(ABC):
    """Turns the vector to the goal into features, which precede the rest of the primitive's observation.

    A subclass that is also a `shes.settings.Settings` dataclass has its fields as flags of `shes train`.
    """

    size: ClassVar[int]
    """Number of features."""

    @abstractmethod
    def encode(self, vector: F64Array, distance: F64Array, heading: F64Array, out: F64Array) -> None:
        """Write the features of goals into `out` [N, size].

        Args:
            vector: From the robot to the goal, in the world frame [N, 2], in metres.
            distance: Length of `vector` [N] in metres.
            heading: Yaw of the robot [N] in radians.
            out: Array for the features.
        """


class AngleEncoding(GoalEncoding):
    """Sine and cosine of the goal's bearing relative to the heading, and the distance over 1000."""

    size = 3

    def encode(self, vector: F64Array, distance: F64Array, heading: F64Array, out: F64Array) -> None:
        """Write sin, cos, distance / 1000."""
        _write_bearing(vector, heading, out)
        np.divide(distance, DISTANCE_UNIT_M, out=out[:, 2])


class MetreAngleEncoding(GoalEncoding):
    """Sine and cosine of the goal's bearing relative to the heading, and the distance in metres.

    Deviation: the distance is not divided by 1000 (paper II-C). Normalisation divides inputs by at least 0.1, so a goal
    at 5.7 m, the maximum in Table I, would have a feature below 0.06. In metres it is as large as other inputs.
    """

    size = 3

    def encode(self, vector: F64Array, distance: F64Array, heading: F64Array, out: F64Array) -> None:
        """Write sin, cos, distance."""
        _write_bearing(vector, heading, out)
        out[:, 2] = distance


class UnitVectorEncoding(GoalEncoding):
    """Unit vector to the goal in the world frame, and the distance over 1000.

    The vector is (0, 0) if the goal is exactly at the robot's position.

    Source: paper II-C, "concatenating the distance to the goal onto a normalized vector".
    """

    size = 3

    def encode(self, vector: F64Array, distance: F64Array, heading: F64Array, out: F64Array) -> None:
        """Write x / distance, y / distance, distance / 1000."""
        length = np.where(distance > 0, distance, 1)
        np.divide(vector, length[:, None], out=out[:, :2])
        np.divide(distance, DISTANCE_UNIT_M, out=out[:, 2])


class VectorEncoding(GoalEncoding):
    """Vector to the goal in the world frame, in metres.

    Source: paper II-C, which reports that it "did not work since the values are not normalized". In the authors' code,
    as here, the observation statistics normalise it like every other input.
    """

    size = 2

    def encode(self, vector: F64Array, distance: F64Array, heading: F64Array, out: F64Array) -> None:
        """Write x, y."""
        out[:] = vector


def _write_bearing(vector: F64Array, heading: F64Array, out: F64Array) -> None:
    """Write sine and cosine of the bearing of `vector` [N, 2] relative to `heading` [N] into the first columns."""
    angle = np.arctan2(vector[:, 1], vector[:, 0])
    angle -= heading
    np.sin(angle, out=out[:, 0])
    np.cos(angle, out=out[:, 1])


GOAL_ENCODINGS: Registry[type[GoalEncoding]] = Registry(
    "goal encoding",
    {
        "angle": AngleEncoding,
        "unit_vector": UnitVectorEncoding,
        "vector": VectorEncoding,
        "angle_metres": MetreAngleEncoding,
    },
    fix="Set --goal-encoding. Register your own first: shes.register_goal_encoding, or --import MODULE.",
    check=subclass_of(GoalEncoding),
)
"""Goal encodings by name: the choices of `--goal-encoding`."""


def register_goal_encoding(name: str, encoding: type[GoalEncoding]) -> None:
    """Register `encoding` as `name` in this process, for `shes.train(..., goal_encoding=name)`.

    Raises:
        ConfigError: The class is not a complete subclass made without arguments, or the name is malformed or taken.
    """
    GOAL_ENCODINGS.register(name, encoding)


def make_goal_encoding(name: str, values: Mapping[str, Any] = MappingProxyType({})) -> GoalEncoding:
    """Return the encoding called `name`, with options from `values`; raise ConfigError if it leaves a feature out."""
    encoding = make(GOAL_ENCODINGS, name, values)
    features = np.full((2, encoding.size), np.nan)
    encoding.encode(np.ones((2, 2)), np.full(2, np.sqrt(2)), np.zeros(2), features)
    if not np.isfinite(features).all():
        raise ConfigError(
            f"goal encoding {name!r} must write a number for each of its {encoding.size} features into `out`; "
            f"for the goal (1, 1) it left {features[0].tolist()}. Write them all, or change its `size`."
        )
    return encoding
