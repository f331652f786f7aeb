"""Measures the GPU memory of a simulation, most of which is mujoco-warp's workspace.

With the default buffers, mujoco-warp allocates on the CPU 1.6 MB for an ant with a block (box against box), 70 kB for
an ant, and 7 kB for a point.
"""

from __future__ import annotations

import mujoco
import numpy as np

from shes.sim.warp import WarpSimulator
from shes.sim.warp_device import WarpDevice, is_out_of_memory

_MEASURED = (16, 64, 512)
"""Numbers of simulations: a few to load the kernels, then enough to average over the pool's large blocks."""


def bytes_per_sim(
    model: mujoco.MjModel, device: str, nstep: int, nconmax: int | None = None, njmax: int | None = None
) -> float:
    """Return the memory of a simulation of `model` on `device`, in bytes; 0 on the CPU.

    The graph of a control step of `nstep` physics steps takes memory, too. For `nconmax` and `njmax` see
    `WarpSimulator`.
    """
    memory, used = WarpDevice(device), 0.0
    for num_sims in _MEASURED:
        before = memory.free_bytes()
        if before is None:
            return 0.0
        try:
            simulator = WarpSimulator(model, num_sims, device, nconmax, njmax)
            simulator.step(np.arange(num_sims), nstep)
        except (MemoryError, RuntimeError) as error:
            if not used or not is_out_of_memory(error):
                raise
            break  # keep the result of fewer simulations
        used = max(0, before - (memory.free_bytes() or 0)) / num_sims
        del simulator
    return used
