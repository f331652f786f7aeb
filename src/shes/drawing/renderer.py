"""The contract of drawing: a drawer makes pictures of poses; a renderer does so for a MuJoCo world, to scale."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from shes.envs.markers import Marker
from shes.errors import UnknownNameError
from shes.types import F64Array

Picture = NDArray[np.uint8]
"""Pixels [H, W, 3]."""
CAMERAS = ("follow", "top")
"""`follow` is behind and above the robot, and moves with it; `top` shows the whole world from above."""
Extent = tuple[float, float, float, float]
"""Least x and y, greatest x and y, in metres."""
_RIM_M = 1.0
"""Visible part of the outer walls."""
_OPEN_HALF_M = 10.0
"""Half width of what is shown of a world without walls."""


class Drawer(ABC):
    """Makes pictures, of one size, of the poses of one environment."""

    cameras: Sequence[str]
    """Names of its cameras."""

    @abstractmethod
    def draw(self, pose: Any, /, markers: Sequence[Marker] = (), camera: str = "follow") -> Picture:
        """Return a picture [H, W, 3] of `pose` with `markers`."""

    @abstractmethod
    def between(self, start: Any, end: Any, fraction: float) -> Any:
        """Return the pose a `fraction` of the way from `start` to `end`."""

    def close(self) -> None:  # noqa: B027 - some hold none
        """Release its resources."""


class Renderer(Drawer):
    """A drawer of one MuJoCo world. A pose is its qpos [nq]."""

    cameras = CAMERAS

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.width, self.height = width, height
        self.extent = extent_of(model)
        """Area shown from above: least x and y, greatest x and y, in metres."""

    def between(self, start: F64Array, end: F64Array, fraction: float) -> F64Array:
        """Return the pose [nq] a `fraction` of the way from `start` to `end`."""
        return between(self.model, start, end, fraction)

    @property
    def top_view(self) -> tuple[float, float, float]:
        """Centre x and y, and half height, of the picture from above, in metres."""
        left, bottom, right, top = self.extent
        half = max((top - bottom) / 2, (right - left) / 2 * self.height / self.width)
        return (left + right) / 2, (bottom + top) / 2, half


def check_camera(name: str) -> None:
    """Raise an UnknownNameError if `name` is not in `CAMERAS`."""
    if name not in CAMERAS:
        raise UnknownNameError("camera", name, CAMERAS)


def between(model: mujoco.MjModel, start: F64Array, end: F64Array, fraction: float) -> F64Array:
    """Return the pose a `fraction` of the way from `start` [nq] to `end` [nq]."""
    velocity, pose = np.zeros(model.nv), np.array(start, dtype=np.float64)
    mujoco.mj_differentiatePos(model, velocity, 1.0, start, end)
    mujoco.mj_integratePos(model, pose, velocity, fraction)
    return pose


class Outline(NamedTuple):
    """A box of the world, seen from above."""

    kind: str
    """`wall`, `platform` or `block`."""
    corners: F64Array
    """Its corners in order [4, 2] in metres."""


def outlines(model: mujoco.MjModel) -> list[Outline]:
    """Return the boxes of the world of `model` before the first step, the lowest first, without the robot."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found: list[tuple[float, Outline]] = []
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX).tolist():
        kind = box_kind(model, geom)
        if kind == "wall" or model.geom(geom).name.startswith(kind):  # a moving box of another name is the robot's
            top = float(data.geom_xpos[geom, 2] + model.geom_size[geom, 2])
            found.append((top, Outline(kind, box_corners(model, data, geom)[:, :2])))
    return [outline for _, outline in sorted(found, key=lambda each: each[0])]


def box_kind(model: mujoco.MjModel, geom: int) -> str:
    """Return what box `geom` is: a `platform` by its name, else a `wall` if it cannot move, else a `block`."""
    if model.geom(geom).name.startswith("platform"):
        return "platform"
    return "wall" if model.body_weldid[model.geom_bodyid[geom]] == 0 else "block"


def box_corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> F64Array:
    """Return the corners of box `geom` at half its height, in order [4, 3] in metres, at the pose of `data`."""
    place, axes, size = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
    return np.stack([place + axes @ (size * [i, j, 0]) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


def extent_of(model: mujoco.MjModel) -> Extent:
    """Return the area to show from above, with the rim of the outer walls."""
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
