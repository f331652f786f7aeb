"""The contract of a body: a robot's geometry, motors, coordinates, heading, fall criterion, and symmetry."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import mujoco
import numpy as np

from shes.errors import ConfigError
from shes.settings import Settings
from shes.types import BoolArray, F64Array, IntArray

MIN_COS_TILT = 0.5
"""Cosine of a tilt of 60 degrees, beyond which a robot lies."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SymmetryGroup:
    """A group of K rotations, or of K rotations and K reflections: T elements.

    Element k < K expresses the robot's state in a frame rotated to the left by k / K of a full turn. Element K + k also
    reflects that frame, left to right. An element acts on the robot's egocentric view and on its controls by a signed
    permutation, so without rounding.

    Source: Mittal et al. 2024 (symmetry in learned locomotion), sections II and III; `docs/learning.md`.
    """

    num_turns: int
    """Number of rotations, K."""
    is_mirrored: bool
    """Whether the group contains the reflections."""
    view_index: IntArray
    """Index of the value that each value of the egocentric view comes from [T, V]."""
    view_sign: F64Array
    """Sign of each value of the egocentric view [T, V]."""
    control_index: IntArray
    """Index of the control in the element's frame that each control of the robot comes from [T, A]: the inverse."""
    control_sign: F64Array
    """Sign of each control [T, A]."""
    view_matrix: F64Array | None = None
    """The action on the view [T, V, V] if it is no signed permutation: turns that are no quarter turns mix x and y."""

    @property
    def shifts_clock(self) -> bool:
        """Whether a reflection shifts the clock by half a period: left and right legs take turns in a gait."""
        return self.num_turns == 1 and self.is_mirrored

    def direction(self) -> tuple[F64Array, F64Array, F64Array]:
        """Return cosine and sine of every element's rotation, and -1 for reflections, else 1; each [T]."""
        element = np.arange(len(self.view_index))
        angle = 2 * np.pi * (element % self.num_turns) / self.num_turns
        cosine, sine = np.cos(angle), np.sin(angle)
        for part in (cosine, sine):  # make quarter turns exact: np.cos(np.pi / 2) is not 0
            part[np.abs(part) < 1e-9] = 0.0
        return cosine, sine, np.where(element < self.num_turns, 1.0, -1.0)

    def choose(self, ahead: F64Array, left: F64Array) -> IntArray:
        """Return the element [N] in whose frame goals at (`ahead`, `left`) [N] are nearest to straight ahead.

        With reflections the goal is never to the right.
        """
        turn = np.arctan2(left, ahead) * (self.num_turns / (2 * np.pi))
        nearest = np.rint(turn)
        element = nearest.astype(np.int64) % self.num_turns
        if self.is_mirrored:
            element += self.num_turns * (turn < nearest).astype(np.int64)
        return element


def dihedral_group(
    num_turns: int, turn: tuple[F64Array, F64Array], mirror: tuple[F64Array, F64Array] | None
) -> SymmetryGroup:
    """Return the group that a rotation by 1 / `num_turns` of a turn to the left, and a reflection, generate.

    `turn` and `mirror` are their matrices for the egocentric view [V, V] and for the controls [A, A]: signed
    permutations, but for the turn's view. With one turn, `turn` gives no more than the sizes.
    """
    views, controls = (
        np.stack([flip @ np.linalg.matrix_power(turn[i], k) for flip in flips for k in range(num_turns)])
        for i, flips in ((i, [np.eye(len(turn[i])), *(() if mirror is None else (mirror[i],))]) for i in (0, 1))
    )
    inverses = controls.transpose(0, 2, 1)
    is_permutation = np.isin(views, (-1.0, 0.0, 1.0)).all()
    return SymmetryGroup(
        num_turns=num_turns,
        is_mirrored=mirror is not None,
        view_index=np.abs(views).argmax(axis=2),
        view_sign=views.sum(axis=2),
        control_index=np.abs(inverses).argmax(axis=2),
        control_sign=inverses.sum(axis=2),
        view_matrix=None if is_permutation else views,
    )


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


def add_motor(spec: mujoco.MjSpec, joint: str, limit: float, gear: float = 1.0) -> None:
    """Add a motor to `spec` at `joint`, with the joint's name and controls in [-limit, limit]."""
    motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_motor()
    motor.gear = [gear, 0, 0, 0, 0, 0]
    motor.ctrllimited, motor.ctrlrange = True, [-limit, limit]


class Body(ABC):
    """A robot. Its coordinates are the first of the model's qpos and qvel."""

    name: str
    """Name, e.g. `ant`."""
    Options: ClassVar[type[Settings]] = Settings
    """Class of its options: a subclass of `Settings`, whose fields become flags of training."""
    pose: tuple[ObservationElement, ...]
    """Elements of its generalised coordinates, qpos."""
    velocity: tuple[ObservationElement, ...]
    """Elements of its generalised velocities, qvel."""
    controls: tuple[str, ...]
    """Name of each control."""
    control_unit: str
    """Unit of a control before it is scaled to [-1, 1]."""
    control_limit: float
    """Controls lie in [-control_limit, control_limit]."""
    quaternion: slice | None = None
    """Slice of qpos that holds the torso's unit quaternion; None without one."""
    goal_half_range: tuple[float, ...] = ()
    """Largest change that a goal of HIRO asks of each element of `pose` after x and y; empty: of x and y alone."""
    egocentric: tuple[ObservationElement, ...] = ()
    """Elements of the egocentric view, which `write_egocentric` writes; empty without one."""
    home: F64Array | None = None
    """The pose [num_qpos] at a reset; None is the model's own, qpos0."""
    home_activation: F64Array | None = None
    """Activations [na] of the actuators at a reset; None is 0."""
    control_map: tuple[F64Array, F64Array] | None = None
    """Offset and factor [A] that make the model's controls from those of a policy; None if they are the same."""
    scale: float = 1.0
    """Size relative to the ant's, for which worlds are made: metres of their unit of length."""
    timestep_s: float = 0.02
    """Physics step."""
    frame_skip: int = 5
    """Physics steps per control step."""
    velocity_clip: float = 10.0
    """Generalised velocities are clipped to this in observations, in m/s and rad/s; not with specification hiro."""
    block_factor: float = 1.0
    """Factor on the mass of blocks, made for the ant."""

    def __init__(self, options: Settings | None = None) -> None:
        """Make the robot with `options` of class `Options`; None is their defaults."""
        self.options = self.Options() if options is None else options

    @classmethod
    def maker(cls, options: Settings) -> Callable[[], Body]:
        """Return a function that makes this body with `options`, to send to other processes."""
        return partial(cls, options)

    @property
    def num_qpos(self) -> int:
        """Number of generalised coordinates."""
        return len(self.pose)

    @property
    def num_qvel(self) -> int:
        """Number of generalised velocities."""
        return len(self.velocity)

    @abstractmethod
    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add the robot and its actuators to `spec`, at the origin, on ground of height `ground_m`."""

    def as_drawn(self) -> Body:
        """Return the body that `add_to` adds to a world for pictures, whose coordinates are those of this one."""
        return self

    @abstractmethod
    def heading(self, qpos: F64Array) -> F64Array:
        """Return the headings (yaw) [N] in radians of robots at `qpos` [N, num_qpos]."""

    @abstractmethod
    def fallen(self, qpos: F64Array, ground_m: float = 0.0) -> BoolArray:
        """Return whether robots at `qpos` [N, num_qpos], on ground of height `ground_m`, have fallen over [N]."""

    @property
    def can_tilt(self) -> bool:
        """Whether its class defines `cos_tilt`."""
        return type(self).cos_tilt is not Body.cos_tilt

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

    def position(self, qpos: F64Array, num_axes: int = 2) -> F64Array:
        """Return x and y, or x, y and z, of robots at `qpos` [N, num_qpos], in units of `scale`."""
        return qpos[..., :num_axes] if self.scale == 1 else qpos[..., :num_axes] / self.scale
