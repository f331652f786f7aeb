"""The ant of the HIRO and SHES tasks: not Gymnasium's, which has another time step, gear and gait.

Source: environment specification, Ant body (`easier_ant.xml` of the authors' environments).
"""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np

from shes.envs.body import Body
from shes.envs.layout import ObservationElement, elements
from shes.types import BoolArray, F64Array

__all__ = ["Ant"]

TORSO_HEIGHT_M = 0.75
TORSO_RADIUS_M = 0.25
LEG_RADIUS_M = 0.08
UPPER_M = 0.2  # reach in x and in y of the fixed capsule and of the hip's
LOWER_M = 0.4  # reach in x and in y of the ankle's capsule
HIP_RANGE_DEG = (-30.0, 30.0)
HEALTHY_Z_M = (0.2, 1.0)
"""The ant has fallen when its torso leaves this range."""

# number: (sign of x, sign of y, ankle axis, ankle range in degrees)
_LEGS = {
    1: (1, 1, (-1, 1, 0), (30.0, 70.0)),
    2: (-1, 1, (1, 1, 0), (-70.0, -30.0)),
    3: (-1, -1, (-1, 1, 0), (-70.0, -30.0)),
    4: (1, -1, (1, 1, 0), (30.0, 70.0)),
}
_ACTUATOR_ORDER = (4, 1, 2, 3)  # not the order of the legs in qpos
_JOINTS = [f"{joint}_{number}" for number in _LEGS for joint in ("hip", "ankle")]


class Ant(Body):
    """Four legs of two joints; qpos: x y z, quaternion w x y z, then hip and ankle of legs 1 to 4."""

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

    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add torso, legs and motors to `spec`."""
        torso = spec.worldbody.add_body(name="torso", pos=[0, 0, ground_m + TORSO_HEIGHT_M])
        torso.add_joint(name="root", type=mujoco.mjtJoint.mjJNT_FREE, margin=0.01)
        torso.add_geom(name="torso_geom", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[TORSO_RADIUS_M, 0, 0])
        for number in _LEGS:
            self._add_leg(torso, number)
        for joint in self.controls:
            motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.set_to_motor()
            motor.ctrllimited = True
            motor.ctrlrange = [-self.control_limit, self.control_limit]

    @staticmethod
    def _add_leg(torso: mujoco.MjsBody, number: int) -> None:
        """Add one leg to the torso: a fixed capsule, the hip's, the ankle's."""
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
        """Return the angle [N] of the torso's x axis, rotated by its quaternion, in the xy plane."""
        w, x, y, z = (qpos[..., i] for i in range(3, 7))
        return np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)

    def fallen(self, qpos: F64Array) -> BoolArray:
        """Return whether the torso's height is outside `HEALTHY_Z_M` [N]."""
        height = qpos[..., 2]
        return ~((height >= HEALTHY_Z_M[0]) & (height <= HEALTHY_Z_M[1]))
