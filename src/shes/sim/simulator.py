"""The Simulator contract: N copies of one MuJoCo model, advanced together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from time import perf_counter
from types import ModuleType
from typing import ClassVar

import mujoco

from shes.errors import ConfigError
from shes.types import BoolArray, F64Array, IntArray

_NO_STATES = (
    "{} cannot copy physics states, which branched episodes start from. Define `states` and `set_states` in it, "
    "or set --primitive-estimate episode."
)


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

    @property
    def physics_s(self) -> float:
        """Wall-clock seconds spent in steps so far; waits for a device."""
        return self._physics_s

    @abstractmethod
    def reset(self, ids: IntArray) -> None:
        """Reset simulations `ids` to the model's default state, exactly, and clear `diverged`."""

    def states(self, ids: IntArray) -> F64Array:
        """Return copies of the physics states of simulations `ids` [ids, S], as a NumPy array.

        A state is qpos, qvel, the solver's warm start and the time: everything but the controls that the next step
        depends on. After `set_states`, here or in another simulator of the same class and model, a simulation
        continues bit-identically.
        """
        raise ConfigError(_NO_STATES.format(type(self).__name__))

    def set_states(self, ids: IntArray, states: F64Array) -> None:
        """Set the physics states of simulations `ids` to `states` [ids, S], and clear `diverged`."""
        raise ConfigError(_NO_STATES.format(type(self).__name__))

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
