"""What a robot is to a task: how it is built, where it is, which way it looks, when it has fallen."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import mujoco

from shes.envs.bodies.symmetry import SymmetryGroup
from shes.envs.observation_spec import ObservationElement
from shes.errors import ConfigError
from shes.settings import Settings
from shes.types import BoolArray, F64Array

__all__ = ["Body"]


class Body(ABC):
    """A robot. Its coordinates come first in the model's qpos and qvel."""

    name: ClassVar[str]
    Options: ClassVar[type[Settings]] = Settings
    """Its options: a subclass of `Settings` whose fields are flags of training. It is made from an object of it."""
    pose: ClassVar[tuple[ObservationElement, ...]]
    """Its generalised coordinates, qpos."""
    velocity: ClassVar[tuple[ObservationElement, ...]]
    """Its generalised velocities, qvel."""
    controls: ClassVar[tuple[str, ...]]
    """What each control moves."""
    control_unit: ClassVar[str]
    """Unit of a control before it is scaled to [-1, 1]."""
    control_limit: ClassVar[float]
    """Controls lie in [-control_limit, control_limit]."""
    quaternion: ClassVar[slice | None]
    """Where the torso's unit quaternion stands in qpos, if there is one."""
    egocentric: ClassVar[tuple[ObservationElement, ...]] = ()
    """Its state with nothing of the world in it but gravity: what `write_egocentric` writes; empty if not told."""

    def __init__(self, options: Settings | None = None) -> None:
        """Make the robot, with options of class `Options`; their defaults if none."""
        self.options = self.Options() if options is None else options

    @property
    def num_qpos(self) -> int:
        """Generalised coordinates."""
        return len(self.pose)

    @property
    def num_qvel(self) -> int:
        """Generalised velocities."""
        return len(self.velocity)

    @property
    def num_controls(self) -> int:
        """Controls, A."""
        return len(self.controls)

    @abstractmethod
    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add the robot and its actuators to `spec`, at the origin, on ground of this height."""

    @abstractmethod
    def heading(self, qpos: F64Array) -> F64Array:
        """Return the yaw [N] in radians of robots at `qpos` [N, num_qpos]."""

    @abstractmethod
    def fallen(self, qpos: F64Array) -> BoolArray:
        """Return whether robots at `qpos` [N, num_qpos] have fallen over [N]."""

    def frame_angle(self, qpos: F64Array) -> F64Array:
        """Return the angle [N] of the frame that the egocentric view is seen from, about the vertical, in radians.

        It turns with the robot: a robot with a symmetry must have one that no element of its group tells from another.
        """
        return self.heading(qpos)

    def write_egocentric(self, qpos: F64Array, qvel: F64Array, angle: F64Array, out: F64Array) -> None:
        """Write the robot's state as it looks in its own frame, without its place.

        Args:
            qpos: Generalised coordinates [N, num_qpos].
            qvel: Generalised velocities [N, num_qvel].
            angle: The frame's angle at `qpos` [N], in radians; see `frame_angle`.
            out: Where the values of `egocentric` go [N, V].

        Raises:
            ConfigError: The robot has no egocentric view.
        """
        raise ConfigError(
            f"nobody has told what the {self.name} looks like from its own frame. Define `egocentric` and "
            "`write_egocentric` in its class, or choose another view."
        )

    def symmetry(self, *, is_mirrored: bool) -> SymmetryGroup | None:
        """Return the turns after which the robot looks the same, with their mirror images if wanted.

        None stands for a robot without a symmetry, or whose symmetry nobody has told.
        """
        del is_mirrored
        return None

    def position(self, qpos: F64Array) -> F64Array:
        """Return the place [N, 2] in metres of robots at `qpos` [N, num_qpos]: a view."""
        return qpos[..., :2]
