"""Novelty search for one level: members are also rewarded for ending far from earlier final positions.

The archive holds the final positions of the mean policies of all generations. The novelty of a member is the distance
to the nearest of them, and a weight rule combines it with the return. Positions are in metres.

Source: Conti et al. 2018, section 3 (NS-ES, NSR-ES, NSRA-ES); the SHES authors' ScalableES.jl, `src/novelty`.
Deviation: a single mean policy. Conti et al. keep several and choose among them by their novelty.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from shes.options import subclass_of
from shes.registry import Registry
from shes.types import F64Array

_DISTANCES = 1 << 20  # distances in memory at a time, at least one row of the archive's length: 40 MB with temporaries


@dataclass(frozen=True, kw_only=True)
class NoveltyState:
    """State of the novelty search between generations."""

    archive: F64Array
    """Final positions [archive, 2] of the mean policies so far."""
    weight: float
    """Weight of the return in the fitness. Novelty has the weight `1 - weight`."""
    best_return: float
    """Highest return so far, as the weight rule measures it; `-inf` at the start."""
    stalled: int
    """Generations since `best_return`, or since the weight was last lowered."""


def behaviour_distance(positions: F64Array, archive: F64Array) -> F64Array:
    """Return the distances between `positions` [positions, 2] and `archive` [archive, 2] as a matrix."""
    east, north = positions[:, :1] - archive[:, 0], positions[:, 1:] - archive[:, 1]
    return np.sqrt(east * east + north * north)


def novelty(behaviours: F64Array, archive: F64Array, neighbours: int) -> F64Array:
    """Return the novelty [n] of members: the mean distance of their final positions to the nearest in the archive.

    The novelty of a member is the mean over its episodes. The result is bit-identical for any order of the archive.

    Source: Conti et al. 2018, section 3.1: `N(theta, A) = 1 / k * sum |b - b_j|` over the k nearest.
    Deviation: each episode is measured by itself. Conti et al. and the SHES authors first average the behaviour over a
    policy's episodes, and the latter's behaviour is the path, sampled every 20 steps, instead of the final position.

    Args:
        behaviours: Final positions [n, E, 2] of the members' episodes.
        archive: Positions [archive, 2]. The novelty is zero if the archive is empty.
        neighbours: Number of nearest neighbours (k), at least 1. All positions count if the archive has fewer.
    """
    size, episodes = len(behaviours), behaviours.shape[1]
    if len(archive) == 0:
        return np.zeros(size)
    positions = behaviours.reshape(-1, 2)
    rows = max(1, _DISTANCES // len(archive))
    nearest = np.concatenate(
        [_nearest(positions[i : i + rows], archive, neighbours) for i in range(0, len(positions), rows)]
    )
    return _mean_of_columns(nearest.reshape(size, episodes))


def _nearest(positions: F64Array, archive: F64Array, neighbours: int) -> F64Array:
    """Return the mean distance [positions] of `positions` [positions, 2] to the nearest of `archive` [archive, 2]."""
    distance = behaviour_distance(positions, archive)
    if neighbours < len(archive):
        distance.partition(neighbours - 1, axis=1)
        distance = distance[:, :neighbours]
    return _mean_of_columns(np.sort(distance, axis=1))


def _mean_of_columns(values: F64Array) -> F64Array:
    """Return the mean [rows] over the columns of `values` [rows, columns], which are summed in order."""
    total = np.zeros(len(values))
    for column in values.T:
        total += column
    return total / values.shape[1]


def extend(state: NoveltyState, final_positions: F64Array) -> NoveltyState:
    """Return `state` with the mean policy's `final_positions` [E, 2] added to its archive."""
    return replace(state, archive=np.concatenate([state.archive, final_positions]))


def blend(shaped_return: F64Array, shaped_novelty: F64Array, weight: float) -> F64Array:
    """Return `weight * shaped_return + (1 - weight) * shaped_novelty` [n].

    Source: Conti et al. 2018, section 3.2 (NSRA-ES). It is NS-ES with weight 0 and NSR-ES with weight 0.5.
    """
    return weight * shaped_return + (1 - weight) * shaped_novelty


class WeightRule(ABC):
    """Determines the weight of the return in each generation."""

    start_weight: ClassVar[float]
    """Weight of the return in the first generation."""

    def start(self) -> NoveltyState:
        """Return the state before the first generation, with an empty archive."""
        return NoveltyState(archive=np.zeros((0, 2)), weight=self.start_weight, best_return=-np.inf, stalled=0)

    @abstractmethod
    def next(self, state: NoveltyState, mean_return: float, population_return: float) -> tuple[float, float, int]:
        """Return the next `(weight, best_return, stalled)`.

        Args:
            state: State of the generation just evaluated.
            mean_return: Return of the mean policy.
            population_return: Mean return of the population.
        """


class NS(WeightRule):
    """Novelty alone. Source: Conti et al. 2018, section 3.1 (NS-ES)."""

    start_weight: ClassVar[float] = 0.0

    def next(self, state: NoveltyState, mean_return: float, population_return: float) -> tuple[float, float, int]:
        """Return the same weight. `best_return` and `stalled` are only recorded."""
        is_best = mean_return > state.best_return
        return self.start_weight, max(mean_return, state.best_return), 0 if is_best else state.stalled + 1


class NSR(NS):
    """Novelty and return with equal weights. Source: Conti et al. 2018, section 3.2 (NSR-ES)."""

    start_weight: ClassVar[float] = 0.5


@dataclass(frozen=True, kw_only=True)
class NSRA(WeightRule):
    """Adaptive weight: starts with the return alone, and shifts towards novelty while the return stalls.

    A new best return of the mean policy raises the weight by `delta`. `patience` generations without one lower it.

    Source: Conti et al. 2018, section 3.2 (NSRA-ES) and its algorithm in the supplement; the values are those of
    estorch, an implementation of that paper.
    """

    start_weight: ClassVar[float] = 1.0

    delta: float = 0.05
    """Change of the weight."""
    patience: int = 50
    """Generations without a new best after which the weight is lowered (t_w)."""

    def next(self, state: NoveltyState, mean_return: float, population_return: float) -> tuple[float, float, int]:
        """Return the next `(weight, best_return, stalled)` by the mean policy's return."""
        if mean_return > state.best_return:
            return min(state.weight + self.delta, 1.0), mean_return, 0
        stalled = state.stalled + 1
        if stalled < self.patience:
            return state.weight, state.best_return, stalled
        return max(state.weight - self.delta, 0.0), state.best_return, 0


@dataclass(frozen=True, kw_only=True)
class AuthorsNSRA(WeightRule):
    """The SHES authors' rule: a new best mean return of the population resets the weight to 1.

    The weight is lowered after more than `patience + (1 - weight) * extra` generations without a new best.

    Source: ScalableES.jl, `src/novelty/Novelty.jl`, `weight_schedule`. Its runs have a `min_weight` of 0.8
    (`ScalableNsEs.jl`).
    Deviation: the new weight already applies to the generation that caused the change, as with the other rules. In the
    authors' code it applies from the next one on.
    """

    start_weight: ClassVar[float] = 1.0

    delta: float = 0.05
    """Decrease of the weight."""
    patience: int = 10
    """Generations without a new best before a decrease, at weight 1."""
    extra: int = 20
    """Additional generations before a decrease, at weight 0."""
    min_weight: float = 0.0

    def next(self, state: NoveltyState, mean_return: float, population_return: float) -> tuple[float, float, int]:
        """Return the next `(weight, best_return, stalled)` by the population's mean return."""
        weight, best_return, stalled = state.weight, state.best_return, state.stalled + 1
        if population_return > best_return:
            weight, best_return, stalled = 1.0, population_return, 0
        if stalled > self.patience + (1 - weight) * self.extra:
            weight, stalled = max(weight - self.delta, self.min_weight), 0
        return weight, best_return, stalled


NOVELTY_RULES: Registry[type[WeightRule]] = Registry(
    "novelty rule",
    {"ns": NS, "nsr": NSR, "nsra": NSRA, "nsra_reset": AuthorsNSRA},
    fix="Set --novelty.",
    check=subclass_of(WeightRule),
)
"""Weight rules by name: the choices of `--novelty`, besides `none`."""
