"""Fitness shaping: what a member's fitness counts in the update. Each way is one small class behind a name.

Whatever the way, the shaped fitness [n] of a population sums to zero: a constant added to every fitness moves nothing.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Self

import numpy as np

from shes.errors import ConfigError, UnknownNameError
from shes.es.ranking import TIES, centred_ranks, check_finite
from shes.registry import Registry, subclass_of
from shes.types import F64Array

__all__ = [
    "FITNESS_SHAPINGS",
    "CentredRanks",
    "FitnessShaping",
    "PairRanks",
    "TopFraction",
    "ZScore",
    "make_fitness_shaping",
]


class FitnessShaping(ABC):
    """From the fitness of a population to what each member counts."""

    @abstractmethod
    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the shaped fitness [n] of `fitness` [n]: a new array that sums to zero, all zeros for n = 1.

        Raises:
            PolicyError: A fitness is not finite.
        """

    @classmethod
    def of(cls, *, ties: str, fraction: float) -> Self:
        """Return this shaping with those of the options that concern it."""
        del ties, fraction
        return cls()


@dataclass(frozen=True, kw_only=True)
class CentredRanks(FitnessShaping):
    """Ranks from -0.5 (worst) to 0.5 (best). Source: Salimans et al. 2017, section 2.1; SHES paper II-A."""

    ties: str = "average"
    """How equal fitnesses rank: one of `TIES`."""

    def __post_init__(self) -> None:
        """Refuse unknown `ties` (UnknownNameError)."""
        _check_ties(self.ties)

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the centred ranks [n]."""
        return centred_ranks(fitness, self.ties)

    @classmethod
    def of(cls, *, ties: str, fraction: float) -> Self:
        """Return centred ranks with `ties`."""
        del fraction
        return cls(ties=ties)


@dataclass(frozen=True, kw_only=True)
class ZScore(FitnessShaping):
    """`(f - mean) / std`: keeps distances between fitnesses, so one outlier may carry the whole update.

    A standard deviation within the rounding of the mean is no difference: then nobody counts.

    Source: Mania, Guy and Recht 2018 (ARS), section 3.1, which divide by the std; the mean is taken off besides.
    """

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the standard scores [n]."""
        check_finite(fitness)
        largest = np.abs(fitness).max()
        if largest == 0:
            return np.zeros(len(fitness))
        scaled = fitness / largest  # in [-1, 1]: no square overflows
        deviation = scaled - scaled.mean()
        deviation -= deviation.mean()  # what rounding left of the mean, large beside a small std
        std = np.sqrt(np.square(deviation).mean())
        if std <= len(fitness) * np.finfo(np.float64).eps:
            return np.zeros(len(fitness))
        return deviation / std


@dataclass(frozen=True, kw_only=True)
class PairRanks(FitnessShaping):
    """Ranks of the differences within mirrored pairs: `sign(d) rank(|d|) / G` is what a pair of G counts, in (0, 1].

    Members 2 g and 2 g + 1 are a pair. A pair without a difference counts nothing, equal sizes share their average
    rank. What two members have in common, their start and their goals, does not enter.

    Source: learning specification, section 2; Wilcoxon 1945 (signed ranks).
    """

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return plus and minus half of what its pair counts for each member [n]."""
        check_finite(fitness)
        if len(fitness) % 2:
            raise ConfigError(
                f"pair_rank ranks mirrored pairs, but {len(fitness)} fitnesses are no pairs. Set --mirrored pair."
            )
        difference = fitness[0::2] - fitness[1::2]
        size, place = np.unique(np.abs(difference), return_inverse=True)
        count = np.bincount(place, minlength=len(size))
        last = np.cumsum(count)  # ranks begin at 1
        rank = (last - (count - 1) / 2)[place]
        half = np.sign(difference) * rank / (2 * len(difference))
        return np.stack([half, -half], axis=1).ravel()


@dataclass(frozen=True, kw_only=True)
class TopFraction(FitnessShaping):
    """Truncation selection with equal weights: the best `ceil(fraction * n)` count 1, the rest 0, minus the mean.

    Source: Rechenberg 1973, Schwefel 1977: the (mu/mu, lambda)-ES; Beyer and Schwefel 2002 (truncation
    selection, intermediate recombination).

    Deviation: the mean of the weights is subtracted, so that they sum to zero as those of the other shapings do.
    """

    fraction: float = 0.2
    """Share of the population that is selected, in (0, 1). Where that is everybody, nobody counts."""
    ties: str = "average"
    """Members that tie across the border share the places left equally (`average`), or the later ones in the
    population get them (`index`, the order that ranks by index have)."""

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ConfigError: `fraction` is not inside (0, 1).
            UnknownNameError: `ties` is not one of `TIES`.
        """
        if not 0 < self.fraction < 1:
            raise ConfigError(f"top_fraction must be above 0 and below 1, got {self.fraction}. Set --top-fraction.")
        _check_ties(self.ties)

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the weights [n] of truncation selection, minus their mean."""
        check_finite(fitness)
        size = len(fitness)
        count = self.num_selected(size)
        if self.ties == "index":
            weights = np.zeros(size)
            weights[np.argsort(fitness, kind="stable")[size - count :]] = 1.0
        else:
            border = np.partition(fitness, size - count)[size - count]
            above, tied = fitness > border, fitness == border
            weights = above + tied * ((count - above.sum()) / tied.sum())
        return weights - count / size

    @classmethod
    def of(cls, *, ties: str, fraction: float) -> Self:
        """Return truncation selection of `fraction` with `ties`."""
        return cls(fraction=fraction, ties=ties)

    def num_selected(self, size: int) -> int:
        """Return how many of `size` members are selected, at least one."""
        return max(1, math.ceil(round(self.fraction * size, 9)))  # round: 0.07 * 100 is 7.000000000000001


FITNESS_SHAPINGS: Registry[type[FitnessShaping]] = Registry(
    "fitness shaping",
    {
        "centred_rank": CentredRanks,
        "pair_rank": PairRanks,
        "z_score": ZScore,
        "top_fraction": TopFraction,
    },
    fix="Set --fitness-shaping.",
    check=subclass_of(FitnessShaping),
)


def make_fitness_shaping(name: str, *, ties: str = "average", fraction: float = 0.2) -> FitnessShaping:
    """Return the fitness shaping of this name.

    Args:
        name: One of `FITNESS_SHAPINGS`.
        ties: How equal fitnesses rank, for those that rank.
        fraction: Share that `top_fraction` selects.

    Raises:
        UnknownNameError: `name` is not in `FITNESS_SHAPINGS`, or `ties` not in `TIES`.
        ConfigError: `fraction` is not inside (0, 1).
    """
    return FITNESS_SHAPINGS.find(name).of(ties=ties, fraction=fraction)


def _check_ties(ties: str) -> None:
    """Refuse an unknown way to rank ties."""
    if ties not in TIES:
        raise UnknownNameError("way to rank ties", ties, TIES, "Set --rank-ties.")
