"""How much room mujoco-warp gets for contacts and constraints.

It allocates both once, for all simulations: contacts in one array that they share, constraint rows for each its own.
What does not fit is left out of the physics, so a buffer that overflows is an error, not a warning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from shes.errors import ConfigError

__all__ = ["BufferPeaks", "BufferSizes", "default_sizes"]

_CONTACTS_PER_TOUCH = {int(mujoco.mjtGeom.mjGEOM_SPHERE): 1, int(mujoco.mjtGeom.mjGEOM_CAPSULE): 2}
"""Contacts of one geom with one plane or box; `_CONTACTS_OF_OTHERS` for every other shape."""
_CONTACTS_OF_OTHERS = 8
_TOUCHES_OF_OTHERS = 3
"""A block stands on the ground and between walls."""


@dataclass(frozen=True)
class BufferSizes:
    """Room for one simulation."""

    nconmax: int
    """Contacts on average over all simulations, and pairs of geoms close enough to be examined."""
    njmax: int
    """Constraint rows at most: contacts, joint limits, friction losses, equalities."""


@dataclass(frozen=True)
class BufferPeaks:
    """What was needed at most since the simulator was made."""

    contacts: int
    """Contacts, or pairs of geoms to examine, of all simulations together."""
    constraints: int
    """Constraint rows of one simulation."""

    def check(self, sizes: BufferSizes, num_sims: int) -> None:
        """Refuse peaks that did not fit.

        Raises:
            ConfigError: A buffer overflowed: contacts were left out, so the results are wrong.
        """
        if self.contacts > sizes.nconmax * num_sims:
            raise ConfigError(
                f"mujoco-warp's contact buffer overflowed: {self.contacts} contacts or close pairs of geoms in "
                f"{num_sims} simulations, room for {sizes.nconmax} each (nconmax). The physics left some out. "
                f"Set --nconmax to {math.ceil(1.5 * self.contacts / num_sims)}."
            )
        if self.constraints > sizes.njmax:
            raise ConfigError(
                f"mujoco-warp's constraint buffer overflowed: {self.constraints} rows in one simulation, room for "
                f"{sizes.njmax} (njmax). The physics left some out. Set --njmax to {math.ceil(1.5 * self.constraints)}."
            )


def default_sizes(model: mujoco.MjModel) -> BufferSizes:
    """Return room for every moving geom flat on the ground, blocks between walls too, and twice the contacts of that.

    The factor two is for pairs of geoms: a pair takes a place while it is examined, contact or not, as beside a wall.
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
