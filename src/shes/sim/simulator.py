"""The Simulator contract: N copies of one MuJoCo model, advanced together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from time import perf_counter
from types import ModuleType
from typing import ClassVar

import mujoco
import numpy as np

from shes.types import BoolArray, F64Array, IntArray, to_host


class Simulator(ABC):
    """N simulations of one model. The arrays are live: a value written to them is the state at the next step."""

    starts_together: ClassVar[bool] = False
    """Whether resetting all simulations at once is faster: a device computes all of them in every step."""
    _physics_s: float = 0.0
    model: mujoco.MjModel
    """The model that every simulation runs."""
    num_sims: int
    """Number of simulations, N."""
    xp: ModuleType
    """Array module of the arrays below: NumPy on the CPU."""
    qpos: F64Array
    """Generalised positions [N, nq]."""
    qvel: F64Array
    """Generalised velocities [N, nv]."""
    ctrl: F64Array
    """Controls [N, nu]."""
    diverged: BoolArray
    """Whether a simulation has diverged since its reset [N]. MuJoCo has then reset it to a finite state."""
    state_parts: Sequence[F64Array]
    """qpos, qvel, the solver's warm start [N, nv] and the time [N, 1]: all that a step depends on but the controls."""

    @property
    def physics_s(self) -> float:
        """Wall-clock seconds spent in steps so far; waits for a device."""
        return self._physics_s

    @abstractmethod
    def reset(self, ids: IntArray) -> None:
        """Reset simulations `ids` to the model's default state, exactly, and clear `diverged`."""

    def states(self, ids: IntArray) -> F64Array:
        """Return copies of `state_parts` of simulations `ids` [ids, S], as a NumPy array; waits for a device.

        After `set_states`, here or in another simulator of the same class and model, a simulation continues
        bit-identically.
        """
        rows = self.xp.asarray(ids)
        return np.asarray(to_host(np.concatenate([part[rows] for part in self.state_parts], axis=1)), dtype=np.float64)

    def set_states(self, ids: IntArray, states: F64Array) -> None:
        """Set the physics states of simulations `ids` to `states` [ids, S], and clear `diverged`."""
        self.reset(ids)
        rows, start = self.xp.asarray(ids), 0
        for part in self.state_parts:
            end = start + part.shape[1]
            part[rows], start = self.xp.asarray(states[:, start:end], dtype=part.dtype), end

    def step(self, ids: IntArray, nstep: int) -> None:
        """Advance simulations `ids` (sorted, unique) by `nstep` physics steps; the others do not move."""
        start = perf_counter()
        self.advance(ids, nstep)
        self._physics_s += perf_counter() - start

    @abstractmethod
    def advance(self, ids: IntArray, nstep: int) -> None:
        """Advance simulations `ids` by `nstep` physics steps; `step` measures the time."""

    def check_buffers(self) -> None:  # noqa: B027 - only a device has fixed buffers
        """Raise a ConfigError if a buffer has overflowed since the start; called once a generation."""
