"""Controller outputs: what the numbers that a controller's network puts out say about where the goal is.

Source: SHES paper II-C; `forward` and `onehot_forward` of the authors' code. Independent of the goal encoding.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from shes.errors import ConfigError
from shes.registry import Registry, subclass_of
from shes.types import F64Array

__all__ = [
    "CONTROLLER_OUTPUTS",
    "ControllerOutput",
    "HeadingVectorOutput",
    "OneHotOutput",
    "VectorOutput",
    "make_controller_output",
    "register_controller_output",
]

NUM_DIRECTIONS = 8
"""Directions that a one-hot output can choose from."""
MIN_DISTANCE_M = 1.0
"""A one-hot output sets no goal nearer than this."""


class ControllerOutput(ABC):
    """Turns the outputs of the controller's network into the vector from the robot to its goal."""

    size: ClassVar[int]
    """Number of outputs of the network."""

    @abstractmethod
    def vector(self, output: F64Array, heading: F64Array, goal_distance: float) -> F64Array:
        """Return the vector from the robot to the goal, world frame [N, 2], in metres.

        Args:
            output: What the network put out [N, size], in [-1, 1]; exploration noise may exceed that slightly.
            heading: Yaw of the robot [N] in radians.
            goal_distance: Metres that an output of 1 stands for.
        """


class VectorOutput(ControllerOutput):
    """The two outputs are the vector in the world frame, in goal distances."""

    size = 2

    def vector(self, output: F64Array, heading: F64Array, goal_distance: float) -> F64Array:
        """Return `output` times the goal distance."""
        del heading
        return output.astype(np.float64) * goal_distance


class HeadingVectorOutput(ControllerOutput):
    """The two outputs are the vector in the frame of the heading, ahead and left, in goal distances.

    Deviation: the paper's controller says where to go in the world's frame. Where the task shows things relative to the
    heading, as Gather does, a network then has to learn to rotate before it can learn where to go.
    """

    size = 2

    def vector(self, output: F64Array, heading: F64Array, goal_distance: float) -> F64Array:
        """Return `output` times the goal distance, turned by the heading."""
        ahead, left = (output[:, i].astype(np.float64) * goal_distance for i in range(2))
        cosine, sine = np.cos(heading), np.sin(heading)
        return np.stack([cosine * ahead - sine * left, sine * ahead + cosine * left], axis=1)


class OneHotOutput(ControllerOutput):
    """The largest of eight outputs picks a direction relative to the heading, and its value the distance, at least 1 m.

    The directions are 45 degrees apart: output 0 stands for -135 degrees (behind to the right), output 3 for straight
    ahead, output 5 for the left, output 7 for straight behind. Of equal outputs the first one counts.

    Source: `onehot_forward` of the authors' code (policy.jl); not in the paper.

    Deviation: the authors add 1/8 to the angle in radians, which is neither 0 nor half of a direction's 45 degrees: it
    turns every goal 7 degrees to the left, and none lies straight ahead. Left out.

    Deviation: in Gather the authors' angles are those of its ten sensors, 36 degrees apart, but their controller has
    eight outputs: no goal can lie within the 108 degrees behind to the left. Here all tasks have eight directions.
    """

    size = NUM_DIRECTIONS

    def vector(self, output: F64Array, heading: F64Array, goal_distance: float) -> F64Array:
        """Return the vector in the direction of the largest output."""
        angle = (output.argmax(axis=1) + 1) * (2 * np.pi / NUM_DIRECTIONS) - np.pi
        angle += heading
        distance = np.maximum(output.max(axis=1).astype(np.float64) * goal_distance, MIN_DISTANCE_M)
        return np.stack([distance * np.cos(angle), distance * np.sin(angle)], axis=1)


CONTROLLER_OUTPUTS: Registry[type[ControllerOutput]] = Registry(
    "controller output",
    {
        "vector": VectorOutput,
        "heading_vector": HeadingVectorOutput,
        "one_hot": OneHotOutput,
    },
    fix="Set --controller-output. Register your own first: shes.register_controller_output, or --import MODULE.",
    check=subclass_of(ControllerOutput),
)


def register_controller_output(name: str, output: type[ControllerOutput]) -> None:
    """Make `output` known as `name`, in this process; then `shes.train(..., controller_output=name)` uses it.

    Args:
        name: Lower-case words joined by `-` or `_`.
        output: A complete subclass of `ControllerOutput`, made without arguments.

    Raises:
        ConfigError: The class is none or not complete, or the name is malformed or stands for another class.
    """
    CONTROLLER_OUTPUTS.register(name, output)


def make_controller_output(name: str) -> ControllerOutput:
    """Return the controller output of this name.

    Raises:
        UnknownNameError: `name` is not in `CONTROLLER_OUTPUTS`.
        ConfigError: It does not return one vector for each episode.
    """
    output = CONTROLLER_OUTPUTS.find(name)()
    # Three episodes, not two: a result that is turned on its side, [2, N], must not look right.
    shape = np.shape(output.vector(np.ones((3, output.size)), np.zeros(3), 1.0))
    if shape != (3, 2):
        raise ConfigError(
            f"controller output {name!r} must return an array [N, 2], the vector from the robot to the goal in each of "
            f"N episodes; for 3 episodes it returned shape {shape}, not (3, 2)."
        )
    return output
