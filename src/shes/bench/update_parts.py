"""The parts of a generation's update of all learning levels, each timed separately."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from shes.bench.evolution import GenerationReport
from shes.es.gradient import group_weights, weighted_noise_sum
from shes.es.level import LevelState, TrainState, UpdateRule, draw_noise_index
from shes.es.noise import NoiseTable
from shes.types import F64Array, IntArray

_T = TypeVar("_T")


@dataclass(frozen=True, kw_only=True)
class LearningLevel:
    """A learning level and the inputs of its update."""

    level: LevelState
    """The level before the update."""
    rule: UpdateRule
    fitness: F64Array
    """Fitness of every member [n]."""
    signs: NDArray[np.int8]
    """Signs of the level's noise, for the members of each group [G, M]."""
    noise_index: IntArray
    """Start of each group's slice of the noise table [G]."""
    learning_rate: float


def learning_levels(state: TrainState, report: GenerationReport, table_size: int) -> list[LearningLevel]:
    """Return the levels of `state` that learn, with the inputs of their update in `report`.

    Their noise is taken from other slices of the table, because those of the update are still in the caches.
    """
    learning: list[LearningLevel] = []
    for number, (level, (population, place)) in enumerate(zip(state.levels, report.sources, strict=True)):
        signs, dims = population.work.signs[:, :, place], (len(level.theta),)
        if not signs.any():
            continue
        learning.append(
            LearningLevel(
                level=level,
                rule=population.rules[place],
                fitness=population.results.fitness[place],
                signs=signs,
                noise_index=draw_noise_index(
                    state.seed + 1, state.generation, len(signs), dims, table_size, first_level=number
                )[0],
                learning_rate=population.learning_rate,
            )
        )
    return learning


def time_parts(
    levels: Sequence[LearningLevel], table: NoiseTable, pool: ThreadPoolExecutor, times: dict[str, list[float]]
) -> None:
    """Update `levels` part by part, and append the milliseconds of each part to `times`."""
    shaped = timed(times["rank_ms"], lambda: [each.rule.shaping(each.fitness) for each in levels])
    weights = [group_weights(values, each.signs) for values, each in zip(shaped, levels, strict=True)]
    gradients = timed(
        times["gradient_ms"],
        lambda: [
            weighted_noise_sum(table, each.noise_index, own, len(each.level.theta), pool)
            for own, each in zip(weights, levels, strict=True)
        ],
    )
    timed(
        times["optimizer_ms"],
        lambda: [
            each.rule.optimizer.step(gradient, each.level.optimizer, each.learning_rate)
            for gradient, each in zip(gradients, levels, strict=True)
        ],
    )


def timed(times: list[float], work: Callable[[], _T]) -> _T:
    """Return the result of `work`, and append its milliseconds to `times`."""
    start = perf_counter()
    result = work()
    times.append(1000 * (perf_counter() - start))
    return result
