"""Rotations as unit quaternions w, x, y, z, as MuJoCo writes them."""

from __future__ import annotations

import numpy as np

from shes.types import F64Array

__all__ = ["yaw"]


def yaw(quaternion: F64Array) -> F64Array:
    """Return the angle [...] in the xy plane, in radians, of the x axis rotated by `quaternion` [..., 4]."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)
