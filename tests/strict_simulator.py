"""A simulator whose arrays lie on the stand-in for a device, `strict_arrays`."""

import numpy as np

from shes.sim.simulator import CpuSimulator, Simulator
from tests.strict_arrays import DeviceArray, strict_xp

__all__ = ["DeviceSimulator"]


class DeviceSimulator(Simulator):
    """MuJoCo on the CPU, seen through arrays of the device."""

    starts_together = True

    def __init__(self, model, num_sims):
        self._cpu = CpuSimulator(model, num_sims)
        self.model, self.num_sims, self.xp = model, num_sims, strict_xp
        self.qpos, self.qvel, self.ctrl, self.diverged = (
            DeviceArray(getattr(self._cpu, name)) for name in ("qpos", "qvel", "ctrl", "diverged")
        )

    def reset(self, ids):
        assert isinstance(ids, np.ndarray)
        self._cpu.reset(ids)

    def states(self, ids):
        assert isinstance(ids, np.ndarray)
        return self._cpu.states(ids)

    def set_states(self, ids, states):
        assert isinstance(ids, np.ndarray)
        assert isinstance(states, np.ndarray)
        self._cpu.set_states(ids, states)

    def step(self, ids, nstep):
        assert isinstance(ids, np.ndarray)
        self._cpu.step(ids, nstep)
