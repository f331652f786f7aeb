"""Position and heading of a robot, read from the root joints of its MuJoCo model."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import mujoco
import numpy as np

from shes.types import F64Array

PlanarPose: TypeAlias = tuple[float, float, float]
"""x and y in metres, heading in radians."""


def yaw(quaternion: F64Array) -> F64Array:
    """Return the heading [...], in radians, of the x axis rotated by unit quaternions w, x, y, z [..., 4]."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)


def find_root(model: mujoco.MjModel) -> Callable[[F64Array], PlanarPose] | None:
    """Return a function that reads the robot's planar pose from qpos, or None if the joints do not determine it.

    The robot is the body of the first joint. It needs a free joint, or slide joints along x and y; a hinge about z is
    its heading, which is 0 without one.
    """
    kinds = mujoco.mjtJoint
    if model.njnt and model.jnt_type[0] == kinds.mjJNT_FREE:
        return lambda qpos: (float(qpos[0]), float(qpos[1]), float(yaw(qpos[3:7])))
    addresses: dict[tuple[int, tuple[float, ...]], int] = {}  # (joint type, axis) -> index in qpos
    for joint in np.flatnonzero(model.jnt_bodyid == model.jnt_bodyid[:1]):
        addresses[int(model.jnt_type[joint]), tuple(model.jnt_axis[joint].tolist())] = int(model.jnt_qposadr[joint])
    x, y = (addresses.get((int(kinds.mjJNT_SLIDE), axis)) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    turn = addresses.get((int(kinds.mjJNT_HINGE), (0.0, 0.0, 1.0)))
    if x is None or y is None:
        return None
    return lambda qpos: (float(qpos[x]), float(qpos[y]), 0.0 if turn is None else float(qpos[turn]))
