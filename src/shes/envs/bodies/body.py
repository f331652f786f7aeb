"""The contract of a body: a robot's geometry, motors, coordinates, heading, and fall criterion."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco
import numpy as np

from shes.envs.bodies.symmetry import SymmetryGroup
from shes.errors import ConfigError
from shes.settings import Settings
from shes.types import BoolArray, F64Array


@dataclass(frozen=True, kw_only=True)
class ObservationElement:
    """One value of an observation."""

    name: str
    """Short name, unique in the observation, e.g. `torso_z`."""
    meaning: str
    unit: str = "1"
    """Unit after scaling; `1` for a dimensionless number."""
    low: float = -np.inf
    high: float = np.inf


def elements(
    names: Sequence[str], meaning: str, unit: str = "1", low: float = -np.inf, high: float = np.inf
) -> tuple[ObservationElement, ...]:
    """Return one element for each of `names`; `{}` in `meaning` is replaced by the name, with spaces."""
    return tuple(
        ObservationElement(name=name, meaning=meaning.format(name.replace("_", " ")), unit=unit, low=low, high=high)
        for name in names
    )


def yaw(quaternion: F64Array) -> F64Array:
    """Return the heading [...], in radians, of the x axis rotated by unit quaternions w, x, y, z [..., 4]."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)


class Body(ABC):
    """A robot. Its coordinates are the first of the model's qpos and qvel."""

    name: ClassVar[str]
    """Name, e.g. `ant`."""
    Options: ClassVar[type[Settings]] = Settings
    """Class of its options: a subclass of `Settings`, whose fields become flags of training."""
    pose: ClassVar[tuple[ObservationElement, ...]]
    """Elements of its generalised coordinates, qpos."""
    velocity: ClassVar[tuple[ObservationElement, ...]]
    """Elements of its generalised velocities, qvel."""
    controls: ClassVar[tuple[str, ...]]
    """Name of each control."""
    control_unit: ClassVar[str]
    """Unit of a control before it is scaled to [-1, 1]."""
    control_limit: ClassVar[float]
    """Controls lie in [-control_limit, control_limit]."""
    quaternion: ClassVar[slice | None]
    """Slice of qpos that holds the torso's unit quaternion; None without one."""
    goal_half_range: ClassVar[tuple[float, ...]] = ()
    """Largest change that a goal of HIRO asks of each element of `pose` after x and y; empty: of x and y alone."""
    egocentric: ClassVar[tuple[ObservationElement, ...]] = ()
    """Elements of the egocentric view, which `write_egocentric` writes; empty without one."""

    def __init__(self, options: Settings | None = None) -> None:
        """Make the robot with `options` of class `Options`; None is their defaults."""
        self.options = self.Options() if options is None else options

    @property
    def num_qpos(self) -> int:
        """Number of generalised coordinates."""
        return len(self.pose)

    @property
    def num_qvel(self) -> int:
        """Number of generalised velocities."""
        return len(self.velocity)

    @property
    def num_controls(self) -> int:
        """Number of controls, A."""
        return len(self.controls)

    @abstractmethod
    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add the robot and its actuators to `spec`, at the origin, on ground of height `ground_m`."""

    def add_motors(self, spec: mujoco.MjSpec, gear: float = 1.0) -> None:
        """Add a motor to `spec` for each of `controls`, if these are names of joints."""
        for joint in self.controls:
            motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.set_to_motor()
            motor.gear = [gear, 0, 0, 0, 0, 0]
            motor.ctrllimited = True
            motor.ctrlrange = [-self.control_limit, self.control_limit]

    @abstractmethod
    def heading(self, qpos: F64Array) -> F64Array:
        """Return the headings (yaw) [N] in radians of robots at `qpos` [N, num_qpos]."""

    @abstractmethod
    def fallen(self, qpos: F64Array, ground_m: float = 0.0) -> BoolArray:
        """Return whether robots at `qpos` [N, num_qpos], on ground of height `ground_m`, have fallen over [N]."""

    def cos_tilt(self, qpos: F64Array) -> F64Array:
        """Return the cosine [N] of the angle between the vertical and the robot's own, at `qpos` [N, num_qpos]."""
        raise ConfigError(f"the {self.name} has no tilt to limit. Define `cos_tilt` in its class, or omit --max-tilt.")

    def frame_angle(self, qpos: F64Array) -> F64Array:
        """Return the rotation [N] about the vertical, in radians, of the frame of the egocentric view.

        The frame turns with the robot. A robot with a symmetry needs a frame on which its group acts exactly.
        """
        return self.heading(qpos)

    def write_egocentric(self, qpos: F64Array, qvel: F64Array, angle: F64Array, out: F64Array) -> None:
        """Write the values of `egocentric` of robots at `qpos` [N, num_qpos] and `qvel` [N, num_qvel] to `out` [N, V].

        `angle` [N] is the rotation of the frame in radians; see `frame_angle`.
        """
        raise ConfigError(
            f"the {self.name} has no egocentric view. Define `egocentric` and `write_egocentric` in its class, or "
            "choose another view."
        )

    def symmetry(self, *, is_mirrored: bool) -> SymmetryGroup | None:
        """Return the rotations that map the robot onto itself, with `is_mirrored` also the reflections.

        None means that the robot has no symmetry, or that its class does not define one.
        """
        return None

    def position(self, qpos: F64Array) -> F64Array:
        """Return the positions [N, 2] in metres of robots at `qpos` [N, num_qpos], as a view."""
        return qpos[..., :2]
