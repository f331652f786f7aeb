"""The ant of the HIRO and SHES tasks. Gymnasium's ant differs: it has another time step and another gear.

Source: `easier_ant.xml` of the SHES authors' HrlMuJoCoEnvs.jl; `docs/environments/index.md`, *The ant*.
"""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np

from shes.envs.bodies.body import (
    Body,
    ObservationElement,
    SymmetryGroup,
    dihedral_group,
    elements,
    signed_permutation,
    yaw,
)
from shes.types import BoolArray, F64Array

TORSO_HEIGHT_M = 0.75
TORSO_RADIUS_M = 0.25
LEG_RADIUS_M = 0.08
UPPER_M = 0.2
"""Extent along x and along y of the fixed capsule and of the hip's."""
LOWER_M = 0.4
"""Extent along x and along y of the ankle's capsule."""
HIP_RANGE_DEG = (-30.0, 30.0)
HEALTHY_Z_M = (0.2, 1.0)
"""The ant has fallen when its torso leaves this range of heights above the ground."""

# leg: (sign of x, sign of y, ankle axis, ankle range in degrees)
_LEGS = {
    1: (1, 1, (-1, 1, 0), (30.0, 70.0)),
    2: (-1, 1, (1, 1, 0), (-70.0, -30.0)),
    3: (-1, -1, (-1, 1, 0), (-70.0, -30.0)),
    4: (1, -1, (1, 1, 0), (30.0, 70.0)),
}
_ACTUATOR_ORDER = (4, 1, 2, 3)  # not the order of the legs in qpos
_FLEXION = {1: 1, 2: -1, 3: -1, 4: 1}
"""Sign that turns an ankle's angle into its flexion, which is equal in legs of equal shape."""
_NEXT_LEG = {1: 2, 2: 3, 3: 4, 4: 1}  # after a quarter turn to the left
_MIRRORED_LEG = {1: 4, 2: 3, 3: 2, 4: 1}  # reflected, left to right
_JOINTS = [f"{joint}_{number}" for number in _LEGS for joint in ("hip", "ankle")]


class Ant(Body):
    """A torso with four legs of two joints. qpos: x y z, quaternion w x y z, then hip and ankle of legs 1 to 4."""

    name = "ant"
    pose: ClassVar[tuple[ObservationElement, ...]] = (
        *elements(["torso_x", "torso_y", "torso_z"], "{} in the world", "m"),
        *(ObservationElement(name=f"torso_q{i}", meaning=f"{i} of the torso's unit quaternion") for i in "wxyz"),
        *elements(_JOINTS, "angle of {}", "rad"),
    )
    velocity: ClassVar[tuple[ObservationElement, ...]] = (
        *elements([f"torso_v{axis}" for axis in "xyz"], "{}: velocity along a world axis", "m/s"),
        *elements([f"torso_w{axis}" for axis in "xyz"], "{}: angular velocity about an axis of the torso", "rad/s"),
        *elements([f"{joint}_velocity" for joint in _JOINTS], "{}", "rad/s"),
    )
    controls: ClassVar[tuple[str, ...]] = tuple(
        f"{joint}_{number}" for number in _ACTUATOR_ORDER for joint in ("hip", "ankle")
    )
    control_unit: ClassVar[str] = "N m"
    control_limit: ClassVar[float] = 30.0
    quaternion: ClassVar[slice | None] = slice(3, 7)
    # Height, quaternion, then hip and ankle of each leg. Source: Nachum et al. 2018, appendix C.1.
    goal_half_range: ClassVar[tuple[float, ...]] = (0.5, 1.0, 1.0, 1.0, 1.0, *(0.5, 0.3) * 4)
    egocentric: ClassVar[tuple[ObservationElement, ...]] = (
        pose[2],
        *elements(["tilt_ahead", "tilt_left"], "{}: component of the torso's z axis"),
        *elements(["velocity_ahead", "velocity_left", "velocity_up"], "{} of the torso", "m/s"),
        *velocity[3:6],
        *pose[7:],
        *velocity[6:],
    )

    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add torso, legs and motors to `spec`."""
        torso = spec.worldbody.add_body(name="torso", pos=[0, 0, ground_m + TORSO_HEIGHT_M])
        torso.add_joint(name="root", type=mujoco.mjtJoint.mjJNT_FREE, margin=0.01)
        torso.add_geom(name="torso_geom", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[TORSO_RADIUS_M, 0, 0])
        for number in _LEGS:
            self._add_leg(torso, number)
        self.add_motors(spec)

    @staticmethod
    def _add_leg(torso: mujoco.MjsBody, number: int) -> None:
        """Add a leg to the torso: a fixed capsule, the hip's capsule, and the ankle's."""
        sign_x, sign_y, ankle_axis, ankle_range = _LEGS[number]
        upper = [UPPER_M * sign_x, UPPER_M * sign_y, 0]
        lower = [LOWER_M * sign_x, LOWER_M * sign_y, 0]
        base = torso.add_body(name=f"leg_{number}")
        hip = base.add_body(name=f"upper_{number}", pos=upper)
        ankle = hip.add_body(name=f"lower_{number}", pos=upper)
        for body, end in ((base, upper), (hip, upper), (ankle, lower)):
            body.add_geom(
                name=f"{body.name}_geom",
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=[LEG_RADIUS_M, 0, 0],
                fromto=[0, 0, 0, *end],
            )
        hinge = {"type": mujoco.mjtJoint.mjJNT_HINGE, "armature": 1.0, "damping": 1.0, "limited": True}
        hip.add_joint(name=f"hip_{number}", axis=[0, 0, 1], range=HIP_RANGE_DEG, **hinge)
        ankle.add_joint(name=f"ankle_{number}", axis=ankle_axis, range=ankle_range, **hinge)

    def heading(self, qpos: F64Array) -> F64Array:
        """Return the angle [N] in the xy plane of the torso's x axis, in radians."""
        return yaw(qpos[..., 3:7])

    def fallen(self, qpos: F64Array, ground_m: float = 0.0) -> BoolArray:
        """Return whether the torso's height above the ground is outside `HEALTHY_Z_M` [N]."""
        height = qpos[..., 2] - ground_m
        return ~((height >= HEALTHY_Z_M[0]) & (height <= HEALTHY_Z_M[1]))

    def cos_tilt(self, qpos: F64Array) -> F64Array:
        """Return the vertical component [N] of the torso's own z axis."""
        x, y = qpos[..., 4], qpos[..., 5]
        return 1 - 2 * (x * x + y * y)

    def frame_angle(self, qpos: F64Array) -> F64Array:
        """Return the twist of the torso about the vertical [N] in radians.

        Deviation: not the heading. Seen from above, the x and y axes of a tilted torso are not a quarter turn apart, so
        the frame of the heading violates the symmetry to second order in the tilt.
        """
        return 2 * np.arctan2(qpos[:, 6], qpos[:, 3])

    def write_egocentric(self, qpos: F64Array, qvel: F64Array, angle: F64Array, out: F64Array) -> None:
        """Write height, tilt, velocity, angular velocity and joints [N, 25]; see `Body.write_egocentric`.

        MuJoCo's angular velocity of a free joint is already in the torso's frame.
        """
        cosine, sine = np.cos(angle), np.sin(angle)
        w, x, y, z = (qpos[:, i] for i in range(3, 7))
        out[:, 0] = qpos[:, 2]
        _turn_back(2 * (x * z + w * y), 2 * (y * z - w * x), cosine, sine, out[:, 1:3])
        _turn_back(qvel[:, 0], qvel[:, 1], cosine, sine, out[:, 3:5])
        out[:, 5:9] = qvel[:, 2:6]
        out[:, 9:17] = qpos[:, 7:15]
        out[:, 17:25] = qvel[:, 6:14]

    def symmetry(self, *, is_mirrored: bool) -> SymmetryGroup:
        """Return the four quarter turns, with `is_mirrored` the eight elements of the symmetry of the square."""
        # In the frame after a quarter turn to the left: x' = y, y' = -x, and the next leg becomes leg 1.
        turn = _element([2, 1], [1, -1], [1, -1], _NEXT_LEG, hip_sign=1)
        # Reflection reverses rotations about axes in the mirror plane, but not about the axis normal to it.
        mirror = _element([1, 2], [1, -1], [-1, 1], _MIRRORED_LEG, hip_sign=-1)
        return dihedral_group(4, turn, mirror, is_mirrored=is_mirrored)


def _element(
    source: list[int], sign: list[int], spin_sign: list[int], legs: dict[int, int], hip_sign: int
) -> tuple[F64Array, F64Array]:
    """Return the action of a group element on the egocentric view and on the controls.

    `source` is the component, 1 or 2, that the x and y of a vector come from, and `sign` and `spin_sign` are the signs
    of a vector and of an angular velocity.
    """
    joints, joint_signs = _joints(tuple(_LEGS), legs, hip_sign)
    index = [0, *source, *(2 + i for i in source), 5, *(5 + i for i in source), 8]
    index += [first + i for first in (9, 17) for i in joints]
    # Reflection reverses the rotation about the vertical, as it does those of the hips.
    signs = [1, *sign, *sign, 1, *spin_sign, hip_sign, *joint_signs * 2]
    return signed_permutation(index, signs), signed_permutation(*_joints(_ACTUATOR_ORDER, legs, hip_sign))


def _joints(order: tuple[int, ...], legs: dict[int, int], hip_sign: int) -> tuple[list[int], list[int]]:
    """Return source and sign of one value for each hip and ankle; the legs are in `order`."""
    index, sign = list[int](), list[int]()
    for leg in order:
        first = 2 * order.index(legs[leg])
        index += [first, first + 1]
        sign += [hip_sign, _FLEXION[leg] * _FLEXION[legs[leg]]]
    return index, sign


def _turn_back(x: F64Array, y: F64Array, cosine: F64Array, sine: F64Array, out: F64Array) -> None:
    """Write the vectors (`x`, `y`) [N], rotated back by the angle of `cosine` and `sine`, into `out` [N, 2]."""
    np.add(cosine * x, sine * y, out=out[:, 0])
    np.subtract(cosine * y, sine * x, out=out[:, 1])
