"""The plan of a world: its walls, platforms and blocks from above, to scale."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from shes.drawing.renderer import extent_of
from shes.types import F64Array


@dataclass(frozen=True, kw_only=True)
class Outline:
    """A box of the world, seen from above."""

    kind: str
    """`wall`, `platform` or `block`."""
    corners: F64Array
    """Its corners in order [4, 2] in metres."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A world from above, before the first step."""

    outlines: list[Outline]
    """Its boxes, the lowest first."""
    extent: tuple[float, float, float, float]
    """Area worth showing: least x and y, greatest x and y, in metres."""


def plan_of(model: mujoco.MjModel) -> Plan:
    """Return the plan of the world of `model`, without the robot."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found: list[tuple[float, Outline]] = []
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX).tolist():
        kind = box_kind(model, geom)
        if kind == "wall" or model.geom(geom).name.startswith(kind):  # a moving box of another name is the robot's
            top = float(data.geom_xpos[geom, 2] + model.geom_size[geom, 2])
            found.append((top, Outline(kind=kind, corners=box_corners(model, data, geom)[:, :2])))
    return Plan(outlines=[outline for _, outline in sorted(found, key=lambda each: each[0])], extent=extent_of(model))


def box_kind(model: mujoco.MjModel, geom: int) -> str:
    """Return what box `geom` is: a `platform` by its name, else a `wall` if it cannot move, else a `block`."""
    if model.geom(geom).name.startswith("platform"):
        return "platform"
    return "wall" if model.body_weldid[model.geom_bodyid[geom]] == 0 else "block"


def box_corners(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> F64Array:
    """Return the corners of box `geom` at half its height, in order [4, 3] in metres, at the pose of `data`."""
    place, axes, size = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
    return np.stack([place + axes @ (size * [i, j, 0]) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
