"""Novelty search for one level: a member is also worth how far it ends from where the policy ended before.

The archive holds where the mean policy ended, generation after generation. Novelty is the distance to the nearest of
these places, and a rule says how much it weighs against the return.

Source: Conti et al. 2018, section 3 (NS-ES, NSR-ES, NSRA-ES); the SHES authors' ScalableES.jl, `src/novelty`.

Deviation: one policy, where Conti et al. keep several and choose among them by their novelty.

Positions are in metres.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from shes.errors import ConfigError
from shes.registry import Registry, subclass_of
from shes.types import F64Array

__all__ = [
    "NOVELTY_RULES",
    "NS",
    "NSR",
    "NSRA",
    "AuthorsNSRA",
    "NoveltyState",
    "WeightRule",
    "behaviour_distance",
    "blend",
    "extend",
    "make_novelty_rule",
    "novelty",
]

_DISTANCES = 1 << 20  # distances in memory at a time: with temporaries 40 MB; one row of the archive's length at least


@dataclass(frozen=True, kw_only=True)
class NoveltyState:
    """What novelty search carries from one generation to the next."""

    archive: F64Array
    """Final positions [archive, 2] of the mean policies so far."""
    weight: float
    """Share of the return in the fitness; `1 - weight` is novelty's."""
    best_return: float
    """Highest return so far, as the rule measures it; `-inf` at the start."""
    stalled: int
    """Generations since `best_return`, or since the weight was last lowered."""


def behaviour_distance(positions: F64Array, archive: F64Array) -> F64Array:
    """Return how far each of `positions` [positions, 2] is from each of `archive` [archive, 2], as a matrix."""
    east, north = positions[:, :1] - archive[:, 0], positions[:, 1:] - archive[:, 1]
    return np.sqrt(east * east + north * north)


def novelty(behaviours: F64Array, archive: F64Array, neighbours: int) -> F64Array:
    """Return the novelty [n] of members: the mean distance of their ends to the nearest places of the archive.

    Every episode counts by itself; a member's novelty is the mean over its episodes. The bits do not depend on the
    order of the archive, nor on how the work is cut up.

    Source: Conti et al. 2018, section 3.1: `N(theta, A) = 1 / k * sum |b - b_j|` over the k nearest.

    Deviation: both codes first average a policy's episodes into one behaviour, which may lie where no episode went;
    and the authors' behaviour is the path, a position every 20 steps, here it is its end (Conti et al.: Humanoid).

    Args:
        behaviours: Final positions [n, E, 2] of the members' episodes.
        archive: Positions [archive, 2]; empty, and nothing is novel: zeros.
        neighbours: Nearest places that count (k); all of them where the archive has fewer.

    Raises:
        ConfigError: `neighbours` is not positive.
    """
    if neighbours < 1:
        raise ConfigError(
            f"novelty_neighbours must be a positive whole number, got {neighbours}. Set --novelty-neighbours."
        )
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
    """Return the mean [rows] of the columns of `values` [rows, columns], added in order for the same bits."""
    total = np.zeros(len(values))
    for column in values.T:
        total += column
    return total / values.shape[1]


def extend(state: NoveltyState, final_positions: F64Array) -> NoveltyState:
    """Return `state` with the mean policy's `final_positions` [E, 2] added to its archive."""
    return replace(state, archive=np.concatenate([state.archive, final_positions]))


def blend(shaped_return: F64Array, shaped_novelty: F64Array, weight: float) -> F64Array:
    """Return the fitness [n]: `weight` of the shaped return [n] and `1 - weight` of the shaped novelty [n].

    Source: Conti et al. 2018, section 3.2 (NSRA-ES); with weight 0 NS-ES, with 0.5 NSR-ES.
    """
    return weight * shaped_return + (1 - weight) * shaped_novelty


class WeightRule(ABC):
    """How much the return weighs against novelty, from generation to generation."""

    start_weight: ClassVar[float]
    """Weight of the return in the first generation."""

    def start(self) -> NoveltyState:
        """Return the state before the first generation: an empty archive."""
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
        """Return the same weight; `best_return` and `stalled` are there to be looked at."""
        del population_return
        is_best = mean_return > state.best_return
        return self.start_weight, max(mean_return, state.best_return), 0 if is_best else state.stalled + 1


class NSR(NS):
    """Novelty and return by halves. Source: Conti et al. 2018, section 3.2 (NSR-ES)."""

    start_weight: ClassVar[float] = 0.5


@dataclass(frozen=True, kw_only=True)
class NSRA(WeightRule):
    """The return alone until it stalls; then, step by step, novelty, until the return grows again.

    A new best return of the mean policy raises the weight by `delta`; `patience` generations without one lower it.

    Source: Conti et al. 2018, section 3.2 (NSRA-ES) and its algorithm in the supplement; the values are those of
    estorch, which implements the paper.
    """

    start_weight: ClassVar[float] = 1.0

    delta: float = 0.05
    """Change of the weight at a time."""
    patience: int = 50
    """Generations without a new best after which the weight falls (t_w)."""

    def next(self, state: NoveltyState, mean_return: float, population_return: float) -> tuple[float, float, int]:
        """Return the next `(weight, best_return, stalled)` by the mean policy's return."""
        del population_return
        if mean_return > state.best_return:
            return min(state.weight + self.delta, 1.0), mean_return, 0
        stalled = state.stalled + 1
        if stalled < self.patience:
            return state.weight, state.best_return, stalled
        return max(state.weight - self.delta, 0.0), state.best_return, 0


@dataclass(frozen=True, kw_only=True)
class AuthorsNSRA(WeightRule):
    """The SHES authors' rule: a new best mean return of the population sets the weight to 1 at once.

    The more novelty weighs, the longer a stall is borne: more than `patience + (1 - weight) * extra` generations.

    Deviation: the weight already counts in the generation that earned it (their code: from the next one on), as that of
    the other rules does, which the mean policy's own episodes decide.

    Source: ScalableES.jl, `src/novelty/Novelty.jl`, `weight_schedule`, in its order; its runs have a `min_weight` of
    0.8 (`ScalableNsEs.jl`).
    """

    start_weight: ClassVar[float] = 1.0

    delta: float = 0.05
    """Fall of the weight at a time."""
    patience: int = 10
    """Generations without a new best that are borne when only the return counts."""
    extra: int = 20
    """Generations borne beyond that when only novelty counts."""
    min_weight: float = 0.0
    """Lowest weight."""

    def next(self, state: NoveltyState, mean_return: float, population_return: float) -> tuple[float, float, int]:
        """Return the next `(weight, best_return, stalled)` by the population's mean return."""
        del mean_return
        weight, best_return, stalled = state.weight, state.best_return, state.stalled + 1
        if population_return > best_return:
            weight, best_return, stalled = 1.0, population_return, 0
        if stalled > self.patience + (1 - weight) * self.extra:
            weight, stalled = max(weight - self.delta, self.min_weight), 0
        return weight, best_return, stalled


NOVELTY_RULES: Registry[type[WeightRule]] = Registry(
    "novelty rule",
    {
        "ns": NS,
        "nsr": NSR,
        "nsra": NSRA,
        "nsra_reset": AuthorsNSRA,
    },
    fix="Set --novelty.",
    check=subclass_of(WeightRule),
)


def make_novelty_rule(name: str) -> WeightRule:
    """Return the weight rule of this name.

    Raises:
        UnknownNameError: `name` is not in `NOVELTY_RULES`.
    """
    return NOVELTY_RULES.find(name)()
