"""Algorithm 1 of the SHES paper: evolve a controller and a primitive together.

Source: S. Abramowitz and G. Nitschke, "Towards Run-time Efficient Hierarchical Reinforcement Learning", IEEE CEC 2022,
Algorithm 1 and sections II-A, II-E, II-F. `# line k` marks the lines of Algorithm 1; `theta`, `sigma`, `alpha` (the
learning rate), `n` (the population size) and the noise `epsilon` are its symbols. With one level in the state it is
S-ES (Salimans et al. 2017). Every random number comes from (seed, purpose, generation): nothing here depends on how
many workers there are, or on which one does what.
"""

from __future__ import annotations

from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter

from shes.backends.backend import Backend
from shes.es.level import LevelUpdate, TrainState, UpdateRule, draw_noise_index, update_level
from shes.es.noise import NoiseTable
from shes.es.novelty import WeightRule
from shes.es.perturbation import ManyToMany, Perturbation, Signs
from shes.es.schedules import Schedule
from shes.hierarchy.episodes import EpisodeTask, Generation, spread
from shes.hierarchy.fitness import advance_novelty, shaped_fitness
from shes.hierarchy.population import mean_policy_task, members_per_lane, population_tasks
from shes.hierarchy.results import PopulationResults
from shes.types import IntArray

__all__ = ["GenerationReport", "Settings", "evolve", "generation_work"]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The numbers of Algorithm 1."""

    population_size: int
    """Members evaluated in a generation, mirrored ones included (n)."""
    episodes_per_policy: Schedule
    """Episodes that a member's fitness is the mean of (E)."""
    sigma: Schedule
    """Standard deviation of the perturbations."""
    learning_rate: Schedule
    """Rate of the optimizer (alpha)."""
    updates: tuple[UpdateRule, ...]
    """How fitness becomes a step, for each level."""
    learns: tuple[bool, ...]
    """Which levels learn; one that does not is frozen: no perturbation, no update, no new statistics (II-D)."""
    mirrored: str = "quad"
    """How the members of a group mirror its noise (II-F)."""
    perturbation: Perturbation = ManyToMany()
    """Which levels a generation perturbs (II-E)."""
    common_random_numbers: str = "group"
    """Who shares the episodes' seeds: `off`, `group` or `population`."""
    statistics_fraction: float = 1.0
    """Share of the groups, drawn at random, whose observations enter the statistics.

    Deviation: all of them unless the `paper` preset says otherwise (the authors' code: 0.01).
    """
    novelty: WeightRule | None = None
    """How novelty weighs in the first level's fitness, if it does at all."""
    novelty_neighbours: int = 10
    """Places in the archive that novelty is measured from (k)."""

    def signs(self, generation: int) -> Signs:
        """Return the signs [G, M, L] of the members at each level in `generation`."""
        return self.perturbation.signs(generation, self.population_size, self.mirrored, self.learns)

    def episodes(self, generation: int) -> int:
        """Return the episodes of a member in `generation`."""
        return max(1, round(self.episodes_per_policy.value(generation)))


@dataclass(frozen=True, kw_only=True)
class GenerationReport:
    """One generation: the state after it, and what it saw."""

    state: TrainState
    """The state after the update."""
    results: PopulationResults
    """Returns, steps and flags of every episode of the population."""
    updates: tuple[LevelUpdate, ...]
    """What there is to know of the update of each level."""
    signs: Signs
    """Signs of every member at each level [G, M, L]; 0 where it was not perturbed."""
    noise_index: IntArray
    """Start of the noise slice of each group [L, G]."""
    sigma: float
    """Standard deviation of the perturbations."""
    learning_rate: float
    """Rate of the update."""
    rollout_s: float
    """Seconds until the last result."""
    update_s: float
    """Seconds of fitness, gradients, optimizer and statistics."""


def evolve(
    state: TrainState, settings: Settings, table: NoiseTable, backend: Backend, pool: ThreadPoolExecutor | None = None
) -> Generator[GenerationReport, None, None]:
    """Yield a report after every generation, for ever, from `state` on. `pool` shares the gradient's columns."""
    while True:  # line 1
        start, signs = perf_counter(), settings.signs(state.generation)
        alpha = settings.learning_rate.value(state.generation)
        # line 2: n roll-outs, tasks of a few integers each. line 3: sample epsilon, as places in the noise table.
        noise_index, tasks, generation = generation_work(state, settings, table.size)
        # line 3: f = F(theta + epsilon * sigma), for controller and primitive at once.
        backend.broadcast(generation)
        results = PopulationResults.of_tasks(tasks, generation)
        work = spread(tasks, backend.num_workers)
        for task, result in zip(work, backend.map(work), strict=True):
            results.add(task, result)
        rolled_out = perf_counter()
        novelty = advance_novelty(state.novelty, settings.novelty, results, settings.population_size)
        population = results.members(slice(settings.population_size))
        fitness = shaped_fitness(population, signs, settings.updates, novelty, settings.novelty_neighbours)
        # lines 4 and 5: theta += alpha / n * sum(f * epsilon), each level by its own fitness.
        updates = tuple(
            update_level(level, fitness[i], signs[:, :, i], noise_index[i], table, settings.updates[i], alpha, pool)
            for i, level in enumerate(state.levels)
        )
        state = TrainState(
            seed=state.seed,
            generation=state.generation + 1,
            env_steps=state.env_steps + int(results.steps.sum()),
            levels=results.merge_statistics([update.level for update in updates], settings.learns),
            novelty=novelty,
        )
        yield GenerationReport(
            state=state,
            results=population,
            updates=updates,
            signs=signs,
            noise_index=noise_index,
            sigma=generation.sigma,
            learning_rate=alpha,
            rollout_s=rolled_out - start,
            update_s=perf_counter() - rolled_out,
        )


def generation_work(
    state: TrainState, settings: Settings, table_size: int
) -> tuple[IntArray, list[EpisodeTask], Generation]:
    """Return the noise [L, G], the tasks and what they share, of the generation that follows `state`."""
    signs, episodes = settings.signs(state.generation), settings.episodes(state.generation)
    dims = tuple(len(level.theta) for level in state.levels)
    noise_index = draw_noise_index(state.seed, state.generation, len(signs), dims, table_size)
    tasks = population_tasks(
        state, signs, noise_index, episodes, settings.common_random_numbers, settings.statistics_fraction
    )
    shared = members_per_lane(signs.shape[1], episodes)
    if settings.novelty is not None:
        tasks.append(mean_policy_task(state, settings.population_size, episodes, shared))
    sigma = settings.sigma.value(state.generation)
    return noise_index, tasks, Generation.of_training(state, sigma, episodes, settings.learns, shared)
