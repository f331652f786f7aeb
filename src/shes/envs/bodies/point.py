"""The point: a sphere pushed along x and y. It is fast to simulate and makes every task easier.

Source: own design; `docs/environments/index.md`, *The point*.
"""

from __future__ import annotations

import mujoco
import numpy as np

from shes.envs.bodies.body import Body, add_motor, elements
from shes.types import BoolArray, F64Array

RADIUS_M = 0.25
MASS_KG = 0.33
HEIGHT_M = 0.5
"""Height of the centre: the sphere touches walls and blocks, never the floor."""
FALLING_HEIGHT_M = 0.75
"""Initial height of the centre above the ground in Fall, which has gravity: that of the ant's torso."""
GEAR_N = 6.0
DAMPING = 0.8
"""In N s/m. The top speed is GEAR_N / DAMPING = 7.5 m/s; the time constant is 0.4 s, four control steps."""


class Point(Body):
    """A sphere on two slide joints; qpos and qvel are x and y. Its heading is always 0, and it cannot fall over."""

    name = "point"
    pose = elements(["torso_x", "torso_y"], "{} in the world", "m")
    velocity = elements(["torso_vx", "torso_vy"], "{}: velocity along a world axis", "m/s")
    egocentric = velocity
    controls = ("slide_x", "slide_y")
    control_unit = "6 N"
    control_limit = 1.0
    start_height_m = HEIGHT_M
    """Initial height of the centre above the ground."""

    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add the sphere, its slide joints and its motors to `spec`; a third coordinate is the height."""
        height = ground_m + self.start_height_m
        body = spec.worldbody.add_body(name="torso", pos=[0, 0, height])
        body.add_geom(name="torso_geom", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS_M, 0, 0], mass=MASS_KG)
        for axis in "xyz"[: self.num_qpos]:
            body.add_joint(
                name=f"slide_{axis}",
                type=mujoco.mjtJoint.mjJNT_SLIDE,
                axis=[float(axis == each) for each in "xyz"],
                ref=height if axis == "z" else 0.0,
                damping=DAMPING,
            )
        for joint in self.controls:
            add_motor(spec, joint, self.control_limit, GEAR_N)

    def heading(self, qpos: F64Array) -> F64Array:
        """Return zeros [N]."""
        return np.zeros_like(qpos[..., 0])

    def fallen(self, qpos: F64Array, ground_m: float = 0.0) -> BoolArray:
        """Return False [N]."""
        return np.zeros_like(qpos[..., 0], dtype=np.bool_)

    def write_egocentric(self, qpos: F64Array, qvel: F64Array, angle: F64Array, out: F64Array) -> None:
        """Write the height [N], if it is a coordinate, and the velocity: the heading is always 0."""
        num_heights = self.num_qpos - 2
        out[:, :num_heights] = qpos[:, 2:]
        out[:, num_heights:] = qvel


class FallingPoint(Point):
    """The point of Fall, with a third slide joint along z; qpos and qvel are x, y and height."""

    pose = elements(["torso_x", "torso_y", "torso_z"], "{} in the world", "m")
    velocity = elements(["torso_vx", "torso_vy", "torso_vz"], "{}: velocity along a world axis", "m/s")
    egocentric = (pose[2], *velocity)
    start_height_m = FALLING_HEIGHT_M
