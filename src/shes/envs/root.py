"""Where the robot of a MuJoCo model is, by the joints of its root: x, y and heading."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import mujoco
import numpy as np

from shes.envs.quaternions import yaw
from shes.types import F64Array

__all__ = ["Place", "find_root"]

Place: TypeAlias = tuple[float, float, float]
"""x and y in metres, heading in radians."""


def find_root(model: mujoco.MjModel) -> Callable[[F64Array], Place] | None:
    """Return what reads the place of the robot, the body of the first joint, from qpos; None if its joints do not tell.

    They are a free joint, or slide joints along x and y and, if it turns, a hinge about z.
    """
    kinds = mujoco.mjtJoint
    if model.njnt and model.jnt_type[0] == kinds.mjJNT_FREE:
        return lambda qpos: (float(qpos[0]), float(qpos[1]), float(yaw(qpos[3:7])))
    found: dict[tuple[int, tuple[float, ...]], int] = {}  # addresses in qpos
    for joint in np.flatnonzero(model.jnt_bodyid == model.jnt_bodyid[:1]):
        found[int(model.jnt_type[joint]), tuple(model.jnt_axis[joint].tolist())] = int(model.jnt_qposadr[joint])
    x, y = (found.get((int(kinds.mjJNT_SLIDE), axis)) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    turn = found.get((int(kinds.mjJNT_HINGE), (0.0, 0.0, 1.0)))
    if x is None or y is None:
        return None
    return lambda qpos: (float(qpos[x]), float(qpos[y]), 0.0 if turn is None else float(qpos[turn]))
