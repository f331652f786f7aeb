"""MuJoCo on the CPU: N simulations by `mujoco.batch`, bit-identical to a loop over `mj_step`."""

from __future__ import annotations

import logging

import mujoco
import numpy as np
from mujoco.batch import Batch

from shes.sim.simulator import Simulator
from shes.types import IntArray

logger = logging.getLogger("shes.mujoco")
logger.addHandler(logging.NullHandler())  # without it Python prints to stderr if logging is not configured

_DIVERGENCE = slice(int(mujoco.mjtWarning.mjWARN_BADQPOS), int(mujoco.mjtWarning.mjWARN_BADCTRL) + 1)
"""Numbers of the warnings after which MuJoCo resets a simulation within a step."""


def log_physics_warnings() -> None:
    """Send MuJoCo's warnings to the logger `shes.mujoco`, instead of stderr and a file in the working directory.

    A handler that is already installed is kept.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(logger.warning)


def count_divergences(data: mujoco.MjData) -> int:
    """Return how often a simulation has diverged since its warning counters were reset."""
    return int(data.warning.number[_DIVERGENCE].sum())


def forget_divergences(data: mujoco.MjData) -> None:
    """Reset the counters that `count_divergences` reads, as `mj_resetData` does."""
    data.warning.number[_DIVERGENCE] = 0


class CpuSimulator(Simulator):
    """N simulations, stepped by one or several threads."""

    def __init__(self, model: mujoco.MjModel, num_sims: int, num_threads: int = 1) -> None:
        """Make `num_sims` simulations of `model` in its default state; results do not depend on `num_threads`."""
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
        warmstart, time = self._batch.bind("qacc_warmstart"), self._batch.bind("time")
        self.state_parts = (self.qpos, self.qvel, warmstart, time.reshape(num_sims, 1))
        self._counters = self._batch.warning[:, _DIVERGENCE, 1]  # [N, kinds]
        self.diverged = np.zeros(num_sims, dtype=np.bool_)

    def reset(self, ids: IntArray) -> None:
        """Reset simulations `ids` to the model's default state, the solver's warm start included."""
        self._batch.state[ids] = self._default
        self._batch.warning[ids] = 0  # a reset within a step clears them first, so a divergence reads 1
        self.diverged[ids] = False

    def advance(self, ids: IntArray, nstep: int) -> None:
        """Advance simulations `ids` (sorted, unique) by `nstep` calls to `mj_step`."""
        self._batch.step(None if len(ids) == self.num_sims else ids, nstep=nstep)  # None is all: no ids to check
        if self._counters.any():
            np.any(self._counters, axis=1, out=self.diverged)
