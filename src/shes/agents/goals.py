"""Goals: how the outputs of a controller determine one, and the features of it that the primitive observes.

A goal is a point in the world. Every step it is encoded relative to the robot's current position.

Source: SHES paper II-C; `forward` and `onehot_forward` of the authors' code.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from shes.agents.views import sector_directions, turned_back
from shes.errors import ConfigError
from shes.options import subclass_of
from shes.registry import Registry
from shes.types import F64Array

DISTANCE_UNIT_M = 1000.0
"""Encoded distances are divided by this (paper II-C)."""
MIN_DISTANCE_M = 1.0
"""Minimum goal distance of a one-hot output."""


class ControllerOutput(ABC):
    """Turns the outputs of the controller's network into the vector from the robot to its goal.

    A subclass that is also a `shes.settings.Settings` dataclass has its fields as flags of `shes train`.
    """

    size: int
    """Number of outputs of the network."""

    @abstractmethod
    def vector(self, output: F64Array, heading: F64Array, goal_distance: float) -> F64Array:
        """Return the vector from the robot to the goal, in the world frame [N, 2], in metres.

        Args:
            output: Outputs of the network [N, size] in [-1, 1]. Exploration noise may exceed that range slightly.
            heading: Yaw of the robot [N] in radians.
            goal_distance: Goal distance in metres for an output of 1.
        """

    def check_result(self, name: str) -> None:
        """Raise ConfigError unless this output, registered as `name`, returns vectors [N, 2]."""
        # Three episodes instead of two, so that a transposed result [2, N] is detected.
        shape = np.shape(self.vector(np.ones((3, self.size)), np.zeros(3), 1.0))
        if shape != (3, 2):
            raise ConfigError(
                f"controller output {name!r} must return an array [N, 2], the vector from the robot to the goal in "
                f"each of N episodes; for 3 episodes it returned shape {shape}, not (3, 2)."
            )

    def of_direction(self, angles: F64Array) -> F64Array:
        """Return the outputs [K, size] for goals at the goal distance in directions `angles` [K] in radians.

        Angles are counter-clockwise in the frame of the outputs: from the heading, or from the x axis. By default these
        are (cos, sin) for two outputs. For other numbers one output is 1, the others are 0: the outputs stand for
        directions at equal steps from 0. Override it for outputs that mean something else.
        """
        if self.size == 2:
            return np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return np.eye(self.size)[np.rint(angles * self.size / (2 * np.pi)).astype(int) % self.size]


class VectorOutput(ControllerOutput):
    """Vector to the goal in the world frame, in goal distances."""

    size = 2

    def vector(self, output: F64Array, heading: F64Array, goal_distance: float) -> F64Array:
        """Return `output` times the goal distance."""
        return output.astype(np.float64) * goal_distance


class DirectionOutput(VectorOutput):
    """Direction of the goal in the world frame, at the goal distance.

    Only the ratio of the outputs counts, so that a policy near zero, as at the start of training, acts with full goals.

    Deviation: the outputs of the paper's controller also set the distance.
    """

    def vector(self, output: F64Array, heading: F64Array, goal_distance: float) -> F64Array:
        """Return the vector of length `goal_distance` with the direction of `output`; 0 for outputs of 0."""
        values = output.astype(np.float64)
        length = np.sqrt((values * values).sum(axis=1, keepdims=True))
        return super().vector(values / np.maximum(length, 1e-9), heading, goal_distance)


class HeadingDirectionOutput(DirectionOutput):
    """Direction of the goal relative to the heading (ahead, left), at the goal distance; see `DirectionOutput`."""

    def vector(self, output: F64Array, heading: F64Array, goal_distance: float) -> F64Array:
        """Return the vector of length `goal_distance`, rotated by the heading."""
        return turned_back(super().vector(output, heading, goal_distance), -heading)


class OneHotOutput(ControllerOutput):
    """The largest of eight outputs selects the direction relative to the heading, and its value the distance.

    The directions are 45 degrees apart: output 0 is -135 degrees (behind to the right), output 3 straight ahead, output
    5 left, output 7 straight behind. The first of equal outputs is selected. The distance is at least 1 m.

    Source: `onehot_forward` of the authors' code (policy.jl); not in the paper.
    Deviation: the authors add 1/8 to the angle in radians, so that no goal is straight ahead, and in Gather their eight
    directions are 36 degrees apart, so that none lies within the 108 degrees behind to the left.
    """

    size = 8

    def vector(self, output: F64Array, heading: F64Array, goal_distance: float) -> F64Array:
        """Return the vector in the direction of the largest output."""
        angle = (output.argmax(axis=1) + 1) * (2 * np.pi / self.size) - np.pi
        angle += heading
        distance = np.maximum(output.max(axis=1).astype(np.float64) * goal_distance, MIN_DISTANCE_M)
        return np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)

    def of_direction(self, angles: F64Array) -> F64Array:
        """Return the outputs [K, 8] that select the nearest of the eight directions."""
        return super().of_direction(angles + np.pi - 2 * np.pi / self.size)


class SectorOutput(ControllerOutput):
    """Sum of the outputs of the sectors around the robot, each a vector along its sector's middle.

    The sum is what the `of_sum` output takes as (ahead, left), so turned outputs turn the goal. Equal outputs cancel.
    """

    def __init__(self, num_sectors: int, of_sum: ControllerOutput) -> None:
        """Sum up `num_sectors` outputs, counter-clockwise from straight behind."""
        self.size = num_sectors
        self._of_sum = of_sum
        self._along: F64Array = np.stack(sector_directions(num_sectors)) * (2 / num_sectors)

    def vector(self, output: F64Array, heading: F64Array, goal_distance: float) -> F64Array:
        """Return the vector to the goal for the sum of the sectors' vectors."""
        # Not a matmul: on a device the constants would have to be transferred, and its rounding depends on the rows.
        ahead, left = (
            sum(output[:, sector] * float(part) for sector, part in enumerate(along)) for along in self._along
        )
        return self._of_sum.vector(np.stack([ahead, left], axis=1), heading, goal_distance)

    def of_direction(self, angles: F64Array) -> F64Array:
        """Return the outputs [K, S] whose vectors add up to the directions `angles` [K]: their components."""
        return np.stack([np.cos(angles), np.sin(angles)], axis=1) @ self._along * (self.size / 2)


CONTROLLER_OUTPUTS: Registry[type[ControllerOutput]] = Registry(
    "controller output",
    {
        "vector": VectorOutput,
        "direction": DirectionOutput,
        "heading_direction": HeadingDirectionOutput,
        "one_hot": OneHotOutput,
    },
    fix="Set --controller-output. Register your own first: shes.register_controller_output, or --import MODULE.",
    check=subclass_of(ControllerOutput),
)
"""Controller outputs by name: the choices of `--controller-output`."""
register_controller_output = CONTROLLER_OUTPUTS.register
"""Registers a class under a name in this process, for `shes.train(..., controller_output=name)`."""


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

    def check_result(self, name: str) -> None:
        """Raise ConfigError if this encoding, registered as `name`, leaves a feature out."""
        features = np.full((2, self.size), np.nan)
        self.encode(np.ones((2, 2)), np.full(2, np.sqrt(2)), np.zeros(2), features)
        if not np.isfinite(features).all():
            raise ConfigError(
                f"goal encoding {name!r} must write a number for each of its {self.size} features into `out`; "
                f"for the goal (1, 1) it left {features[0].tolist()}. Write them all, or change its `size`."
            )


class AngleEncoding(GoalEncoding):
    """Sine and cosine of the goal's bearing relative to the heading, and the distance over 1000."""

    size = 3
    distance_unit_m: ClassVar[float] = DISTANCE_UNIT_M
    """Distances are divided by this."""

    def encode(self, vector: F64Array, distance: F64Array, heading: F64Array, out: F64Array) -> None:
        """Write sin, cos, distance / 1000."""
        angle = np.arctan2(vector[:, 1], vector[:, 0])
        angle -= heading
        np.sin(angle, out=out[:, 0])
        np.cos(angle, out=out[:, 1])
        np.divide(distance, self.distance_unit_m, out=out[:, 2])


class MetreAngleEncoding(AngleEncoding):
    """Sine and cosine of the goal's bearing relative to the heading, and the distance in metres.

    Deviation: the distance is not divided by 1000 (paper II-C). Normalisation divides inputs by at least 0.1, so a goal
    at 5.7 m, the maximum in Table I, would have a feature below 0.06. In metres it is as large as other inputs.
    """

    distance_unit_m = 1.0


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
register_goal_encoding = GOAL_ENCODINGS.register
"""Registers a class under a name in this process, for `shes.train(..., goal_encoding=name)`."""
