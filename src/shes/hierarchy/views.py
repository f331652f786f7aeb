"""Views: the part of an environment's observation that a level sees.

Source: SHES paper II-D (a transferred primitive sees the robot's own coordinates); `docs/learning.md` (egocentric
views).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import numpy as np

from shes.envs.bodies.body import Body
from shes.types import F64Array, IntArray

PATROL_RADIUS_M = 4.0
"""Radius of the walk of `PatrolView`. Sensors that reach 8 m then cover all of Gather's food but the far corners."""


class View(ABC):
    """Selects or computes the values that a level sees. It is sent to worker processes."""

    is_egocentric: bool = False
    """Whether the values, and the goals beside them, are expressed in the robot's own frame."""
    turns_outputs: bool = False
    """Whether a controller's outputs that are relative to the heading are relative to the view's frame instead."""

    @abstractmethod
    def size(self, observation_size: int) -> int:
        """Return the number of values seen of an observation of `observation_size` values."""

    @abstractmethod
    def write(self, observation: F64Array, heading: F64Array, out: F64Array) -> F64Array:
        """Write the view of `observation` [N, O] into `out` [N, V], and return the angle of its frame [N] in radians.

        `heading` [N] is that of the robots; a view without a frame of its own returns it.
        """

    @abstractmethod
    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the values, given the names of the observed values."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return the view as JSON types, for an exported agent."""

    def on(self, xp: ModuleType) -> View:
        """Return this view for arrays of `xp`."""
        return self


class ColumnsView(View):
    """Some or all of the observed values, in any order."""

    def __init__(self, indices: Sequence[int] | None = None, xp: ModuleType = np) -> None:
        """Select the values at `indices`, or all values if None."""
        self.indices = None if indices is None else tuple(int(index) for index in indices)
        self._columns = slice(None) if self.indices is None else _columns(self.indices, xp)

    def size(self, observation_size: int) -> int:
        """Return the number of selected values."""
        return observation_size if self.indices is None else len(self.indices)

    def write(self, observation: F64Array, heading: F64Array, out: F64Array) -> F64Array:
        """Copy the values; see `View.write`."""
        out[:] = observation[:, self._columns]
        return heading

    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the selected values."""
        return tuple(observation_names[i] for i in self.indices or range(len(observation_names)))

    def to_dict(self) -> dict[str, Any]:
        """Return the indices; None stands for all values."""
        return {"kind": "columns", "columns": None if self.indices is None else list(self.indices)}

    def on(self, xp: ModuleType) -> ColumnsView:
        """Return this view for arrays of `xp`."""
        return ColumnsView(self.indices, xp)


class EgocentricView(View):
    """The robot's state in its own frame, without its position, followed by other observed values.

    Deviation: the paper's policies see the torso's quaternion, and velocities in the world frame, so that a network has
    to learn the rotation before it can learn to walk.
    """

    is_egocentric = True

    def __init__(
        self, body: Body, proprioception: Sequence[int], others: Sequence[int] = (), xp: ModuleType = np
    ) -> None:
        """See the state of `body`, whose qpos and qvel are at `proprioception`, then the values at `others`."""
        self.body = body
        self._places = tuple(int(index) for index in proprioception), tuple(int(index) for index in others)
        robot = self._places[0]
        self._qpos, self._qvel, self._others = (
            _columns(indices, xp) for indices in (robot[: body.num_qpos], robot[body.num_qpos :], self._places[1])
        )
        self._own = len(body.egocentric)

    def size(self, observation_size: int) -> int:
        """Return the number of the robot's own values and of the others."""
        return self._own + len(self._places[1])

    def write(self, observation: F64Array, heading: F64Array, out: F64Array) -> F64Array:
        """Compute the robot's own values and copy the others; return the angle of its own frame. See `View.write`."""
        qpos = observation[:, self._qpos]
        angle = self.body.frame_angle(qpos)
        self.body.write_egocentric(qpos, observation[:, self._qvel], angle, out[:, : self._own])
        if self._places[1]:
            out[:, self._own :] = observation[:, self._others]
        return angle

    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the robot's own values, then of the others."""
        own = (f"egocentric {element.name}" for element in self.body.egocentric)
        return (*own, *(observation_names[i] for i in self._places[1]))

    def to_dict(self) -> dict[str, Any]:
        """Return the name of the body, and the indices of its qpos and qvel and of the other values."""
        robot, others = self._places
        qpos, qvel = robot[: self.body.num_qpos], robot[self.body.num_qpos :]
        return {
            "kind": "egocentric",
            "body": self.body.name,
            "qpos": list(qpos),
            "qvel": list(qvel),
            "columns": list(others),
        }

    def on(self, xp: ModuleType) -> EgocentricView:
        """Return this view for arrays of `xp`."""
        return EgocentricView(self.body, *self._places, xp)


class NearestView(View):
    """Sensors around the robot in a frame that is turned towards the nearest thing that they sense, and other values.

    The frame is turned by whole sectors, and the readings are rotated with it: the strongest reading of the first ring
    is always that of sector 0, the others follow counter-clockwise. Without any reading the frame is that of the sector
    to the left of straight ahead. What a controller learns for one direction it has thereby learned for all.

    The robot's own state is not among the values: it has no part in where to go, and each input of a controller adds
    the noise of its weights.

    Source: `docs/learning.md`, "A controller's frame".
    """

    turns_outputs = True

    def __init__(self, rings: Sequence[Sequence[int]], others: Sequence[int] = (), xp: ModuleType = np) -> None:
        """See the sensors at `rings` [ring, sector], then the values at `others`."""
        self._places = tuple(tuple(ring) for ring in rings), tuple(others)
        self._rings = xp.asarray(np.array(rings, dtype=np.int64))
        self._others = _columns(self._places[1], xp)
        self._sectors = xp.arange(self._rings.shape[1])

    def size(self, observation_size: int) -> int:
        """Return the number of sensors and of the other values."""
        return self._rings.size + len(self._places[1])

    def write(self, observation: F64Array, heading: F64Array, out: F64Array) -> F64Array:
        """Rotate the readings and copy the other values; return the bearing of the nearest sector's middle."""
        first = observation[:, self._rings[0]]
        nearest = np.where(first.max(axis=1) > 0, first.argmax(axis=1), len(self._sectors) // 2)
        self._write_from(nearest, observation, out)
        return self._bearing(nearest, heading)

    def _write_from(self, sector: IntArray, observation: F64Array, out: F64Array) -> None:
        """Write the readings, rotated so that `sector` [N] is the first, and the other values."""
        turned = (sector[:, None] + self._sectors) % len(self._sectors)  # [N, sector]
        columns = self._rings[:, turned].swapaxes(0, 1).reshape(len(out), -1)  # [N, ring * sector]
        out[:, : self._rings.size] = np.take_along_axis(observation, columns, axis=1)
        out[:, self._rings.size :] = observation[:, self._others]

    def _bearing(self, sector: IntArray, heading: F64Array) -> F64Array:
        """Return the bearing of the middle of `sector` [N] in the world [N] in radians."""
        return heading + ((sector + 0.5) * (2 * np.pi / len(self._sectors)) - np.pi)

    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the sensors, by sectors from the nearest, and of the other values."""
        rings, others = self._places
        turned = (f"{observation_names[ring[0]]} + {i} from nearest" for ring in rings for i in range(len(ring)))
        return (*turned, *(observation_names[i] for i in others))

    def to_dict(self) -> dict[str, Any]:
        """Return the indices of the sensors and of the other values."""
        rings, others = self._places
        return {"kind": "nearest", "rings": [list(ring) for ring in rings], "columns": list(others)}

    def on(self, xp: ModuleType) -> NearestView:
        """Return this view for arrays of `xp`."""
        return NearestView(*self._places, xp)


class PatrolView(NearestView):
    """As `NearestView`, but while nothing is in range the frame is aligned with a walk around the origin.

    The walk is a circle of radius r = `PATROL_RADIUS_M`, counter-clockwise. The frame points to a place at a distance
    of r sqrt(2) from the origin, an eighth of a turn ahead: along the tangent for a robot on the circle, back to it for
    any other. A controller that goes straight ahead thereby searches the arena without memory.

    Source: `docs/learning.md`, "Searching".
    """

    def __init__(
        self,
        rings: Sequence[Sequence[int]],
        position: Sequence[int],
        others: Sequence[int] = (),
        xp: ModuleType = np,
    ) -> None:
        """See the sensors at `rings` [ring, sector] and the values at `others`; x and y are at `position`."""
        super().__init__(rings, others, xp)
        self._position = int(position[0]), int(position[1])

    def write(self, observation: F64Array, heading: F64Array, out: F64Array) -> F64Array:
        """Rotate the readings and copy the other values; see `View.write`."""
        x, y = (observation[:, column] for column in self._position)
        first, count = observation[:, self._rings[0]], len(self._sectors)
        senses, round_origin = first.max(axis=1) > 0, np.arctan2(y, x) + np.pi / 4
        far = PATROL_RADIUS_M * np.sqrt(2)  # whoever always walks towards a point at this distance stays on the circle
        way = np.arctan2(far * np.sin(round_origin) - y, far * np.cos(round_origin) - x)
        turn = (way - heading) / (2 * np.pi) + 0.5
        facing = np.minimum(((turn - np.floor(turn)) * count).astype(np.intp), count - 1)
        sector = np.where(senses, first.argmax(axis=1), facing)
        self._write_from(sector, observation, out)
        return np.where(senses, self._bearing(sector, heading), way)

    def to_dict(self) -> dict[str, Any]:
        """Return the indices of the sensors, of the position and of the other values, and the radius in metres."""
        return super().to_dict() | {
            "kind": "patrol",
            "position": list(self._position),
            "radius_m": PATROL_RADIUS_M,
        }

    def on(self, xp: ModuleType) -> PatrolView:
        """Return this view for arrays of `xp`."""
        rings, others = self._places
        return PatrolView(rings, self._position, others, xp)


def _columns(indices: tuple[int, ...], xp: ModuleType) -> slice | IntArray:
    """Return the index of columns `indices`. Neighbours become a slice, which is faster."""
    if indices and indices == tuple(range(indices[0], indices[0] + len(indices))):
        return slice(indices[0], indices[0] + len(indices))
    return xp.asarray(np.array(indices, dtype=np.int64))
