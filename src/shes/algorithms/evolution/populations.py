"""What a generation of Algorithm 1 is made of: the settings, the populations that are rolled out, their updates.

Source: SHES paper, Algorithm 1; learning specification, section 2 (a primitive that is judged by intervals).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from shes.algorithms.roll_out import roll_out_tasks
from shes.backends.backend import Backend
from shes.es.level import LevelState, LevelUpdate, TrainState, UpdateRule, draw_noise_index, update_level
from shes.es.noise import NoiseTable
from shes.es.novelty import NoveltyState, WeightRule
from shes.es.perturbation import ManyToMany, Perturbation, Signs
from shes.es.schedules import Schedule
from shes.hierarchy.episodes import Generation
from shes.hierarchy.fitness import shaped_fitness
from shes.hierarchy.intervals import IntervalEstimate, branch_work, noted_steps
from shes.hierarchy.population import Work, mean_policy_task, members_per_lane, population_tasks
from shes.hierarchy.results import PopulationResults

__all__ = ["Population", "Settings", "generation_work", "roll_out", "roll_out_branches"]


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
    intervals: IntervalEstimate | None = None
    """How the primitive is judged by intervals; by whole episodes, as every other level, if None."""
    horizon: int = 500
    """Control steps of a whole episode."""

    @property
    def by_episodes(self) -> tuple[bool, ...]:
        """Which levels learn, and are judged by whole episodes."""
        return self.learns if self.intervals is None else (*self.learns[:-1], False)

    def signs(self, generation: int) -> Signs:
        """Return the signs [G, M, L] of the members judged by whole episodes at each level in `generation`."""
        return self.perturbation.signs(generation, self.population_size, self.mirrored, self.by_episodes)

    def episodes(self, generation: int) -> int:
        """Return the episodes of a member in `generation`."""
        return max(1, round(self.episodes_per_policy.value(generation)))


@dataclass(frozen=True, kw_only=True)
class Population:
    """Members of one kind, and what came of them: whole episodes, or pairs on branches."""

    work: Work
    """Their noise, signs and roll-outs."""
    results: PopulationResults
    """Returns, steps and flags of every episode."""
    rules: tuple[UpdateRule, ...]
    """How fitness becomes a step, for each of their levels."""
    learns: tuple[bool, ...]
    """Which of their levels take in what was observed."""
    learning_rate: float
    """Rate of the update."""

    @property
    def is_branched(self) -> bool:
        """Whether these are pairs on branches."""
        return self.work.generation.branch_steps > 0

    @property
    def num_steps(self) -> int:
        """Environment steps of all episodes."""
        return int(self.results.steps.sum())

    @property
    def members(self) -> PopulationResults:
        """What came of the members alone: not of the mean policies, which novelty runs beside them."""
        return self.results.members(slice(self.work.signs.shape[0] * self.work.signs.shape[1]))

    def merge_statistics(self, levels: Iterable[LevelState]) -> tuple[LevelState, ...]:
        """Return `levels` with what was observed in the statistics of those that learn."""
        return self.results.merge_statistics(tuple(levels), self.learns)

    def update(
        self,
        levels: Sequence[LevelState],
        table: NoiseTable,
        pool: ThreadPoolExecutor | None,
        novelty: NoveltyState | None = None,
        neighbours: int = 1,
    ) -> tuple[LevelUpdate, ...]:
        """Return the update of each of `levels` by its own fitness, and by novelty for the first if there is any."""
        signs, noise_index = self.work.signs, self.work.noise_index
        fitness = shaped_fitness(self.members, signs, self.rules, novelty, neighbours)
        return tuple(
            update_level(level, fitness[i], signs[:, :, i], noise_index[i], table, rule, self.learning_rate, pool)
            for i, (level, rule) in enumerate(zip(levels, self.rules, strict=True))
        )


def generation_work(state: TrainState, settings: Settings, table_size: int) -> Work:
    """Return the first roll-outs of the generation that follows `state`; a primitive alone may have branches only."""
    estimate, goals_noted, noted = settings.intervals, 0, list[int]()
    if estimate is not None and len(state.levels) == 1:
        return branch_work(state, estimate, table_size)
    signs, episodes = settings.signs(state.generation), settings.episodes(state.generation)
    dims = tuple(len(level.theta) for level in state.levels)
    # line 3: sample epsilon, as places in the noise table.
    noise_index = draw_noise_index(state.seed, state.generation, len(signs), dims, table_size)
    if estimate is not None:
        goals_noted = estimate.intervals
        noted = noted_steps(state, settings.population_size * episodes, settings.horizon, estimate.controller_interval)
    # line 2: n roll-outs, tasks of a few integers each.
    tasks = population_tasks(
        state, signs, noise_index, episodes, settings.common_random_numbers, settings.statistics_fraction, noted
    )
    shared = members_per_lane(signs.shape[1], episodes)
    if settings.novelty is not None:
        tasks.append(mean_policy_task(state, settings.population_size, episodes, shared))
    sigma = settings.sigma.value(state.generation)
    generation = Generation.of_training(state, sigma, episodes, settings.by_episodes, shared, goals_noted)
    return Work(signs=signs, noise_index=noise_index, tasks=tasks, generation=generation)


def roll_out(state: TrainState, settings: Settings, table: NoiseTable, backend: Backend) -> Population:
    """Return the first population of the generation that follows `state`, rolled out."""
    work, estimate = generation_work(state, settings, table.size), settings.intervals
    if estimate is not None and work.generation.branch_steps:
        return _branches(state, estimate, work, backend)
    return Population(
        work=work,
        # line 3: f = F(theta + epsilon * sigma), for every level at once.
        results=roll_out_tasks(work.tasks, work.generation, backend),
        rules=settings.updates,
        learns=settings.by_episodes,
        learning_rate=settings.learning_rate.value(state.generation),
    )


def roll_out_branches(
    state: TrainState, settings: Settings, table: NoiseTable, backend: Backend, episodes: Population
) -> Population | None:
    """Return the pairs that branch off what whole `episodes` left, rolled out; None where no primitive is judged so."""
    estimate = settings.intervals
    if estimate is None or episodes.is_branched:
        return None
    left = list(episodes.results.snapshots.values())
    return _branches(state, estimate, branch_work(state, estimate, table.size, left), backend)


def _branches(state: TrainState, estimate: IntervalEstimate, work: Work, backend: Backend) -> Population:
    """Return the pairs of `work`, rolled out."""
    return Population(
        work=work,
        results=roll_out_tasks(work.tasks, work.generation, backend),
        rules=(estimate.update,),
        learns=(True,),
        learning_rate=estimate.learning_rate.value(state.generation),
    )
