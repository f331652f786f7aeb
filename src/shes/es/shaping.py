"""Fitness shaping: how the fitness of a population becomes the weights of its members in the update.

The shaped fitness [n] of a population sums to zero, so a constant added to every fitness has no effect. To add a
shaping, write a class and a line in `FITNESS_SHAPINGS`. A class that is also a `Settings` dataclass has its fields as
flags of `shes train`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np

from shes.errors import ConfigError, PolicyError
from shes.options import subclass_of
from shes.registry import Registry
from shes.settings import Settings
from shes.types import F64Array


class FitnessShaping(ABC):
    """Turns the fitness of a population into the members' weights."""

    @abstractmethod
    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the shaped fitness [n] of `fitness` [n]: a new array that sums to zero, all zeros for n = 1.

        Raise PolicyError unless every fitness is finite.
        """


@dataclass(frozen=True, kw_only=True)
class CentredRanks(FitnessShaping, Settings):
    """Ranks from -0.5 (worst) to 0.5 (best).

    Source: Salimans et al. 2017, section 2.1; SHES paper II-A ("ranked and shaped as in S-ES").
    Deviation: equal fitness values share their average rank by default, so that the order of storage causes no drift
    when most fitness values are equal, as with sparse rewards. The authors' code breaks ties by index.
    """

    rank_ties: Literal["average", "index"] = "average"
    """How equal fitness values are ranked: by their average rank, or by their index in the population (authors' code).
    With average, a level whose members all have the same fitness stays unchanged."""

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the centred ranks [n]."""
        _check_finite(fitness)
        count, order = len(fitness), np.argsort(fitness, kind="stable")
        ranks = np.empty(count)
        ranks[order] = np.arange(count)
        if self.rank_ties == "average":
            _, first, inverse, repeats = np.unique(
                fitness[order], return_index=True, return_inverse=True, return_counts=True
            )
            ranks[order] = (first + (repeats - 1) / 2)[inverse]
        return ranks / (count - 1) - 0.5 if count > 1 else np.zeros(1)


@dataclass(frozen=True, kw_only=True)
class PairRanks(FitnessShaping):
    """Signed ranks of the differences within mirrored pairs.

    Members 2 g and 2 g + 1 are a pair with the difference d. A pair of G has the weight `sign(d) rank(|d|) / G`; equal
    differences share their average rank, and a difference of zero has the weight zero. The effects of the start and the
    goals, which both members share, cancel.

    Source: Wilcoxon 1945 (signed ranks); `docs/learning.md`.
    """

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return plus and minus half of the pair's weight for the members of each pair [n], an even number."""
        _check_finite(fitness)
        if len(fitness) % 2:
            raise ConfigError(f"pair_rank needs pairs, but there are {len(fitness)} members. Set --mirrored pair.")
        difference = fitness[0::2] - fitness[1::2]
        _, place, count = np.unique(np.abs(difference), return_inverse=True, return_counts=True)
        rank = (np.cumsum(count) - (count - 1) / 2)[place]  # ranks begin at 1
        half = np.sign(difference) * rank / (2 * len(difference))
        return np.stack([half, -half], axis=1).ravel()


def _check_finite(fitness: F64Array) -> None:
    if not np.isfinite(fitness).all():
        member = int(np.flatnonzero(~np.isfinite(fitness))[0])
        raise PolicyError(
            f"the fitness of member {member} is {fitness[member]}, but every fitness must be finite. "
            "Check the reward that it comes from."
        )


FITNESS_SHAPINGS: Registry[type[FitnessShaping]] = Registry(
    "fitness shaping",
    {"centred_rank": CentredRanks, "pair_rank": PairRanks},
    fix="Set --fitness-shaping.",
    check=subclass_of(FitnessShaping),
)
"""Fitness shapings by name: the choices of `--fitness-shaping`."""
