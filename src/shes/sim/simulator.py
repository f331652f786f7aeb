"""The Simulator contract: N copies of one MuJoCo model, advanced together; and MuJoCo on the CPU by `mujoco.batch`."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Sequence
from time import perf_counter
from types import ModuleType
from typing import ClassVar

import mujoco
import numpy as np
from mujoco.batch import Batch

from shes.types import BoolArray, F64Array, IntArray, to_host

logger = logging.getLogger("shes.mujoco")
logger.addHandler(logging.NullHandler())  # without it Python prints to stderr if logging is not configured

DIVERGENCE = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADCTRL) + 1)
"""Numbers of the warnings after which MuJoCo resets a simulation within a step, in `MjData.warning.number`."""


class Simulator(ABC):
    """N simulations of one model. The arrays are live: a value written to them is the state at the next step."""

    starts_together: ClassVar[bool] = False
    """Whether resetting all simulations at once is faster: a device computes all of them in every step."""
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
    """qpos, qvel, the solver's warm start [N, nv], the time [N, 1] and, if the model has them, activations, delayed
    controls and plasticity: all that a step depends on but the controls."""
    physics_s: float = 0.0
    """Wall-clock seconds spent in steps so far; waits for a device."""

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

    @abstractmethod
    def step(self, ids: IntArray, nstep: int) -> None:
        """Advance simulations `ids` (sorted, unique) by `nstep` physics steps; the others do not move."""

    def check_buffers(self) -> None:  # noqa: B027 - only a device has fixed buffers
        """Raise a ConfigError if a buffer has overflowed since the start; called once a generation."""


def log_physics_warnings() -> None:
    """Send MuJoCo's warnings to the logger `shes.mujoco`, instead of stderr and a file in the working directory.

    A handler that is already installed is kept.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(logger.warning)


class CpuSimulator(Simulator):
    """N simulations, stepped by one or several threads, bit-identical to a loop over `mj_step`."""

    def __init__(self, model: mujoco.MjModel, num_sims: int, num_threads: int = 1) -> None:
        """Make `num_sims` simulations of `model` in its default state; results do not depend on `num_threads`."""
        log_physics_warnings()
        self.model = model
        self.num_sims = num_sims
        self.xp = np
        self._batch = Batch(model, num_sims, nthread=num_threads)
        self._batch.reset()
        self.qpos, self.qvel, self.ctrl = map(self._batch.bind, ("qpos", "qvel", "ctrl"))
        self._default = self._batch.state[0].copy()
        warmstart, time = self._batch.bind("qacc_warmstart"), self._batch.bind("time")
        others = (self._batch.bind(name).reshape(num_sims, -1) for name in ("act", "history", "plastic"))
        self.state_parts = (self.qpos, self.qvel, warmstart, time.reshape(num_sims, 1), *filter(np.size, others))
        self._counters = self._batch.warning[:, DIVERGENCE, 1]  # [N, kinds]
        self.diverged = np.zeros(num_sims, dtype=np.bool_)

    def reset(self, ids: IntArray) -> None:
        """Reset simulations `ids` to the model's default state, the solver's warm start included."""
        self._batch.state[ids] = self._default
        self._batch.warning[ids] = 0  # a reset within a step clears them first, so a divergence reads 1
        self.diverged[ids] = False

    def step(self, ids: IntArray, nstep: int) -> None:
        """Advance simulations `ids` (sorted, unique) by `nstep` calls to `mj_step`."""
        start = perf_counter()
        self._batch.step(None if len(ids) == self.num_sims else ids, nstep=nstep)  # None is all: no ids to check
        if self._counters.any():
            np.any(self._counters, axis=1, out=self.diverged)
        self.physics_s += perf_counter() - start
