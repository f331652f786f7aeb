"""Algorithm 1 of the SHES paper: evolve a controller and a primitive together.

Source: S. Abramowitz and G. Nitschke, "Towards Run-time Efficient Hierarchical Reinforcement Learning", IEEE CEC 2022,
Algorithm 1 and sections II-A, II-E, II-F. `# line k` marks the lines of Algorithm 1. `theta`, `sigma`, `alpha` (the
learning rate), `n` (the population size) and the noise `epsilon` are its symbols. With a single level it is S-ES
(Salimans et al. 2017). Random numbers derive from (seed, purpose, generation), so they do not depend on the workers.
"""

from __future__ import annotations

from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from time import perf_counter

from shes.backends.backend import Backend
from shes.es.level import LevelUpdate, update_level
from shes.es.noise import NoiseTable
from shes.evolution.estimates import Draws, Hyperparameters, Population, draw_pairs, next_running
from shes.evolution.state import TrainState
from shes.evolution.way_search import explore
from shes.rollout.roll_out import roll_out_tasks


@dataclass(frozen=True, kw_only=True)
class GenerationReport:
    """Result of one generation."""

    state: TrainState
    populations: tuple[Population, ...]
    """The members evaluated by whole episodes, then the pairs of a primitive that is evaluated by intervals."""
    sources: tuple[tuple[Population, int], ...]
    """For each level the population that evaluates it, and the level's place there."""
    updates: tuple[LevelUpdate, ...]
    rollout_s: float
    """Duration of the rollouts in seconds."""
    update_s: float
    """Duration of fitness, gradients, optimizer and statistics in seconds."""


def sources_of_fitness(populations: tuple[Population, ...]) -> tuple[tuple[Population, int], ...]:
    """Return for each level the last population that evaluates it, and the level's place there."""
    sources = {level: (each, i) for each in populations for i, level in enumerate(each.levels)}
    return tuple(sources[level] for level in sorted(sources))


def roll_out(draws: Draws, backend: Backend) -> Population:
    """Return the members with the results of their episodes."""
    return Population(**vars(draws), results=roll_out_tasks(draws.tasks, draws.generation, backend))


def evolve(
    state: TrainState,
    settings: Hyperparameters,
    table: NoiseTable,
    backend: Backend,
    pool: ThreadPoolExecutor | None = None,
) -> Generator[GenerationReport, None, None]:
    """Yield a report after every generation from `state` on, indefinitely. `pool` computes gradients in parallel."""
    while True:  # line 1
        start = perf_counter()
        # Not in the paper: a search by the mean primitive for a way to the target, which then guides the controllers.
        if state.generation >= settings.practice:
            state = explore(state, settings.search, backend)
        populations = tuple[Population, ...]()
        for draw in settings.estimates:  # whole episodes; not in the paper: a primitive may be evaluated by intervals
            draws = draw(state, settings, table.size, populations)  # line 2: n perturbations, sigma * epsilon
            populations += (roll_out(draws, backend),)  # line 3: f = F(theta + sigma * epsilon), for every level
        rolled_out, sources, updates = perf_counter(), sources_of_fitness(populations), list[LevelUpdate]()
        levels = zip(state.levels, settings.updates, settings.learns, sources, strict=True)
        for level, rule, learns, (source, i) in levels:  # each level has its own fitness
            results, signs, noise_index = source.results, source.signs[:, :, i], source.noise_index[i]
            statistics = level.statistics.merge(**vars(results.statistics[i])) if learns else level.statistics
            observed = replace(level, statistics=statistics)
            # lines 4 and 5: theta += alpha / n * sum(f * epsilon), where f is ranked and shaped.
            fitness = rule.shape(results.fitness[i], signs, results.fall.mean(axis=1))
            updates.append(update_level(observed, fitness, signs, noise_index, table, rule, source.learning_rate, pool))
        state = replace(
            state,
            generation=state.generation + 1,
            env_steps=state.env_steps + sum(int(each.results.steps.sum()) for each in populations),
            levels=tuple(update.level for update in updates),
            running=next_running(populations[-1], settings.horizon) if settings.estimates[-1] is draw_pairs else None,
        )
        yield GenerationReport(
            state=state,
            populations=populations,
            sources=sources,
            updates=tuple(updates),
            rollout_s=rolled_out - start,
            update_s=perf_counter() - rolled_out,
        )
