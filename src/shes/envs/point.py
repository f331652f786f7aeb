"""The point: the ant's cheap twin, a sphere pushed along x and y. Source: environment specification, Point body."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np

from shes.envs.body import Body
from shes.envs.layout import ObservationElement, elements
from shes.types import BoolArray, F64Array

__all__ = ["Point"]

RADIUS_M = 0.25
MASS_KG = 0.33
HEIGHT_M = 0.5
"""Height of the centre: the sphere touches walls and blocks, never the floor."""
GEAR_N = 6.0
DAMPING = 0.8
"""In N s/m: the top speed is GEAR_N / DAMPING = 7.5 m/s, reached with a time constant of 0.4 s, four control steps."""


class Point(Body):
    """A sphere on two slide joints; qpos and qvel are x and y. Its heading is always 0, and it cannot fall."""

    name = "point"
    pose: ClassVar[tuple[ObservationElement, ...]] = elements(["torso_x", "torso_y"], "{} in the world", "m")
    velocity: ClassVar[tuple[ObservationElement, ...]] = elements(
        ["torso_vx", "torso_vy"], "{}: velocity along a world axis", "m/s"
    )
    controls: ClassVar[tuple[str, ...]] = ("slide_x", "slide_y")
    control_unit: ClassVar[str] = "6 N"
    control_limit: ClassVar[float] = 1.0
    quaternion: ClassVar[slice | None] = None

    def add_to(self, spec: mujoco.MjSpec) -> None:
        """Add the sphere, its slides and its motors to `spec`."""
        body = spec.worldbody.add_body(name="torso", pos=[0, 0, HEIGHT_M])
        body.add_geom(name="torso_geom", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS_M, 0, 0], mass=MASS_KG)
        for name, axis in zip(self.controls, ([1, 0, 0], [0, 1, 0]), strict=True):
            body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, damping=DAMPING)
            motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.set_to_motor()
            motor.gear = [GEAR_N, 0, 0, 0, 0, 0]
            motor.ctrllimited = True
            motor.ctrlrange = [-self.control_limit, self.control_limit]

    def heading(self, qpos: F64Array) -> F64Array:
        """Return zeros [N]."""
        return np.zeros(qpos.shape[:-1])

    def fallen(self, qpos: F64Array) -> BoolArray:
        """Return False [N]."""
        return np.zeros(qpos.shape[:-1], dtype=np.bool_)
