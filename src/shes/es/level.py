"""One level of policies: its state, and the update that every level gets.

Source: SHES paper, Algorithm 1 lines 4 and 5; algorithm specification section 4.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shes.errors import ConfigError, UnknownNameError
from shes.es.gradient import group_weights, weighted_noise_sum
from shes.es.noise import NoiseTable
from shes.es.optimizers import Adam, AdamState
from shes.es.ranking import TIES, centred_ranks
from shes.es.statistics import ObservationStatistics
from shes.es.streams import Purpose, stream
from shes.types import F32Array, F64Array, IntArray

__all__ = [
    "LevelParameters",
    "LevelState",
    "TrainState",
    "UpdateRule",
    "draw_noise_index",
    "perturb",
    "update_level",
]


@dataclass(frozen=True, kw_only=True)
class LevelState:
    """Everything that a level carries from one generation to the next."""

    theta: F32Array
    """Parameters of the mean policy [D]."""
    optimizer: AdamState
    """State of the optimizer."""
    statistics: ObservationStatistics
    """Moments of what the level observes."""


@dataclass(frozen=True, kw_only=True)
class TrainState:
    """Everything that a run carries from one generation to the next."""

    seed: int
    """Seed of every draw."""
    generation: int
    """Updates made so far."""
    env_steps: int
    """Environment steps of training so far."""
    levels: tuple[LevelState, ...]
    """The levels, controller first."""


@dataclass(frozen=True, kw_only=True)
class LevelParameters:
    """What a level needs to act: parameters [D] and normalisation [O]."""

    theta: F32Array
    mean: F64Array
    inverse_std: F64Array

    @classmethod
    def of(cls, theta: F32Array, statistics: ObservationStatistics) -> LevelParameters:
        """Freeze `theta` with the normalisation that `statistics` give."""
        return cls(theta=theta, mean=statistics.mean, inverse_std=1 / statistics.std)


@dataclass(frozen=True, kw_only=True)
class UpdateRule:
    """How fitness becomes a step."""

    learning_rate: float
    """Adam's rate (alpha)."""
    weight_decay: float = 0.0
    """Coefficient of the parameters subtracted from the gradient estimate."""
    rank_ties: str = "average"
    """How equal fitnesses rank: `average` or `index`."""
    adam: Adam = Adam()
    """The optimizer."""

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ConfigError: A rate is out of range.
            UnknownNameError: `rank_ties` is not one of `TIES`.
        """
        if not 0 < self.learning_rate < float("inf"):
            raise ConfigError(f"learning_rate must be positive, got {self.learning_rate}.")
        if not 0 <= self.weight_decay < float("inf"):
            raise ConfigError(f"weight_decay must be zero or positive, got {self.weight_decay}.")
        if self.rank_ties not in TIES:
            raise UnknownNameError("way to rank ties", self.rank_ties, TIES, "Set --rank-ties.")


def draw_noise_index(seed: int, generation: int, num_groups: int, dims: tuple[int, ...], table_size: int) -> IntArray:
    """Return the start [L, G] of each group's slice of the noise table, one row per level of `dims` parameters."""
    rows = [
        stream(seed, Purpose.NOISE_INDEX, generation, level).integers(0, table_size - dim + 1, num_groups)
        for level, dim in enumerate(dims)
    ]
    return np.stack(rows)


def perturb(theta: F32Array, noise: F32Array, scale: float, out: F32Array) -> None:
    """Write `theta + scale * noise` [D] into `out` [D]; `scale` is the member's sign times sigma."""
    if scale == 0:
        out[:] = theta
        return
    np.multiply(noise, np.float32(scale), out=out)
    np.add(out, theta, out=out)


def update_level(
    level: LevelState,
    fitness: F64Array,
    signs: NDArray[np.int8],
    noise_index: IntArray,
    table: NoiseTable,
    rule: UpdateRule,
    pool: ThreadPoolExecutor | None = None,
) -> LevelState:
    """Return `level` after one update from the fitness [n] of its members.

    The gradient estimate is `(1 / n) * sum(weight * noise) - weight_decay * theta`.

    Deviation: no factor 1/sigma (the paper's Algorithm 1 has it, its code does not): Adam's step does not depend on the
    scale of the gradient, only the weight decay beside it does.

    Args:
        level: The level before.
        fitness: Fitness [n], group after group.
        signs: Sign [M] that each member of a group gives to this level's noise.
        noise_index: Start of each group's slice of the table [G].
        table: The noise table.
        rule: Rates and options.
        pool: Threads for the weighted sum; its result does not depend on them.
    """
    shaped = centred_ranks(fitness, rule.rank_ties)
    weights = group_weights(shaped, signs) / np.float32(len(fitness))
    gradient = weighted_noise_sum(table, noise_index, weights, len(level.theta), pool)
    if rule.weight_decay:
        gradient -= np.float32(rule.weight_decay) * level.theta
    step, optimizer = rule.adam.step(gradient, level.optimizer, rule.learning_rate)
    return replace(level, theta=level.theta + step, optimizer=optimizer)
