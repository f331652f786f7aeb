"""Sizes of mujoco-warp's buffers for contacts and constraints.

Both are allocated once: one contact buffer that all simulations share, and a constraint buffer for each simulation.
What does not fit is left out of the physics, so an overflow is an error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from shes.errors import ConfigError

_CONTACTS_PER_TOUCH = {int(mujoco.mjtGeom.mjGEOM_SPHERE): 1, int(mujoco.mjtGeom.mjGEOM_CAPSULE): 2}
"""Contacts of one geom with a plane or box; other shapes have `_CONTACTS_OF_OTHERS`."""
_CONTACTS_OF_OTHERS = 8
_TOUCHES_OF_OTHERS = 3
"""Geoms that another shape touches at once: a block touches the ground and two walls."""


@dataclass(frozen=True)
class BufferSizes:
    """Buffer sizes per simulation."""

    nconmax: int
    """Contacts, or pairs of geoms close enough to be tested, on average over all simulations."""
    njmax: int
    """Constraint rows of each simulation: contacts, joint limits, friction losses, equalities."""


@dataclass(frozen=True)
class BufferPeaks:
    """Largest use of the buffers since the simulator was made."""

    contacts: int
    """Contacts, or pairs of geoms to test, of all simulations together."""
    constraints: int
    """Constraint rows of one simulation."""

    def check(self, sizes: BufferSizes, num_sims: int) -> None:
        """Raise ConfigError if a buffer of `sizes` overflowed, so that contacts or constraints were left out."""
        if self.contacts > sizes.nconmax * num_sims:
            raise ConfigError(
                f"mujoco-warp's contact buffer overflowed: {self.contacts} contacts or close pairs of geoms in "
                f"{num_sims} simulations, room for {sizes.nconmax} each (nconmax), so some were left out. "
                f"Set --nconmax to {math.ceil(1.5 * self.contacts / num_sims)}."
            )
        if self.constraints > sizes.njmax:
            raise ConfigError(
                f"mujoco-warp's constraint buffer overflowed: {self.constraints} rows in one simulation, room for "
                f"{sizes.njmax} (njmax), so some were left out. Set --njmax to {math.ceil(1.5 * self.constraints)}."
            )


def default_sizes(model: mujoco.MjModel) -> BufferSizes:
    """Return sizes for every moving geom touching the ground, and blocks also touching walls.

    The number of contacts is doubled, because a pair of geoms takes a place while it is tested for contact.
    """
    contacts = 0
    for geom in np.flatnonzero(model.body_weldid[model.geom_bodyid] != 0):
        per_touch = _CONTACTS_PER_TOUCH.get(int(model.geom_type[geom]))
        contacts += _CONTACTS_OF_OTHERS * _TOUCHES_OF_OTHERS if per_touch is None else per_touch
    dimensions = int(model.geom_condim.max(initial=1))
    is_pyramid = model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    rows = max(1, 2 * (dimensions - 1)) if is_pyramid else dimensions
    others = int(np.count_nonzero(model.jnt_limited)) + int(np.count_nonzero(model.dof_frictionloss)) + 6 * model.neq
    return BufferSizes(nconmax=max(8, 2 * contacts), njmax=max(8, rows * contacts + others))
