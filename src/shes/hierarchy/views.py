"""Views: what a level sees of what its environment shows.

Source: algorithm specification section 6 (a primitive sees the robot's own coordinates); learning specification,
section 1 (the egocentric view).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from types import ModuleType

import numpy as np

from shes.envs.bodies.body import Body
from shes.types import F64Array, IntArray

__all__ = ["ColumnsView", "EgocentricView", "View", "columns"]


class View(ABC):
    """Picks, or works out, what a level sees. Worker processes are sent it."""

    is_egocentric: bool = False
    """Whether what is seen, goals too, is in the robot's own frame."""

    @abstractmethod
    def size(self, observation_size: int) -> int:
        """Return the number of values that are seen of an observation of `observation_size`."""

    def angle(self, observation: F64Array, heading: F64Array) -> F64Array:
        """Return the angle [N] of the frame from which robots of this `heading` [N] see, in radians."""
        del observation
        return heading

    @abstractmethod
    def write(self, observation: F64Array, angle: F64Array, out: F64Array) -> None:
        """Write what is seen of `observation` [N, O], from frames at `angle` [N], into `out` [N, V]."""

    @abstractmethod
    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return what the values that are seen are called, by what those of the observation are called."""

    def on(self, xp: ModuleType) -> View:
        """Return this view for arrays of `xp`."""
        del xp
        return self


class ColumnsView(View):
    """Some of the observation's values, in any order, or all of them."""

    def __init__(self, indices: Sequence[int] | None = None, xp: ModuleType = np) -> None:
        """See the values at `indices`, all if none are given."""
        self.indices = None if indices is None else tuple(int(index) for index in indices)
        picked = columns(self.indices)
        self._columns = picked if isinstance(picked, slice) else xp.asarray(picked)

    def size(self, observation_size: int) -> int:
        """Return how many values are picked."""
        return observation_size if self.indices is None else len(self.indices)

    def write(self, observation: F64Array, angle: F64Array, out: F64Array) -> None:
        """Copy the values; see `View.write`."""
        del angle
        out[:] = observation[:, self._columns]

    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the values that are picked."""
        return tuple(observation_names[i] for i in self.indices or range(len(observation_names)))

    def on(self, xp: ModuleType) -> ColumnsView:
        """Return this view for arrays of `xp`."""
        return ColumnsView(self.indices, xp)


class EgocentricView(View):
    """The robot's state in its own frame, without its place, then other values of the observation.

    Deviation: the paper's policies see the torso's quaternion and velocities along the world's axes, so that a network
    has to learn to rotate before it can learn to walk.
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
            _span(indices, xp) for indices in (robot[: body.num_qpos], robot[body.num_qpos :], self._places[1])
        )
        self._own = len(body.egocentric)

    def size(self, observation_size: int) -> int:
        """Return the number of the robot's own values and of the others."""
        del observation_size
        return self._own + len(self._places[1])

    def angle(self, observation: F64Array, heading: F64Array) -> F64Array:
        """Return the angle of the body's own frame [N]."""
        del heading
        return self.body.frame_angle(observation[:, self._qpos])

    def write(self, observation: F64Array, angle: F64Array, out: F64Array) -> None:
        """Work out the robot's own values and copy the others; see `View.write`."""
        self.body.write_egocentric(observation[:, self._qpos], observation[:, self._qvel], angle, out[:, : self._own])
        if self._places[1]:
            out[:, self._own :] = observation[:, self._others]

    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the robot's own values, then of the others."""
        own = (f"egocentric {element.name}" for element in self.body.egocentric)
        return (*own, *(observation_names[i] for i in self._places[1]))

    def on(self, xp: ModuleType) -> EgocentricView:
        """Return this view for arrays of `xp`."""
        return EgocentricView(self.body, *self._places, xp)


def columns(indices: tuple[int, ...] | None) -> slice | IntArray:
    """Return what picks columns `indices`, all if None: a slice where it can be one, because that is quicker."""
    if indices is None:
        return slice(None)
    return _span(indices, np)


def _span(indices: tuple[int, ...], xp: ModuleType) -> slice | IntArray:
    """Return what picks columns `indices`: a slice where they are neighbours, because that is quicker."""
    if indices and indices == tuple(range(indices[0], indices[0] + len(indices))):
        return slice(indices[0], indices[0] + len(indices))
    return xp.asarray(np.array(indices, dtype=np.int64))
