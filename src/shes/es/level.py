"""The state of one level and its update, which is the same for every level.

Source: SHES paper, Algorithm 1 lines 4 and 5. `docs/algorithm.md` has the equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shes.errors import PolicyError
from shes.es.noise import NoiseTable, weighted_noise_sum
from shes.es.optimizers import Adam, Optimizer, OptimizerState
from shes.es.shaping import CentredRanks, FitnessShaping
from shes.es.statistics import ObservationStatistics
from shes.streams import Purpose, stream
from shes.types import F32Array, F64Array, IntArray


@dataclass(frozen=True, kw_only=True)
class LevelState:
    """State of one level between generations."""

    name: str
    """Name of the level: `controller`, `primitive`, or `policy` if it is the only level."""
    theta: F32Array
    """Parameters of the mean policy [D]."""
    optimizer: OptimizerState
    statistics: ObservationStatistics

    @classmethod
    def start(cls, name: str, theta: F32Array, optimizer: Optimizer, observation_size: int) -> LevelState:
        """Return the state before the first update."""
        statistics = ObservationStatistics.empty(observation_size)
        return cls(name=name, theta=theta, optimizer=optimizer.start(len(theta)), statistics=statistics)


@dataclass(frozen=True, kw_only=True)
class StrategyState:
    """State of an evolution strategy between generations."""

    seed: int
    """Seed of all random numbers."""
    generation: int = 0
    """Number of updates so far."""
    levels: tuple[LevelState, ...]
    """The levels, controller first."""


@dataclass(frozen=True, kw_only=True)
class LevelParameters:
    """Parameters [D] and input normalisation [O] of one level: all that acting needs."""

    theta: F32Array
    mean: F64Array
    inverse_std: F64Array

    @classmethod
    def of(cls, theta: F32Array, statistics: ObservationStatistics) -> LevelParameters:
        """Return `theta` with the normalisation given by `statistics`."""
        return cls(theta=theta, mean=statistics.mean, inverse_std=1 / statistics.std)

    def at_zero(self) -> LevelParameters:
        """Return these with all parameters 0: the network's outputs are 0."""
        return replace(self, theta=np.zeros_like(self.theta))


@dataclass(frozen=True, kw_only=True)
class UpdateRule:
    """How the fitness of a population becomes a step of one level."""

    weight_decay: float = 0.0
    """Coefficient of the weight decay (lambda), zero or positive."""
    holds_when_tied: bool = False
    """Whether a level stays unchanged, its optimizer state included, if all its members have the same fitness."""
    fall_price: float = 0.0
    """Subtracted from a member's shaped fitness for a fall, in part for tilt; zero or positive, not in the return."""
    shaping: FitnessShaping = CentredRanks()
    optimizer: Optimizer = Adam()

    def shape(self, fitness: F64Array, signs: NDArray[np.int8], falls: F64Array | None = None) -> F64Array:
        """Return the shaped fitness [n'] of the members that perturb a level, given the signs [G, M] of all.

        `fitness` [n] and the mean of `falls` [n] in [0, 1] are those of all members. Raise PolicyError unless every
        fitness is finite.
        """
        active = select_fitness(fitness, signs)
        if not len(active):
            return active
        if not np.isfinite(active).all():
            member = int(np.flatnonzero(~np.isfinite(fitness))[0])
            raise PolicyError(
                f"the fitness of member {member} is {fitness[member]}, but every fitness must be finite. "
                "Check the reward that it comes from."
            )
        shaped = self.shaping(active)
        if self.fall_price and falls is not None:
            own = select_fitness(falls, signs)
            shaped = shaped - self.fall_price * (own - own.mean())
        return shaped


@dataclass(frozen=True, kw_only=True)
class LevelUpdate:
    """A level after its update, with diagnostics. Diagnostics are NaN if no member perturbed the level."""

    level: LevelState
    """The level after the update."""
    gradient_norm: float = np.nan
    """Length of the gradient estimate, without weight decay."""
    halves_cosine: float = np.nan
    """Cosine between the estimates from the two halves of the groups: near 0 is noise, near 1 is signal."""
    update_ratio: float = np.nan
    """Length of the step, divided by the length of the parameters before it."""


def draw_noise_index(
    seed: int, generation: int, num_groups: int, dims: Sequence[int], table_size: int, first_level: int = 0
) -> IntArray:
    """Return the start [L, G] of each group's slice of the noise table, for levels of `dims` parameters.

    Each level has its own random stream. `first_level` is the index of the first of these levels.
    """
    rngs = (stream(seed, Purpose.NOISE_INDEX, generation, first_level + i) for i in range(len(dims)))
    return np.stack([rng.integers(0, table_size - dim + 1, num_groups) for rng, dim in zip(rngs, dims, strict=True)])


def perturb(theta: F32Array, noise: F32Array, scale: float, out: F32Array) -> None:
    """Write `theta + scale * noise` [D] into `out` [D]. `scale` is the member's sign times sigma."""
    if scale == 0:
        out[:] = theta
        return
    np.multiply(noise, np.float32(scale), out=out)
    np.add(out, theta, out=out)


def select_fitness(fitness: F64Array, signs: NDArray[np.int8]) -> F64Array:
    """Return the fitness [n'] of the members that perturb a level, given all fitness [n] and the signs [G, M]."""
    return fitness.reshape(signs.shape)[signs.any(axis=1)].ravel()


def group_weights(shaped: F64Array, signs: NDArray[np.int8]) -> F32Array:
    """Return one weight [G] per noise vector: the sum of its members' shaped fitness [n], with their signs [G, M].

    Values are sorted, so that equal ones on both sides cancel exactly. Optimizers that ignore the gradient's length
    would take a rounding error for a direction.
    """
    values = shaped.reshape(signs.shape)
    plus, minus = (np.sort(np.where(side, values, 0.0), axis=1).sum(axis=1) for side in (signs > 0, signs < 0))
    return (plus - minus).astype(np.float32)


def update_level(  # noqa: PLR0917 - the terms of a formula
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

    The gradient estimate is `(1 / n') * sum(weight * noise) - weight_decay * theta`. Threads of `pool` change no bit.

    Deviation: the factor 1/sigma of the paper's Algorithm 1 is omitted, as in the authors' code. It would only change
    the relative strength of the weight decay, because Adam is invariant to the scale of the gradient.

    Args:
        level: The level before the update.
        shaped: Shaped fitness [n'], group after group, of the groups with nonzero `signs`.
        signs: Signs [G, M] of each group's members at this level.
        noise_index: Start of each group's slice of `table` [G].
        table: The noise table.
        rule: Weight decay and optimizer.
        learning_rate: Learning rate (alpha).
        pool: Threads for the weighted sum.
    """
    active = signs.any(axis=1)
    if not active.any():
        return LevelUpdate(level=level)
    weights = group_weights(shaped, signs[active]) / np.float32(len(shaped))
    if rule.holds_when_tied and not weights.any():
        return LevelUpdate(level=level, gradient_norm=0.0, update_ratio=0.0)
    indices, middle = noise_index[active], len(weights) // 2
    places = slice(None, middle), slice(middle, None)
    one, other = [weighted_noise_sum(table, indices[half], weights[half], len(level.theta), pool) for half in places]
    gradient = one + other
    norm = _length(gradient)
    if rule.weight_decay:
        gradient -= np.float32(rule.weight_decay) * level.theta
    step, optimizer = rule.optimizer.step(gradient, level.optimizer, learning_rate)
    return LevelUpdate(
        level=replace(level, theta=level.theta + step, optimizer=optimizer),
        gradient_norm=norm,
        halves_cosine=_ratio(float((one.astype(np.float64) * other).sum()), _length(one) * _length(other)),
        update_ratio=_ratio(_length(step), _length(level.theta)),
    )


def _length(vector: F32Array) -> float:
    """Return the Euclidean length of `vector` [D], without BLAS: bit-identical for any number of threads."""
    wide = vector.astype(np.float64)
    return float(np.sqrt((wide * wide).sum()))


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else np.nan
