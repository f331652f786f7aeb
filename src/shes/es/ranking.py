"""Centred ranks: the shaping of fitness that the paper uses; `shaping` has the others.

Source: Salimans et al. 2017 (centred ranks); SHES paper II-A ("ranked and shaped as in S-ES").
"""

from __future__ import annotations

import numpy as np

from shes.errors import PolicyError, UnknownNameError
from shes.types import F64Array

__all__ = ["TIES", "centred_ranks", "check_finite"]

TIES = ("average", "index")
"""How equal fitnesses are ranked: by their average rank, or by their place in the population."""


def check_finite(fitness: F64Array) -> None:
    """Refuse a fitness [n] that is not a number or infinite.

    Raises:
        PolicyError: A fitness is not finite; the message names the first such member.
    """
    if not np.isfinite(fitness).all():
        member = int(np.flatnonzero(~np.isfinite(fitness))[0])
        raise PolicyError(
            f"the fitness of member {member} is {fitness[member]}; every fitness must be finite. "
            "Look at the reward that it comes from."
        )


def centred_ranks(fitness: F64Array, ties: str = "average") -> F64Array:
    """Return ranks [n] of `fitness` [n] scaled to [-0.5, 0.5]; they sum to zero.

    Deviation: equal fitnesses share their average rank by default, so that no level drifts by storage order (the
    authors' code, like `ties="index"`, breaks ties by place). On a sparse reward most fitnesses are equal.

    Raises:
        PolicyError: A fitness is not finite.
        UnknownNameError: `ties` is not one of `TIES`.
    """
    check_finite(fitness)
    if ties not in TIES:
        raise UnknownNameError("way to rank ties", ties, TIES, "Set --rank-ties.")
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
