"""Fitness shaping: how the fitness of a population becomes the weights of its members in the update.

The shaped fitness [n] of a population sums to zero, so a constant added to every fitness has no effect. To add a
shaping, write a class and a line in `FITNESS_SHAPINGS`. A class that is also a `Settings` dataclass has its fields as
flags of `shes train`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from shes.errors import ConfigError
from shes.options import subclass_of
from shes.registry import Registry
from shes.types import F64Array, IntArray


class FitnessShaping(ABC):
    """Turns the fitness of a population into the members' weights."""

    @abstractmethod
    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the shaped fitness [n] of finite `fitness` [n]: a new array that sums to zero, all zeros for n = 1."""


class CentredRanks(FitnessShaping):
    """Ranks from -0.5 (worst) to 0.5 (best); equal values share their mean rank.

    Source: Salimans et al. 2017, section 2.1; SHES paper II-A ("ranked and shaped as in S-ES").
    Deviation: the authors' code breaks ties by index. With most fitness values equal, as with sparse rewards, the order
    of storage then causes drift.
    """

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the centred ranks [n]."""
        return _centred(_mean_ranks(fitness) - 1)


class IndexedRanks(FitnessShaping):
    """Centred ranks with ties broken by index. A level whose members all tie is updated too: its parameters decay.

    Source: the authors' code.
    """

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the centred ranks [n]."""
        return _centred(np.argsort(np.argsort(fitness, kind="stable")))


class PairRanks(FitnessShaping):
    """Signed ranks of the differences within mirrored pairs.

    Members 2 g and 2 g + 1 are a pair with the difference d. A pair of G has the weight `sign(d) rank(|d|) / G`; equal
    differences share their mean rank, and a difference of zero has the weight zero. The effects of the start and the
    goals, which both members share, cancel.

    Source: Wilcoxon 1945 (signed ranks); `docs/learning.md`.
    """

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return plus and minus half of the pair's weight for the members of each pair [n], an even number."""
        if len(fitness) % 2:
            raise ConfigError(f"pair_rank needs pairs, but there are {len(fitness)} members. Set --mirrored pair.")
        difference = fitness[0::2] - fitness[1::2]
        half = np.sign(difference) * _mean_ranks(np.abs(difference)) / (2 * len(difference))
        return np.stack([half, -half], axis=1).ravel()


def _mean_ranks(values: F64Array) -> F64Array:
    """Return the ranks [n] of `values` from 1; equal ones share their mean rank."""
    _, place, count = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(count) - (count - 1) / 2)[place]


def _centred(ranks: F64Array | IntArray) -> F64Array:
    """Return `ranks` from 0 to n - 1 [n] on a scale from -0.5 to 0.5."""
    return ranks / (len(ranks) - 1) - 0.5 if len(ranks) > 1 else np.zeros(1)


FITNESS_SHAPINGS: Registry[type[FitnessShaping]] = Registry(
    "fitness shaping",
    {"centred_rank": CentredRanks, "centred_rank_index": IndexedRanks, "pair_rank": PairRanks},
    fix="Set --fitness-shaping.",
    check=subclass_of(FitnessShaping),
)
"""Fitness shapings by name: the choices of `--fitness-shaping`."""
