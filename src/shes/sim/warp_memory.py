"""How much of a card's memory a simulation takes: measured, because most of it is mujoco-warp's workspace.

As mujoco-warp allocates on the CPU, with the default buffers: 1.6 MB for an ant with a block (box against box), 70 kB
for an ant, 7 kB for a point.
"""

from __future__ import annotations

import mujoco
import numpy as np

from shes.sim.warp import WarpSimulator
from shes.sim.warp_device import WarpDevice, is_out_of_memory

__all__ = ["bytes_per_sim"]

_MEASURED = (16, 64, 512)
"""Simulations: a few, with which the kernels come into memory, then enough to see through the pool's large pieces."""


def bytes_per_sim(
    model: mujoco.MjModel, device: str, nstep: int, nconmax: int | None = None, njmax: int | None = None
) -> float:
    """Return what a simulation of `model` takes on `device`, in bytes; 0 where memory has no limit.

    Args:
        model: The model.
        device: `warp-cpu` or `cuda`.
        nstep: Physics steps in a control step: their graph has memory, too.
        nconmax: As for `WarpSimulator`.
        njmax: As for `WarpSimulator`.
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
            break  # what fewer of them took is the best there is
        used = max(0, before - (memory.free_bytes() or 0)) / num_sims
        del simulator
    return used
