"""The parts of a generation's update, of all levels that learn: each is done and timed by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from shes.algorithms.evolution.algorithm import GenerationReport
from shes.es.gradient import group_weights, weighted_noise_sum
from shes.es.level import LevelState, TrainState, UpdateRule, draw_noise_index
from shes.es.noise import NoiseTable
from shes.types import F64Array, IntArray

__all__ = ["LearningLevel", "learning_levels", "time_parts", "timed"]

_T = TypeVar("_T")


@dataclass(frozen=True, kw_only=True)
class LearningLevel:
    """A level that learns, and what it is updated from."""

    level: LevelState
    """The level before."""
    rule: UpdateRule
    """How fitness becomes a step."""
    fitness: F64Array
    """Fitness of every member [n]."""
    signs: NDArray[np.int8]
    """Signs that the members of each group give to the level's noise [G, M]."""
    noise_index: IntArray
    """Start of each group's slice of the noise table [G]."""
    learning_rate: float
    """The optimizer's rate."""


def learning_levels(state: TrainState, report: GenerationReport, table_size: int) -> list[LearningLevel]:
    """Return the levels of `state` that learn, and what `report` updated them from, but for the noise.

    They get other slices of the table: those that the update has just read are still in the caches.
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
                fitness=population.members.fitness[place],
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
    """Do the update of `levels` part by part, and add the milliseconds of each part to `times`."""
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
    """Return what `work` does, and add to `times` how many milliseconds it took."""
    start = perf_counter()
    result = work()
    times.append(1000 * (perf_counter() - start))
    return result
