"""The Simulator contract: N copies of one MuJoCo model, advanced together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from time import perf_counter
from types import ModuleType
from typing import ClassVar

import mujoco

from shes.errors import ConfigError
from shes.types import BoolArray, F64Array, IntArray

__all__ = ["Simulator"]

_NO_STATES = (
    "{} does not copy whole states, from which branches begin. Define `states` and `set_states` in it, "
    "or set --primitive-estimate episode."
)


class Simulator(ABC):
    """N simulations of one model. The arrays are live: what is written is the state at the next step."""

    starts_together: ClassVar[bool] = False
    """Whether simulations had best be reset all together: on a device all are computed, whoever runs."""
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
    """Whether a simulation has blown up since its reset [N]. Its state is then MuJoCo's own reset state: finite."""

    @property
    def physics_s(self) -> float:
        """Seconds that steps have taken so far; a device is waited for."""
        return self._physics_s

    @abstractmethod
    def reset(self, ids: IntArray) -> None:
        """Put simulations `ids` into the model's default state, exactly, and forget that they diverged."""

    @property
    def state_size(self) -> int:
        """Numbers of a whole state, S."""
        return self.model.nq + 2 * self.model.nv + 1

    def states(self, ids: IntArray) -> F64Array:
        """Return copies of the whole states of simulations `ids` [ids, S], in NumPy's array.

        A state is qpos, qvel, the solver's warm start and the time, in every simulator.
        A whole state is all that the next step depends on, the solver's warm start included: a simulation that is put
        into it by `set_states`, here or in another simulator of the same kind and model, goes on with the same bits.

        Raises:
            ConfigError: This kind of simulator cannot tell them.
        """
        del ids
        raise ConfigError(_NO_STATES.format(type(self).__name__))

    def set_states(self, ids: IntArray, states: F64Array) -> None:
        """Put simulations `ids` into `states` [ids, S], and forget that they diverged.

        Raises:
            ConfigError: This kind of simulator cannot do so.
        """
        del ids, states
        raise ConfigError(_NO_STATES.format(type(self).__name__))

    def step(self, ids: IntArray, nstep: int) -> None:
        """Advance simulations `ids` (sorted, unique) by `nstep` physics steps; the others do not move."""
        start = perf_counter()
        self.advance(ids, nstep)
        self._physics_s += perf_counter() - start

    @abstractmethod
    def advance(self, ids: IntArray, nstep: int) -> None:
        """Do what `step` says."""

    def check_buffers(self) -> None:  # noqa: B027 - only a device has fixed buffers
        """Refuse physics for which there was too little room since the start; ask once a generation.

        Raises:
            ConfigError: Contacts or constraints were left out.
        """
