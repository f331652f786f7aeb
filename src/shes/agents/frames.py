"""Frames in which a primitive observes and acts, chosen from the symmetry group of its robot.

When a goal is set, the frame is rotated and mirrored so that the goal lies as straight ahead as the symmetry allows. It
is kept until the next goal. A skill learned for one direction is thereby learned for all.

Source: `docs/learning.md`, "The body's symmetry".
"""

from __future__ import annotations

from types import ModuleType

import numpy as np

from shes.envs.bodies.symmetry import SymmetryGroup
from shes.types import F32Array, F64Array, IntArray


class Frames:
    """The frames of N robots, in arrays of `xp`."""

    def __init__(self, group: SymmetryGroup, num_robots: int, xp: ModuleType = np) -> None:
        self._group, self._xp = group, xp
        cosine, sine, mirror = (xp.asarray(table) for table in group.direction())
        self._direction = xp.stack([cosine, sine, mirror])  # [3, T]
        self._view_index, self._view_sign = xp.asarray(group.view_index), xp.asarray(group.view_sign)
        self._control_index = xp.asarray(group.control_index)
        self._control_sign = xp.asarray(group.control_sign.astype(np.float32))
        size, num_controls = group.view_index.shape[1], group.control_index.shape[1]
        self._own_direction: F64Array = xp.zeros((3, num_robots))
        self._own_view: IntArray = xp.zeros((num_robots, size), dtype=np.int64)  # places in all robots' flat views
        self._own_view_sign: F64Array = xp.zeros((num_robots, size))
        self._own_control: IntArray = xp.zeros((num_robots, num_controls), dtype=np.int64)
        self._own_control_sign: F32Array = xp.zeros((num_robots, num_controls), dtype=np.float32)
        self._robots = xp.arange(num_robots)[:, None]
        self.set(slice(None), xp.zeros(num_robots, dtype=np.int64))

    def choose(self, robots: slice | IntArray, vector: F64Array) -> None:
        """Choose the frames of `robots` for goals at `vector` [robots, 2] (ahead, left) in the robots' own frames."""
        self.set(robots, self._group.choose(vector[:, 0], vector[:, 1]))

    def set(self, robots: slice | IntArray, element: IntArray) -> None:
        """Set the frames of `robots` to these elements of the group [robots]."""
        number = self._robots[robots]
        self._own_direction[:, robots] = self._direction[:, element]
        self._own_view[robots] = self._view_index[element] + number * self._view_index.shape[1]
        self._own_view_sign[robots] = self._view_sign[element]
        self._own_control[robots] = self._control_index[element] + number * self._control_index.shape[1]
        self._own_control_sign[robots] = self._control_sign[element]

    def turned(self, vector: F64Array) -> F64Array:
        """Return vectors [N, 2], given in the robots' own frames, in these frames."""
        cosine, sine, mirror = self._own_direction
        x, y = vector[:, 0], vector[:, 1]
        return np.stack([cosine * x + sine * y, mirror * (cosine * y - sine * x)], axis=1)

    def view(self, values: F64Array, out: F64Array) -> None:
        """Write egocentric views [N, V], given in the robots' own frames, into `out` [N, V] in these frames."""
        np.multiply(values.ravel()[self._own_view], self._own_view_sign, out=out)

    def controls(self, control: F32Array) -> F32Array:
        """Return controls [N, A], given in these frames, in the robots' own frames."""
        return control.ravel()[self._own_control] * self._own_control_sign


def turned_back(vector: F64Array, angle: F64Array) -> F64Array:
    """Return `vector` [N, 2] rotated by minus `angle` [N]: from the world frame to the frame of a heading."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vector[:, 0], vector[:, 1]
    return np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=1)
