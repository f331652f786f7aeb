"""The populations of a generation: what is drawn for their members, by whole episodes or by intervals.

An episode evaluates every level that it perturbs (SHES paper, Algorithm 1). The interval estimate evaluates a primitive
alone: a mirrored pair plays the next intervals from the same physics state on the same goals. The two differ only in
their perturbation, and an environment step evaluates many more directions than in whole episodes. Under a controller,
pairs branch off snapshots of the whole episodes. If the environment sets the goals, pairs continue from the end of an
earlier pair, in episodes that run from generation to generation.

Source: SHES paper, II-A, II-E, II-F; `docs/learning.md` (intervals); compare the "vine" estimate of Schulman et al.
2015 (TRPO), section 5.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from shes.es.level import LevelParameters, UpdateRule, draw_noise_index, select_fitness
from shes.es.perturbation import ManyToMany, Perturbation, Signs
from shes.es.schedules import Schedule
from shes.evolution.state import RunningEpisodes, TrainState
from shes.evolution.way_search import WaySearch
from shes.rollout.episodes import EpisodeTask, Generation, Snapshot
from shes.rollout.roll_out import PopulationResults
from shes.streams import Purpose, stream
from shes.types import F64Array, IntArray

_ENOUGH_ROWS = 3
"""Number of episodes per member from which each member has a matmul of its own.

A matmul shared by several members always has the rows of all of them. On a cluster, where a worker may run only a few
episodes, this would cost more than it saves.
"""
COMMON_RANDOM_NUMBERS = ("off", "group", "population")
"""Which members share episode seeds: none, those of a mirrored group, or the whole population.

Deviation: `group`, except in the preset `paper`, because it removes the variation between episodes from the comparison
within a group. In the authors' code every member draws its own seeds.
"""


@dataclass(frozen=True, kw_only=True)
class IntervalEstimate:
    """Hyperparameters of the interval estimate of the primitive, the last level."""

    population_size: int
    """Number of members per generation (2 G)."""
    intervals: int
    """Number of intervals in a branch. With two or more, the state at the end of an interval affects the fitness."""
    controller_interval: int
    goal_distance: float
    """Half width in metres of the square from which goals are drawn if there is no snapshot."""
    sigma: Schedule
    learning_rate: Schedule

    @property
    def num_pairs(self) -> int:
        """Number of mirrored pairs per generation, G."""
        return self.population_size // 2


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """Hyperparameters of Algorithm 1."""

    population_size: int
    """Number of members per generation, including mirrored ones (n)."""
    episodes_per_policy: int
    """Number of episodes per member (E). The fitness is their mean return."""
    sigma: Schedule
    """Standard deviation of the perturbations."""
    learning_rate: Schedule
    """Learning rate (alpha)."""
    updates: tuple[UpdateRule, ...]
    """Update rule of each level."""
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
        last = len(self.learns) - 1
        return tuple(learns and (self.intervals is None or i < last) for i, learns in enumerate(self.learns))

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """The functions that draw the populations of a generation, in order."""
        if self.intervals is None:
            return (draw_episodes,)
        return (draw_pairs,) if len(self.learns) == 1 else (draw_episodes, draw_pairs)

    @property
    def has_running_episodes(self) -> bool:
        """Whether episodes continue from generation to generation."""
        return self.estimates == (draw_pairs,)

    def signs(self, generation: int) -> Signs:
        """Return the signs [G, M, L] of the members that are evaluated by whole episodes."""
        return self.perturbation.signs(generation, self.population_size, self.mirrored, self.by_episodes)


@dataclass(frozen=True, kw_only=True)
class Draws:
    """The members of a population and their episodes, drawn but not yet rolled out."""

    levels: tuple[int, ...]
    """Indices in the state of the L levels that members have."""
    signs: Signs
    """Signs of every member at each level [G, M, L]; 0 for no perturbation."""
    noise_index: IntArray
    """Start of the noise slice of each group [L, G]."""
    tasks: list[EpisodeTask]
    """The episodes, in the order of the members."""
    generation: Generation
    """Data that all tasks share."""
    learning_rate: float
    """Learning rate of the levels that learn from this population."""


@dataclass(frozen=True, kw_only=True)
class Population(Draws):
    """A population and the results of its episodes."""

    results: PopulationResults

    def shaped_fitness(self, level: int, rule: UpdateRule) -> F64Array:
        """Return the shaped fitness [n'] of the members that perturb the level at place `level` of `levels`.

        Source: SHES paper, II-A: each level has its own fitness.
        """
        signs = self.signs[:, :, level]
        fitness = select_fitness(self.results.fitness[level], signs)
        if not len(fitness):
            return fitness
        shaped = rule.shaping(fitness)
        if rule.fall_price:
            falls = select_fitness(self.results.has_fallen.mean(axis=1), signs)
            shaped = shaped - rule.fall_price * (falls - falls.mean())
        return shaped


def draw_episodes(
    state: TrainState,
    settings: Hyperparameters,
    table_size: int,
    before: Sequence[Population] = (),  # noqa: ARG001 - the signature of an `Estimate`
) -> Draws:
    """Return the members that whole episodes evaluate in the generation that follows `state`."""
    estimate, generation = settings.intervals, state.generation
    signs, episodes, levels = settings.signs(generation).copy(), settings.episodes_per_policy, state.levels
    parameters = LevelParameters.of_all(levels)
    is_searching = state.archive is not None and not state.archive.way_steps
    if is_searching:  # the reward would keep controllers, and the primitive with them, in a dead end: goals wander
        parameters = (*(level.at_zero() for level in parameters[:-1]), parameters[-1])
        signs[:, :, :-1] = 0
    are_same = is_searching and not settings.by_episodes[-1]  # all members are the mean policies
    noise_index = draw_noise_index(
        state.seed, generation, len(signs), [len(level.theta) for level in levels], table_size
    )
    snapshot_steps = list[int]()
    if estimate is not None:
        num_episodes = settings.population_size * episodes
        snapshot_steps = draw_snapshot_steps(state, num_episodes, settings.horizon, estimate.controller_interval)
    return Draws(
        levels=tuple(range(len(levels))),
        signs=signs,
        noise_index=noise_index,
        tasks=_episode_tasks(
            state,
            signs,
            noise_index,
            episodes,
            "off" if are_same else settings.common_random_numbers,
            settings.statistics_fraction,
            snapshot_steps,
        ),
        generation=Generation(
            levels=parameters,
            sigma=settings.sigma.value(generation),
            episodes_per_policy=episodes,
            is_evaluation=False,
            members_per_lane=members_per_lane(signs.shape[1], episodes),
            has_frozen_control=not settings.by_episodes[-1],
            snapshot_goals=0 if estimate is None else estimate.intervals,
            decisions="wander" if is_searching else None,
            way=None if state.archive is None else state.archive.waypoints,
        ),
        learning_rate=settings.learning_rate.value(generation),
    )


def _episode_tasks(
    state: TrainState,
    signs: Signs,
    noise_index: IntArray,
    episodes: int,
    common_random_numbers: str,
    statistics_fraction: float,
    snapshot_steps: Sequence[int],
) -> list[EpisodeTask]:
    """Return the tasks of all members; `snapshot_steps` [G * M * E] are those before each snapshot, if any."""
    groups, members, _ = signs.shape
    rng = stream(state.seed, Purpose.TRAINING_EPISODES, state.generation)
    shares = {"off": (groups, members), "group": (groups, 1), "population": (1, 1)}[common_random_numbers]
    seeds = np.broadcast_to(rng.integers(0, 2**63, (*shares, episodes)), (groups, members, episodes))
    sampler = stream(state.seed, Purpose.STATISTICS_SAMPLE, state.generation)
    records = [sampler.random() < statistics_fraction for _ in range(groups)]
    in_lane = members_per_lane(members, episodes)
    return [
        EpisodeTask(
            member=group * members + first,
            noise_index=tuple(noise_index[:, group].tolist()),
            signs=tuple(tuple(own) for own in signs[group, first : first + in_lane].tolist()),
            slots=tuple(range(in_lane * episodes)),
            seeds=tuple(seeds[group, first : first + in_lane].ravel().tolist()),
            records_statistics=records[group],
            snapshot_steps=tuple(snapshot_steps[(group * members + first) * episodes :][: in_lane * episodes]),
        )
        for group in range(groups)
        for first in range(0, members, in_lane)
    ]


def members_per_lane(members: int, episodes: int) -> int:
    """Return how many of the `members` of a group share a matmul, M': all of them if E (`episodes`) is small."""
    return members if episodes < _ENOUGH_ROWS else 1


def draw_snapshot_steps(state: TrainState, num_episodes: int, horizon: int, controller_interval: int) -> list[int]:
    """Return for each of `num_episodes` whole episodes the number of steps, at a decision, before its snapshot."""
    decisions = -(-horizon // controller_interval)
    rng = stream(state.seed, Purpose.SNAPSHOTS, state.generation)
    return (controller_interval * rng.integers(0, decisions, num_episodes)).tolist()


def draw_pairs(
    state: TrainState, settings: Hyperparameters, table_size: int, before: Sequence[Population] = ()
) -> Draws:
    """Return the mirrored pairs that intervals evaluate in the generation that follows `state`.

    They start from snapshots of the whole episodes `before`; without such episodes, running ones continue.
    """
    estimate, generation = settings.intervals, state.generation
    assert estimate is not None, "pairs belong to an interval estimate"
    groups, level = estimate.num_pairs, len(state.levels) - 1
    primitive = state.levels[level]
    noise_index = draw_noise_index(
        state.seed, generation, groups, (len(primitive.theta),), table_size, first_level=level
    )
    rng = stream(state.seed, Purpose.BRANCHES, generation)
    seeds, kept = rng.integers(0, 2**63, groups).tolist(), rng.integers(0, 2, groups).tolist()
    if before:
        starts = _drawn_starts(rng, [each for one in before for each in one.results.snapshots.values()], estimate)
    else:
        starts = _running_starts(state.running, groups)
    tasks = [
        EpisodeTask(
            member=2 * group,
            noise_index=(int(noise_index[0, group]),),
            signs=((1,), (-1,)),
            slots=(0, 1),
            seeds=(seeds[group],) * 2,
            start=starts[group],
            kept_slot=None if before else kept[group],
        )
        for group in range(groups)
    ]
    return Draws(
        levels=(level,),
        signs=np.tile(np.array([[1], [-1]], dtype=np.int8), (groups, 1, 1)),  # [G, 2, 1]
        noise_index=noise_index,
        tasks=tasks,
        generation=Generation(
            levels=LevelParameters.of_all((primitive,)),
            sigma=estimate.sigma.value(generation),
            episodes_per_policy=1,
            is_evaluation=False,
            members_per_lane=2,
            branch_steps=estimate.intervals * estimate.controller_interval,
        ),
        learning_rate=estimate.learning_rate.value(generation),
    )


def _running_starts(running: RunningEpisodes | None, groups: int) -> list[Snapshot | None]:
    """Return a snapshot of each running episode; None for one that starts anew."""
    if running is None:
        return [None] * groups
    return [
        None if steps < 0 else Snapshot(state=state, steps=steps)
        for state, steps in zip(running.states, running.steps.tolist(), strict=True)
    ]


def _drawn_starts(
    rng: np.random.Generator, snapshots: Sequence[Snapshot], estimate: IntervalEstimate
) -> list[Snapshot | None]:
    """Return a snapshot for each pair: all `snapshots` in random order, repeated as necessary.

    Without snapshots, because every episode ended too early, pairs start at a reset with random goals.
    """
    if not snapshots:
        shape = (estimate.num_pairs, estimate.intervals, 2)
        goals = rng.uniform(-estimate.goal_distance, estimate.goal_distance, shape)
        return [Snapshot(state=None, steps=0, goals=own) for own in goals]
    order = rng.permutation(len(snapshots))
    return [snapshots[order[group % len(order)]] for group in range(estimate.num_pairs)]


def next_running(pairs: Population, horizon: int) -> RunningEpisodes | None:
    """Return the episodes after `pairs`: each continues from one of the pair's two ends.

    An episode starts anew if that end was terminal or reached the horizon. None means that all episodes start anew.
    """
    ends = {
        member // 2: end
        for (member, _), end in pairs.results.snapshots.items()
        if end.state is not None and end.steps < horizon
    }
    size = next((len(end.state) for end in ends.values() if end.state is not None), 0)
    if not size:
        return None
    states, steps = np.zeros((len(pairs.signs), size)), np.full(len(pairs.signs), -1)
    for group, end in ends.items():
        states[group], steps[group] = end.state, end.steps
    return RunningEpisodes(states=states, steps=steps)


Estimate: TypeAlias = Callable[[TrainState, Hyperparameters, int, Sequence[Population]], Draws]
"""Draws a population, given those that were rolled out before it in the same generation."""
