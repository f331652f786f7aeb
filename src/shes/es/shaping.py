"""Fitness shaping: how the fitness of a population becomes the weights of its members in the update.

The shaped fitness [n] of a population sums to zero, so a constant added to every fitness has no effect. To add a
shaping, write a class and a line in `FITNESS_SHAPINGS`. A class that is also a `Settings` dataclass has its fields as
flags of `shes train`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from shes.errors import ConfigError
from shes.es.ranking import TIES, centred_ranks, check_finite
from shes.options import subclass_of
from shes.registry import Registry
from shes.settings import Choices, Gt, Lt, Settings
from shes.types import F64Array


class FitnessShaping(ABC):
    """Turns the fitness of a population into the members' weights."""

    @abstractmethod
    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the shaped fitness [n] of `fitness` [n]: a new array that sums to zero, all zeros for n = 1.

        Raises:
            PolicyError: A fitness is not finite.
        """


@dataclass(frozen=True, kw_only=True)
class CentredRanks(FitnessShaping, Settings):
    """Ranks from -0.5 (worst) to 0.5 (best). Source: Salimans et al. 2017, section 2.1; SHES paper II-A."""

    rank_ties: Annotated[str, Choices(TIES)] = "average"
    """How equal fitness values are ranked: by their average rank, or by their index in the population."""

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the centred ranks [n]."""
        return centred_ranks(fitness, self.rank_ties)


@dataclass(frozen=True, kw_only=True)
class ZScore(FitnessShaping):
    """Standard scores, `(f - mean) / std`. A single outlier may dominate the update.

    The result is zero if the standard deviation is within the rounding error of the mean.

    Source: Mania, Guy and Recht 2018 (ARS), section 3.1.
    Deviation: ARS divides by the standard deviation, but does not subtract the mean.
    """

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the standard scores [n]."""
        check_finite(fitness)
        largest = np.abs(fitness).max()
        if largest == 0:
            return np.zeros(len(fitness))
        scaled = fitness / largest  # in [-1, 1]: no square overflows
        deviation = scaled - scaled.mean()
        deviation -= deviation.mean()  # the rounding error of the mean may be large relative to a small std
        std = np.sqrt(np.square(deviation).mean())
        if std <= len(fitness) * np.finfo(np.float64).eps:
            return np.zeros(len(fitness))
        return deviation / std


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
        check_finite(fitness)
        if len(fitness) % 2:
            raise ConfigError(
                f"pair_rank needs mirrored pairs, but got an odd number of members, {len(fitness)}. "
                "Set --mirrored pair."
            )
        difference = fitness[0::2] - fitness[1::2]
        size, place = np.unique(np.abs(difference), return_inverse=True)
        count = np.bincount(place, minlength=len(size))
        last = np.cumsum(count)  # ranks begin at 1
        rank = (last - (count - 1) / 2)[place]
        half = np.sign(difference) * rank / (2 * len(difference))
        return np.stack([half, -half], axis=1).ravel()


@dataclass(frozen=True, kw_only=True)
class TopFraction(FitnessShaping, Settings):
    """Truncation selection: 1 for the best `ceil(top_fraction * n)` members, 0 for the rest, minus the mean.

    Source: Beyer and Schwefel 2002, the (mu/mu, lambda)-ES with intermediate recombination.
    Deviation: the mean weight is subtracted, so that the weights sum to zero as those of the other shapings.
    """

    rank_ties: Annotated[str, Choices(TIES)] = "average"
    """How equal fitness values are ranked: by their average rank, or by their index in the population."""
    top_fraction: Annotated[float, Gt(0), Lt(1)] = 0.2
    """Fraction of the population that is selected by top_fraction."""

    def __call__(self, fitness: F64Array) -> F64Array:
        """Return the weights [n] of truncation selection, minus their mean."""
        check_finite(fitness)
        size = len(fitness)
        count = self.num_selected(size)
        if self.rank_ties == "index":
            weights = np.zeros(size)
            weights[np.argsort(fitness, kind="stable")[size - count :]] = 1.0
        else:
            threshold = np.partition(fitness, size - count)[size - count]
            above, tied = fitness > threshold, fitness == threshold
            weights = above + tied * ((count - above.sum()) / tied.sum())
        return weights - count / size

    def num_selected(self, size: int) -> int:
        """Return how many of `size` members are selected, at least one."""
        return max(1, math.ceil(round(self.top_fraction * size, 9)))  # round: 0.07 * 100 is 7.000000000000001


FITNESS_SHAPINGS: Registry[type[FitnessShaping]] = Registry(
    "fitness shaping",
    {"centred_rank": CentredRanks, "pair_rank": PairRanks, "z_score": ZScore, "top_fraction": TopFraction},
    fix="Set --fitness-shaping.",
    check=subclass_of(FitnessShaping),
)
"""Fitness shapings by name: the choices of `--fitness-shaping`."""
