"""The contract of renderers, which draw a MuJoCo world to scale, and the outlines of a world from above."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from shes.envs.markers import Marker
from shes.envs.worlds import SCALE
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


class Renderer(ABC):
    """Makes pictures, of one size, of a MuJoCo world. A pose is its qpos [nq]."""

    cameras = CAMERAS
    """Names of its cameras."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self.model, self.data = model, mujoco.MjData(model)
        self.width, self.height = width, height
        self.scale = scale_of(model)
        """Factor on the lengths of markers, and of what the camera shows."""
        self.extent = extent_of(model)
        """Area shown from above: least x and y, greatest x and y, in metres."""

    @abstractmethod
    def draw(self, qpos: F64Array, markers: Sequence[Marker] = (), camera: str = "follow") -> Picture:
        """Return a picture [H, W, 3] of the world at `qpos` [nq] with `markers`."""

    def close(self) -> None:  # noqa: B027 - some hold none
        """Release its resources."""

    @property
    def top_view(self) -> tuple[float, float, float]:
        """Centre x and y, and half height, of the picture from above, in metres."""
        left, bottom, right, top = self.extent
        half = max((top - bottom) / 2, (right - left) / 2 * self.height / self.width)
        return (left + right) / 2, (bottom + top) / 2, half


def between(model: mujoco.MjModel | None, start: F64Array, end: F64Array, fraction: float) -> F64Array:
    """Return the pose a `fraction` of the way from `start` [nq] to `end` [nq]; `end` where poses are pictures."""
    if model is None:
        return end
    velocity, pose = np.zeros(model.nv), np.array(start, dtype=np.float64)
    mujoco.mj_differentiatePos(model, velocity, 1.0, start, end)
    mujoco.mj_integratePos(model, pose, velocity, fraction)
    return pose


def scale_of(model: mujoco.MjModel) -> float:
    """Return the factor on the lengths of the world of `model`."""
    has_scale = any(model.numeric(i).name == SCALE for i in range(model.nnumeric))
    return float(model.numeric(SCALE).data[0]) if has_scale else 1.0


class Outline(NamedTuple):
    """A box of the world, seen from above."""

    geom: int
    kind: str
    """`platform` by its name, else `wall` if it cannot move, else `block`."""
    corners: F64Array
    """Its corners in order [4, 2] in metres."""


def outlines(model: mujoco.MjModel, data: mujoco.MjData) -> list[Outline]:
    """Return the boxes of the world at the pose of `data`, whose positions it computes; the lowest comes first.

    A moving box that is not called a block belongs to the robot and is left out.
    """
    mujoco.mj_kinematics(model, data)
    boxes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX)
    tops = data.geom_xpos[boxes, 2] + model.geom_size[boxes, 2]
    found: list[Outline] = []
    for geom in boxes[np.argsort(tops, kind="stable")].tolist():
        name, is_fixed = model.geom(geom).name, model.body_weldid[model.geom_bodyid[geom]] == 0
        kind = "platform" if name.startswith("platform") else "wall" if is_fixed else "block"
        if kind == "wall" or name.startswith(kind):
            found.append(Outline(geom, kind, box_corners(model, data, geom)))
    return found


def box_corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> F64Array:
    """Return the corners of box `geom` at half its height, in order [4, 2] in metres."""
    axes, size = data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
    corners = [axes @ (size * [i, j, 0]) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return data.geom_xpos[geom, :2] + np.array(corners)[:, :2]


def extent_of(model: mujoco.MjModel) -> Extent:
    """Return the area to show from above, with the rim of the outer walls."""
    boxes = [outline.corners for outline in outlines(model, mujoco.MjData(model))]
    if not boxes:
        return (-_OPEN_HALF_M, -_OPEN_HALF_M, _OPEN_HALF_M, _OPEN_HALF_M)
    low, high = np.min(boxes, axis=1), np.max(boxes, axis=1)
    corners: list[float] = []
    for sign, sides in ((-1, low), (1, high)):
        outermost = sign * (sign * sides).max(axis=0)
        thickness = np.where(np.isclose(sides, outermost), high - low, np.inf).min(axis=0)
        corners += (outermost - sign * np.maximum(thickness - _RIM_M * scale_of(model), 0.0)).tolist()
    left, bottom, right, top = corners
    return left, bottom, right, top
