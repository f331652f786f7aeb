"""The point: a sphere pushed along x and y. It is fast to simulate and makes every task easier.

Source: own design; `docs/environments/index.md`, *The point*.
"""

from __future__ import annotations

from typing import ClassVar

import mujoco
import numpy as np

from shes.envs.bodies.body import Body
from shes.envs.observation_spec import ObservationElement, elements
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
    pose: ClassVar[tuple[ObservationElement, ...]] = elements(["torso_x", "torso_y"], "{} in the world", "m")
    velocity: ClassVar[tuple[ObservationElement, ...]] = elements(
        ["torso_vx", "torso_vy"], "{}: velocity along a world axis", "m/s"
    )
    controls: ClassVar[tuple[str, ...]] = ("slide_x", "slide_y")
    egocentric: ClassVar[tuple[ObservationElement, ...]] = velocity
    control_unit: ClassVar[str] = "6 N"
    control_limit: ClassVar[float] = 1.0
    quaternion: ClassVar[slice | None] = None

    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add the sphere, its slide joints and its motors to `spec`."""
        self._add_sphere(spec, ground_m + HEIGHT_M)

    def _add_sphere(self, spec: mujoco.MjSpec, height: float) -> mujoco.MjsBody:
        """Add the sphere at `height`, with slide joints and motors along x and y."""
        body = spec.worldbody.add_body(name="torso", pos=[0, 0, height])
        body.add_geom(name="torso_geom", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS_M, 0, 0], mass=MASS_KG)
        for name, axis in zip(self.controls, ([1, 0, 0], [0, 1, 0]), strict=True):
            body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, damping=DAMPING)
        self.add_motors(spec, GEAR_N)
        return body

    def heading(self, qpos: F64Array) -> F64Array:
        """Return zeros [N]."""
        return np.zeros_like(qpos[..., 0])

    def write_egocentric(self, qpos: F64Array, qvel: F64Array, angle: F64Array, out: F64Array) -> None:
        """Write the velocity [N, 2]: the heading is always 0."""
        out[:] = qvel

    def fallen(self, qpos: F64Array, ground_m: float = 0.0) -> BoolArray:
        """Return False [N]."""
        return np.zeros_like(qpos[..., 0], dtype=np.bool_)


class FallingPoint(Point):
    """The point of Fall, with a third slide joint along z; qpos and qvel are x, y and height."""

    pose: ClassVar[tuple[ObservationElement, ...]] = elements(["torso_x", "torso_y", "torso_z"], "{} in the world", "m")
    velocity: ClassVar[tuple[ObservationElement, ...]] = elements(
        ["torso_vx", "torso_vy", "torso_vz"], "{}: velocity along a world axis", "m/s"
    )
    egocentric: ClassVar[tuple[ObservationElement, ...]] = (pose[2], *velocity)

    def write_egocentric(self, qpos: F64Array, qvel: F64Array, angle: F64Array, out: F64Array) -> None:
        """Write height and velocity [N, 4]."""
        out[:, 0] = qpos[:, 2]
        out[:, 1:] = qvel

    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add the sphere, its slide joints and its motors to `spec`; the third coordinate is the height."""
        height = ground_m + FALLING_HEIGHT_M
        body = self._add_sphere(spec, height)
        body.add_joint(name="slide_z", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], ref=height, damping=DAMPING)
