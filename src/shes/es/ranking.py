"""Centred ranks, the paper's fitness shaping. Other shapings are in `shaping`.

Source: Salimans et al. 2017, section 2.1; SHES paper II-A ("ranked and shaped as in S-ES").
"""

from __future__ import annotations

import numpy as np

from shes.errors import PolicyError
from shes.types import F64Array

TIES = ("average", "index")
"""How equal fitness is ranked: by the average rank, or by position in the population."""


def check_finite(fitness: F64Array) -> None:
    """Raise PolicyError, which names the first such member, if a fitness [n] is NaN or infinite."""
    if not np.isfinite(fitness).all():
        member = int(np.flatnonzero(~np.isfinite(fitness))[0])
        raise PolicyError(
            f"the fitness of member {member} is {fitness[member]}, but every fitness must be finite. "
            "Check the reward that it comes from."
        )


def centred_ranks(fitness: F64Array, ties: str = "average") -> F64Array:
    """Return the ranks [n] of finite `fitness` [n] scaled to [-0.5, 0.5]. They sum to zero.

    Deviation: equal fitness values share their average rank by default, so that the order of storage causes no
    drift when most fitness values are equal, as with sparse rewards. The authors' code breaks ties by index.
    """
    check_finite(fitness)
    count = len(fitness)
    if count == 1:
        return np.zeros(1)
    order = np.argsort(fitness, kind="stable")
    ranks = np.empty(count)
    ranks[order] = np.arange(count)
    if ties == "average":
        _, first, inverse, repeats = np.unique(
            fitness[order], return_index=True, return_inverse=True, return_counts=True
        )
        ranks[order] = (first + (repeats - 1) / 2)[inverse]
    return ranks / (count - 1) - 0.5
