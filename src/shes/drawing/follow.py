"""The view that follows the robot: from behind and above, steeper where a wall, a block or a platform would hide it."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

import mujoco
import numpy as np

from shes.drawing.scenery import SCENERY_GROUP
from shes.types import F64Array

_AZIMUTH_DEG = 90.0
_DISTANCE_M = 11.0
_ELEVATIONS_DEG = range(42, 90)
"""Heights of the camera above the horizon; the first from which the robot is visible is used."""
_SPARE_DEG = 12
"""The robot must be visible from this much lower too, so that its legs are."""
_EDGE_M = 4.0
"""The camera does not point nearer to the edge of the world than this, so that walls do not fill the picture."""
_MAX_SHIFT_M = 3.0
"""The camera points at most this far from the robot, which stays in the picture."""
_ROBOT_BODY = 1  # the first body of every world
_SCENERY = (np.arange(mujoco.mjNGROUP) == SCENERY_GROUP).astype(np.uint8)


class FollowView(NamedTuple):
    """A view of the robot in the conventions of `mujoco.MjvCamera`."""

    lookat: F64Array
    """Point that the camera points at [3] in metres."""
    azimuth: float
    """Direction of view in degrees."""
    elevation: float
    """Elevation of the direction of view in degrees; negative is downwards."""
    distance: float
    """Distance from the camera to `lookat` in metres."""

    @property
    def eye(self) -> F64Array:
        """Position of the camera [3] in metres."""
        azimuth, elevation = np.deg2rad((self.azimuth, self.elevation))
        level = np.cos(elevation)
        direction = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
        return self.lookat - self.distance * direction


def follow_view(model: mujoco.MjModel, data: mujoco.MjData, extent: tuple[float, float, float, float]) -> FollowView:
    """Return the view of the robot at the pose of `data`, whose positions of bodies and geoms have been computed.

    The scenery of the decorated world `model` is in `SCENERY_GROUP`; `extent` is its least x and y, greatest x and
    y, in metres.
    """
    robot = data.xpos[_ROBOT_BODY]
    low, high = np.reshape(extent, (2, 2))
    inside = np.clip(robot[:2], low + _EDGE_M, high - _EDGE_M)
    lookat = robot.copy()
    lookat[:2] += np.clip(inside - robot[:2], -_MAX_SHIFT_M, _MAX_SHIFT_M)

    def view(degrees: int) -> FollowView:
        return FollowView(lookat, _AZIMUTH_DEG, -float(degrees), _DISTANCE_M)

    def is_clear(degrees: int) -> bool:
        ray = view(degrees - _SPARE_DEG).eye - robot
        # A distance of -1 is no hit; 1 is the camera.
        return not 0 <= mujoco.mj_ray(model, data, robot, ray, _SCENERY, True, -1, None) <= 1

    first = bisect_left(_ELEVATIONS_DEG, True, key=is_clear)
    return view(_ELEVATIONS_DEG[min(first, len(_ELEVATIONS_DEG) - 1)])
