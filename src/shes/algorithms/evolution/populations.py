"""The parts of a generation of Algorithm 1: hyperparameters, populations, their rollouts and updates.

Source: SHES paper, Algorithm 1; `docs/learning.md` (the primitive evaluated by intervals).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from shes.algorithms.evolution.way_search import WaySearch
from shes.algorithms.roll_out import roll_out_tasks
from shes.backends.backend import Backend
from shes.es.level import (
    LevelParameters,
    LevelState,
    LevelUpdate,
    TrainState,
    UpdateRule,
    draw_noise_index,
    update_level,
)
from shes.es.noise import NoiseTable
from shes.es.perturbation import ManyToMany, Perturbation, Signs
from shes.es.schedules import Schedule
from shes.hierarchy.episodes import Generation
from shes.hierarchy.fitness import shaped_fitness
from shes.hierarchy.intervals import IntervalEstimate, branch_work, draw_snapshot_steps
from shes.hierarchy.population_tasks import Work, members_per_lane, population_tasks
from shes.hierarchy.results import PopulationResults


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """Hyperparameters of Algorithm 1."""

    population_size: int
    """Number of members per generation, including mirrored ones (n)."""
    episodes_per_policy: Schedule
    """Number of episodes per member (E). The fitness is their mean return."""
    sigma: Schedule
    """Standard deviation of the perturbations."""
    learning_rate: Schedule
    """Learning rate (alpha)."""
    updates: tuple[UpdateRule, ...]
    learns: tuple[bool, ...]
    """Whether each level learns. A frozen level has no perturbation, update or new statistics (II-D)."""
    mirrored: str = "quad"
    """How the members of a group mirror its noise (II-F)."""
    perturbation: Perturbation = ManyToMany()
    """Which levels a generation perturbs (II-E)."""
    common_random_numbers: str = "group"
    """Which members share episode seeds: `off`, `group` or `population`."""
    statistics_fraction: float = 1.0
    """Fraction of the groups, chosen at random, whose observations enter the statistics.

    Deviation: all of them, except in the preset `paper` (authors' code: 0.01).
    """
    intervals: IntervalEstimate | None = None
    """How the primitive is evaluated by intervals; None if it is evaluated by whole episodes."""
    search: WaySearch | None = None
    """Search for a way to the target; None for no search."""
    horizon: int = 500
    """Maximum number of control steps in an episode."""

    @property
    def by_episodes(self) -> tuple[bool, ...]:
        """Whether each level learns from whole episodes."""
        return self.learns if self.intervals is None else (*self.learns[:-1], False)

    def signs(self, generation: int) -> Signs:
        """Return the signs [G, M, L] of the members that are evaluated by whole episodes."""
        return self.perturbation.signs(generation, self.population_size, self.mirrored, self.by_episodes)

    def episodes(self, generation: int) -> int:
        """Return the number of episodes per member in `generation`."""
        return max(1, round(self.episodes_per_policy.value(generation)))


@dataclass(frozen=True, kw_only=True)
class Population:
    """Members and their results: from whole episodes, or pairs on branches."""

    work: Work
    results: PopulationResults
    rules: tuple[UpdateRule, ...]
    """Update rule of each of their levels."""
    learns: tuple[bool, ...]
    """Whether the observations enter the statistics of each of their levels."""
    learning_rate: float

    @property
    def is_branched(self) -> bool:
        """Whether the members are pairs on branches."""
        return self.work.generation.branch_steps > 0

    @property
    def num_steps(self) -> int:
        """Number of environment steps of all episodes."""
        return int(self.results.steps.sum())

    def merge_statistics(self, levels: Iterable[LevelState]) -> tuple[LevelState, ...]:
        """Return `levels` with the new observations in the statistics of the levels that learn."""
        return self.results.merge_statistics(tuple(levels), self.learns)

    def update(
        self,
        levels: Sequence[LevelState],
        table: NoiseTable,
        pool: ThreadPoolExecutor | None,
    ) -> tuple[LevelUpdate, ...]:
        """Return the update of each of `levels` by its own fitness."""
        signs, noise_index = self.work.signs, self.work.noise_index
        fitness = shaped_fitness(self.results, signs, self.rules)
        return tuple(
            update_level(level, fitness[i], signs[:, :, i], noise_index[i], table, rule, self.learning_rate, pool)
            for i, (level, rule) in enumerate(zip(levels, self.rules, strict=True))
        )


def generation_work(state: TrainState, hyperparameters: Hyperparameters, table_size: int) -> Work:
    """Return the first rollouts of the generation that follows `state`.

    They are whole episodes, or branches if a primitive alone is evaluated by intervals.
    """
    estimate, snapshot_goals, noted = hyperparameters.intervals, 0, list[int]()
    if estimate is not None and len(state.levels) == 1:
        return branch_work(state, estimate, table_size)
    signs, episodes = hyperparameters.signs(state.generation), hyperparameters.episodes(state.generation)
    levels = LevelParameters.of_all(state.levels)
    is_searching = state.archive is not None and not state.archive.way_steps
    if is_searching:  # the reward would keep controllers, and the primitive with them, in a dead end: goals wander
        levels = (*(level.at_zero() for level in levels[:-1]), levels[-1])
        signs[:, :, :-1] = 0
    are_same = is_searching and not hyperparameters.by_episodes[-1]  # all members are the mean policies
    dims = [len(level.theta) for level in state.levels]
    # line 3: sample epsilon, as places in the noise table.
    noise_index = draw_noise_index(state.seed, state.generation, len(signs), dims, table_size)
    if estimate is not None:
        snapshot_goals, num_episodes = estimate.intervals, hyperparameters.population_size * episodes
        noted = draw_snapshot_steps(state, num_episodes, hyperparameters.horizon, estimate.controller_interval)
    # line 2: n rollouts, as tasks of a few integers each.
    tasks = population_tasks(
        state,
        signs,
        noise_index,
        episodes,
        "off" if are_same else hyperparameters.common_random_numbers,
        hyperparameters.statistics_fraction,
        noted,
    )
    shared = members_per_lane(signs.shape[1], episodes)
    generation = Generation(
        levels=levels,
        sigma=hyperparameters.sigma.value(state.generation),
        episodes_per_policy=episodes,
        is_evaluation=False,
        members_per_lane=shared,
        has_frozen_control=not hyperparameters.by_episodes[-1],
        snapshot_goals=snapshot_goals,
        decisions="wander" if is_searching else None,
        way=None if state.archive is None else state.archive.waypoints,
    )
    return Work(signs=signs, noise_index=noise_index, tasks=tasks, generation=generation)


def roll_out(state: TrainState, hyperparameters: Hyperparameters, table: NoiseTable, backend: Backend) -> Population:
    """Return the results of the first rollouts of the generation that follows `state`."""
    work, estimate = generation_work(state, hyperparameters, table.size), hyperparameters.intervals
    if estimate is not None and work.generation.branch_steps:
        return _roll_out_pairs(state, estimate, work, backend)
    return Population(
        work=work,
        # line 3: f = F(theta + epsilon * sigma), for every level at once.
        results=roll_out_tasks(work.tasks, work.generation, backend),
        rules=hyperparameters.updates,
        learns=hyperparameters.by_episodes,
        learning_rate=hyperparameters.learning_rate.value(state.generation),
    )


def roll_out_branches(
    state: TrainState, hyperparameters: Hyperparameters, table: NoiseTable, backend: Backend, episodes: Population
) -> Population | None:
    """Return the results of pairs that branch off whole `episodes`; None if the primitive is evaluated otherwise."""
    estimate = hyperparameters.intervals
    if estimate is None or episodes.is_branched:
        return None
    snapshots = list(episodes.results.snapshots.values())
    return _roll_out_pairs(state, estimate, branch_work(state, estimate, table.size, snapshots), backend)


def _roll_out_pairs(state: TrainState, estimate: IntervalEstimate, work: Work, backend: Backend) -> Population:
    return Population(
        work=work,
        results=roll_out_tasks(work.tasks, work.generation, backend),
        rules=(estimate.update,),
        learns=(True,),
        learning_rate=estimate.learning_rate.value(state.generation),
    )
