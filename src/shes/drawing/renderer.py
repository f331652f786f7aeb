"""The base of renderers, which make pictures of a MuJoCo world."""

from __future__ import annotations

from functools import cached_property

import mujoco
import numpy as np

from shes.drawing.drawer import Drawer
from shes.errors import UnknownNameError
from shes.types import F64Array

CAMERAS = ("follow", "top")
"""`follow` is behind and above the robot, and moves with it; `top` shows the whole world from above."""
_RIM_M = 1.0
"""Visible part of the outer walls, seen from above."""
_OPEN_HALF_M = 10.0
"""Half width of what is shown of a world without walls."""


class Renderer(Drawer):
    """A drawer of one world at one size. A pose is its qpos [nq]."""

    cameras = CAMERAS

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self.model = model
        self.width, self.height = width, height
        self.data = mujoco.MjData(model)

    def between(self, start: F64Array, end: F64Array, fraction: float) -> F64Array:
        """Return the pose [nq] a `fraction` of the way from `start` to `end`."""
        return between(self.model, start, end, fraction)

    @cached_property
    def extent(self) -> tuple[float, float, float, float]:
        """Area shown from above, with the rim of the outer walls: least x and y, greatest x and y, in metres."""
        return extent_of(self.model)

    @property
    def top_view(self) -> tuple[float, float, float]:
        """Centre x and y, and half height, of the picture from above, in metres."""
        left, bottom, right, top = self.extent
        half = max((top - bottom) / 2, (right - left) / 2 * self.height / self.width)
        return (left + right) / 2, (bottom + top) / 2, half


def extent_of(model: mujoco.MjModel) -> tuple[float, float, float, float]:
    """Return the area to show from above: least x and y, greatest x and y, in metres. See `Renderer.extent`."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    boxes = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    if not boxes.any():
        return (-_OPEN_HALF_M, -_OPEN_HALF_M, _OPEN_HALF_M, _OPEN_HALF_M)
    center, half = data.geom_xpos[boxes, :2], model.geom_size[boxes, :2]
    corners: list[float] = []
    for sign in (-1, 1):
        sides = center + sign * half
        outermost = sign * (sign * sides).max(axis=0)
        thickness = np.where(np.isclose(sides, outermost), 2 * half, np.inf).min(axis=0)
        corners += (outermost - sign * np.maximum(thickness - _RIM_M, 0.0)).tolist()
    left, bottom, right, top = corners
    return left, bottom, right, top


def check_camera(name: str) -> None:
    """Raise an UnknownNameError if `name` is not in `CAMERAS`."""
    if name not in CAMERAS:
        raise UnknownNameError("camera", name, CAMERAS)


def between(model: mujoco.MjModel, start: F64Array, end: F64Array, fraction: float) -> F64Array:
    """Return the pose a `fraction` of the way from `start` [nq] to `end` [nq]."""
    velocity = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, velocity, 1.0, start, end)
    pose = np.array(start, dtype=np.float64)
    mujoco.mj_integratePos(model, pose, velocity, fraction)
    return pose
