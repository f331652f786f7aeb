"""One level of policies: its state, and the update that every level gets.

Source: SHES paper, Algorithm 1 lines 4 and 5; algorithm specification section 4.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shes.errors import ConfigError
from shes.es.gradient import group_weights, weighted_noise_sum
from shes.es.noise import NoiseTable
from shes.es.novelty import NoveltyState
from shes.es.optimizers import Adam, Optimizer, OptimizerState
from shes.es.shaping import CentredRanks, FitnessShaping
from shes.es.statistics import ObservationStatistics
from shes.es.streams import Purpose, stream
from shes.types import F32Array, F64Array, IntArray

__all__ = [
    "LevelParameters",
    "LevelState",
    "LevelUpdate",
    "RunningEpisodes",
    "TrainState",
    "UpdateRule",
    "draw_noise_index",
    "perturb",
    "select_fitness",
    "update_level",
]


@dataclass(frozen=True, kw_only=True)
class LevelState:
    """Everything that a level carries from one generation to the next."""

    name: str
    """What the level is called: `controller`, `primitive`, or `policy` where there is one level alone."""
    theta: F32Array
    """Parameters of the mean policy [D]."""
    optimizer: OptimizerState
    """State of the optimizer."""
    statistics: ObservationStatistics
    """Moments of what the level observes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RunningEpisodes:
    """Episodes from which pairs of primitives branch off, generation after generation."""

    states: F64Array
    """Whole physics states [G, S], the solver's warm start included."""
    steps: IntArray
    """Control steps that each has made [G]; -1 for one that is to begin anew, whose state means nothing."""


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
    novelty: NoveltyState | None = None
    """Archive and weight of the search for novelty, if there is one."""
    running: RunningEpisodes | None = None
    """Episodes that go on from generation to generation, if there are any."""


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

    @classmethod
    def of_all(cls, levels: Sequence[LevelState]) -> tuple[LevelParameters, ...]:
        """Freeze every one of `levels`."""
        return tuple(cls.of(level.theta, level.statistics) for level in levels)


@dataclass(frozen=True, kw_only=True)
class UpdateRule:
    """How fitness becomes a step."""

    weight_decay: float = 0.0
    """Coefficient of the parameters subtracted from the gradient estimate."""
    decouples_decay: bool = False
    """Whether the decay goes round the optimizer: the step then has `-learning_rate * weight_decay * theta` beside it.

    Source: Loshchilov and Hutter 2019 (AdamW), Algorithm 2.
    """
    holds_when_tied: bool = False
    """Whether a level whose members are all worth the same stays as it is, its optimizer's state too."""
    fall_price: float = 0.0
    """Subtracted from a member's shaped fitness for a fall that ends its episode."""
    shaping: FitnessShaping = CentredRanks()
    """What a fitness counts."""
    optimizer: Optimizer = Adam()
    """How the gradient estimate becomes a step."""

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ConfigError: `weight_decay` is out of range.
        """
        for name in ("weight_decay", "fall_price"):
            if not 0 <= getattr(self, name) < float("inf"):
                raise ConfigError(f"{name} must be zero or positive, got {getattr(self, name)}.")


@dataclass(frozen=True, kw_only=True)
class LevelUpdate:
    """A level after its update, and what is to be known of the update; NaN where the level was not perturbed."""

    level: LevelState
    """The level after the update."""
    gradient_norm: float = np.nan
    """Length of the gradient estimate, without weight decay."""
    halves_cosine: float = np.nan
    """Cosine between the estimates from the first and the second half of the groups: near 0 is noise, near 1 signal."""
    update_ratio: float = np.nan
    """Length of the step over that of the parameters before it."""


def draw_noise_index(
    seed: int, generation: int, num_groups: int, dims: tuple[int, ...], table_size: int, first_level: int = 0
) -> IntArray:
    """Return the start [L, G] of each group's slice of the noise table, one row per level of `dims` parameters.

    `first_level` is the number of the first of these levels: each level has a stream of its own.
    """
    rows = [
        stream(seed, Purpose.NOISE_INDEX, generation, level).integers(0, table_size - dim + 1, num_groups)
        for level, dim in enumerate(dims, first_level)
    ]
    return np.stack(rows)


def perturb(theta: F32Array, noise: F32Array, scale: float, out: F32Array) -> None:
    """Write `theta + scale * noise` [D] into `out` [D]; `scale` is the member's sign times sigma."""
    if scale == 0:
        out[:] = theta
        return
    np.multiply(noise, np.float32(scale), out=out)
    np.add(out, theta, out=out)


def select_fitness(fitness: F64Array, signs: NDArray[np.int8]) -> F64Array:
    """Return the fitness [n'] of the members that perturb a level, given all [n] and the level's signs [G, M]."""
    return fitness.reshape(signs.shape)[signs.any(axis=1)].ravel()


def update_level(  # noqa: PLR0917 - a formula's terms
    level: LevelState,
    shaped: F64Array,
    signs: NDArray[np.int8],
    noise_index: IntArray,
    table: NoiseTable,
    rule: UpdateRule,
    learning_rate: float,
    pool: ThreadPoolExecutor | None = None,
) -> LevelUpdate:
    """Return `level` after one update from the shaped fitness [n'] of the members that perturbed it.

    The gradient estimate is `(1 / n') * sum(weight * noise) - weight_decay * theta`, unless `rule` decouples the decay.

    Deviation: no factor 1/sigma (the paper's Algorithm 1 has it, its code does not): Adam's step does not depend on the
    scale of the gradient, only the weight decay beside it does.

    Args:
        level: The level before.
        shaped: Shaped fitness [n'], group after group, of the groups in which `signs` are not 0.
        signs: Signs [G, M] that the members of each group give to this level's noise.
        noise_index: Start of each group's slice of the table [G].
        table: The noise table.
        rule: Weight decay and optimizer.
        learning_rate: The optimizer's rate (alpha).
        pool: Threads for the weighted sum; its result does not depend on them.
    """
    active = signs.any(axis=1)
    if not active.any():
        return LevelUpdate(level=level)
    weights = group_weights(shaped, signs[active]) / np.float32(len(shaped))
    if rule.holds_when_tied and not weights.any():
        return LevelUpdate(level=level, gradient_norm=0.0, update_ratio=0.0)
    indices, middle = noise_index[active], len(weights) // 2
    halves = [
        weighted_noise_sum(table, indices[half], weights[half], len(level.theta), pool)
        for half in (slice(None, middle), slice(middle, None))
    ]
    gradient = halves[0] + halves[1]
    norm = _length(gradient)
    if rule.weight_decay and not rule.decouples_decay:
        gradient -= np.float32(rule.weight_decay) * level.theta
    step, optimizer = rule.optimizer.step(gradient, level.optimizer, learning_rate)
    if rule.decouples_decay:
        step -= np.float32(learning_rate * rule.weight_decay) * level.theta
    return LevelUpdate(
        level=replace(level, theta=level.theta + step, optimizer=optimizer),
        gradient_norm=norm,
        halves_cosine=_cosine(*halves),
        update_ratio=_ratio(_length(step), _length(level.theta)),
    )


def _length(vector: F32Array) -> float:
    """Return the Euclidean length of `vector` [D], without BLAS: the same bits for any number of threads."""
    wide = vector.astype(np.float64)
    return float(np.sqrt((wide * wide).sum()))


def _cosine(a: F32Array, b: F32Array) -> float:
    """Return the cosine between `a` and `b` [D]; NaN where one is zero."""
    product = float((a.astype(np.float64) * b).sum())
    return _ratio(product, _length(a) * _length(b))


def _ratio(part: float, whole: float) -> float:
    """Return `part / whole`; NaN where `whole` is 0."""
    return part / whole if whole else np.nan
