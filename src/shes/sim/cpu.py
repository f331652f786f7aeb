"""MuJoCo on the CPU: N simulations by `mujoco.batch`, equal to the bit to a loop over `mj_step`."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
from mujoco.batch import Batch

from shes.sim.simulator import Simulator
from shes.types import F64Array, IntArray

__all__ = ["CpuSimulator", "count_divergences", "forget_divergences", "log_physics_warnings"]

logger = logging.getLogger("shes.mujoco")
logger.addHandler(logging.NullHandler())  # else Python prints to stderr where a program configured no logging

_DIVERGENCE = [
    int(warning)
    for warning in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
        mujoco.mjtWarning.mjWARN_BADCTRL,
    )
]


def log_physics_warnings() -> None:
    """Send MuJoCo's warnings to the logger `shes.mujoco`, not to stderr and a file in the working directory.

    An installed handler is left alone: it is the caller's.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(logger.warning)


def count_divergences(data: mujoco.MjData) -> int:
    """Return how often a simulation that somebody else steps has blown up, as far as its counters remember."""
    return int(data.warning.number[_DIVERGENCE].sum())


def forget_divergences(data: mujoco.MjData) -> None:
    """Let `count_divergences` begin anew; `mj_resetData` does so by itself."""
    data.warning.number[_DIVERGENCE] = 0


class CpuSimulator(Simulator):
    """N simulations stepped by the calling thread, or by several."""

    def __init__(self, model: mujoco.MjModel, num_sims: int, num_threads: int = 1) -> None:
        """Make `num_sims` simulations of `model`, all in its default state; `num_threads` never changes a bit."""
        log_physics_warnings()
        self.model = model
        self.num_sims = num_sims
        self.xp = np
        self._batch = Batch(model, num_sims, nthread=num_threads)
        self._batch.reset()
        self.qpos = self._batch.bind("qpos")
        self.qvel = self._batch.bind("qvel")
        self.ctrl = self._batch.bind("ctrl")
        self._default = self._batch.state[0].copy()
        self._warmstart, self._time = self._batch.bind("qacc_warmstart"), self._batch.bind("time")
        # All that a step depends on beside the controls, which are written before it; no world of ours has more.
        self._parts = (self.qpos, self.qvel, self._warmstart, self._time.reshape(num_sims, 1))
        # Counters [N, kinds] of the warnings after which MuJoCo resets a simulation by itself, inside the step.
        first, last = min(_DIVERGENCE), max(_DIVERGENCE)
        self._counters = self._batch.warning[:, first : last + 1, 1]
        assert sorted(_DIVERGENCE) == list(range(first, last + 1)), "MuJoCo renumbered its warnings"
        self.diverged = np.zeros(num_sims, dtype=np.bool_)

    def reset(self, ids: IntArray) -> None:
        """Put simulations `ids` into the model's default state; the solver's warm start is part of it."""
        self._batch.state[ids] = self._default
        self._batch.warning[ids] = 0  # MuJoCo counts from 0 again when it resets by itself: every divergence reads 1
        self.diverged[ids] = False

    def states(self, ids: IntArray) -> F64Array:
        """Return copies of the whole states of simulations `ids` [ids, S]."""
        return np.concatenate([part[ids] for part in self._parts], axis=1)

    def set_states(self, ids: IntArray, states: F64Array) -> None:
        """Put simulations `ids` into `states` [ids, S]."""
        self.reset(ids)
        start = 0
        for part in self._parts:
            part[ids] = states[:, start : start + part.shape[1]]
            start += part.shape[1]

    def advance(self, ids: IntArray, nstep: int) -> None:
        """Advance simulations `ids` (sorted, unique) by `nstep` calls to `mj_step`."""
        everybody = len(ids) == self.num_sims  # named none, MuJoCo need not check them
        self._batch.step(None if everybody else ids, nstep=nstep)
        if self._counters.any():
            np.any(self._counters, axis=1, out=self.diverged)
