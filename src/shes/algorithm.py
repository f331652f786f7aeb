"""Algorithm 1 of the SHES paper: evolve a controller and a primitive together.

Source: S. Abramowitz and G. Nitschke, "Towards Run-time Efficient Hierarchical Reinforcement Learning", IEEE CEC 2022,
Algorithm 1 and sections II-A, II-E, II-F. `# line k` marks the lines of Algorithm 1; `theta`, `sigma`, `alpha` (the
learning rate), `n` (the population size) and the noise `epsilon` are its symbols. Every random number comes from
(seed, purpose, generation): nothing here depends on how many workers there are, or on which one does what.
"""

from __future__ import annotations

from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter

from shes.backends.backend import Backend
from shes.es.level import LevelParameters, TrainState, UpdateRule, draw_noise_index, update_level
from shes.es.mirror import check_population, sign_matrix
from shes.es.noise import NoiseTable
from shes.es.streams import Purpose, stream
from shes.hierarchy.episodes import EpisodeTask, Generation, PopulationResults, spread
from shes.types import IntArray

__all__ = ["GenerationReport", "Settings", "evolve", "population_tasks", "sample_noise"]


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The numbers of Algorithm 1."""

    population_size: int
    """Policy pairs evaluated in a generation, mirrored ones included (n)."""
    episodes_per_policy: int
    """Episodes that a pair's fitness is the mean of (E)."""
    sigma: float
    """Standard deviation of the perturbations."""
    update: UpdateRule
    """How fitness becomes a step; holds the learning rate (alpha)."""
    mirrored: str = "quad"
    """How the members of a group mirror its noise (section II-F)."""
    has_common_random_numbers: bool = True
    """Whether the members of a group share their episodes' seeds.

    Deviation: on unless the `paper` preset says otherwise (the authors' code: every member draws its own), because it
    takes the difference between episodes out of the comparison within a group.
    """
    statistics_fraction: float = 1.0
    """Share of the groups, drawn at random, whose observations enter the statistics.

    Deviation: all of them unless the `paper` preset says otherwise (the authors' code: 0.01).
    """


@dataclass(frozen=True, kw_only=True)
class GenerationReport:
    """One generation: the state after it, and what it saw."""

    state: TrainState
    """The state after the update."""
    results: PopulationResults
    """Returns, steps and flags of every episode."""
    noise_index: IntArray
    """Start of the noise slice of each group [L, G]."""
    rollout_s: float
    """Seconds until the last result."""
    update_s: float
    """Seconds of ranks, gradients, Adam and statistics."""


def evolve(
    state: TrainState, settings: Settings, table: NoiseTable, backend: Backend, pool: ThreadPoolExecutor | None = None
) -> Generator[GenerationReport, None, None]:
    """Yield a report after every generation, for ever, from `state` on. `pool` shares the gradient's columns."""
    signs = sign_matrix(settings.mirrored, len(state.levels))
    while True:  # line 1
        start = perf_counter()
        # line 2: n roll-outs, tasks of a few integers each. line 3: sample epsilon, as places in the noise table.
        noise_index = sample_noise(state, settings, table)
        tasks = spread(population_tasks(state, settings, noise_index), backend.num_workers)
        # line 3: f = F(theta + epsilon * sigma), for controller and primitive at once.
        backend.broadcast(Generation(levels=_freeze(state), sigma=settings.sigma, is_evaluation=False))
        results = PopulationResults.empty(len(state.levels), settings.population_size, settings.episodes_per_policy)
        for task, result in zip(tasks, backend.map(tasks), strict=True):
            results.add(task, result)
        evaluated = perf_counter()
        # lines 4 and 5: theta += alpha / n * sum(f * epsilon), each level by its own fitness.
        levels = tuple(
            update_level(level, fitness, signs[:, i], noise_index[i], table, settings.update, pool)
            for i, (level, fitness) in enumerate(zip(state.levels, results.fitness, strict=True))
        )
        state = TrainState(
            seed=state.seed,
            generation=state.generation + 1,
            env_steps=state.env_steps + int(results.steps.sum()),
            levels=results.merge_statistics(levels),
        )
        updated = perf_counter()
        yield GenerationReport(
            state=state,
            results=results,
            noise_index=noise_index,
            rollout_s=evaluated - start,
            update_s=updated - evaluated,
        )


def sample_noise(state: TrainState, settings: Settings, table: NoiseTable) -> IntArray:
    """Return where each group's noise starts in the table, one row per level [L, G]."""
    groups = check_population(settings.population_size, settings.mirrored, len(state.levels))
    dims = tuple(len(level.theta) for level in state.levels)
    return draw_noise_index(state.seed, state.generation, groups, dims, table.size)


def population_tasks(state: TrainState, settings: Settings, noise_index: IntArray) -> list[EpisodeTask]:
    """Return the task of every member: its group's noise, its own signs, its episodes' seeds."""
    signs = sign_matrix(settings.mirrored, len(state.levels))
    members, groups = len(signs), noise_index.shape[1]
    episodes = settings.episodes_per_policy
    rng = stream(state.seed, Purpose.TRAINING_EPISODES, state.generation)
    seeds = rng.integers(0, 2**63, (groups, 1 if settings.has_common_random_numbers else members, episodes))
    sampler = stream(state.seed, Purpose.STATISTICS_SAMPLE, state.generation)
    records = [sampler.random() < settings.statistics_fraction for _ in range(groups)]
    return [
        EpisodeTask(
            member=group * members + member,
            noise_index=tuple(noise_index[:, group].tolist()),
            signs=tuple(signs[member].tolist()),
            slots=tuple(range(episodes)),
            seeds=tuple(seeds[group, member % seeds.shape[1]].tolist()),
            records_statistics=records[group],
        )
        for group in range(groups)
        for member in range(members)
    ]


def _freeze(state: TrainState) -> tuple[LevelParameters, ...]:
    """Return what the workers need of every level."""
    return tuple(LevelParameters.of(level.theta, level.statistics) for level in state.levels)
