"""The ant of the HIRO and SHES tasks. Gymnasium's ant differs: it has another time step and another gear.

Source: `easier_ant.xml` of the SHES authors' HrlMuJoCoEnvs.jl; `docs/environments/index.md`, *The ant*.
"""

from __future__ import annotations

import mujoco

from shes.envs.bodies.body import add_motor
from shes.envs.bodies.free_body import FreeBody, free_elements
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
_JOINTS = [f"{joint}_{number}" for number in _LEGS for joint in ("hip", "ankle")]


class Ant(FreeBody):
    """A torso with four legs of two joints. qpos: x y z, quaternion w x y z, then hip and ankle of legs 1 to 4."""

    name = "ant"
    pose, velocity, egocentric = free_elements("torso", _JOINTS)
    controls = tuple(f"{joint}_{number}" for number in _ACTUATOR_ORDER for joint in ("hip", "ankle"))
    control_unit = "N m"
    control_limit = 30.0
    # Height, quaternion, then hip and ankle of each leg. Source: Nachum et al. 2018, appendix C.1.
    goal_half_range = (0.5, 1.0, 1.0, 1.0, 1.0, *(0.5, 0.3) * 4)

    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add torso, legs and motors to `spec`."""
        torso = spec.worldbody.add_body(name="torso", pos=[0, 0, ground_m + TORSO_HEIGHT_M])
        torso.add_joint(name="root", type=mujoco.mjtJoint.mjJNT_FREE, margin=0.01)
        torso.add_geom(name="torso_geom", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[TORSO_RADIUS_M, 0, 0])
        for number in _LEGS:
            self._add_leg(torso, number)
        for joint in self.controls:
            add_motor(spec, joint, self.control_limit)

    @staticmethod
    def _add_leg(torso: mujoco.MjsBody, number: int) -> None:
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

    def fallen(self, qpos: F64Array, ground_m: float = 0.0) -> BoolArray:
        """Return whether the torso's height above the ground is outside `HEALTHY_Z_M` [N]."""
        height = qpos[..., 2] - ground_m
        return ~((height >= HEALTHY_Z_M[0]) & (height <= HEALTHY_Z_M[1]))
