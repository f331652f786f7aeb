"""The populations of a generation: what is drawn for their members, by whole episodes or by intervals.

An episode evaluates every level that it perturbs (SHES paper, Algorithm 1). The interval estimate evaluates a primitive
alone: a mirrored pair plays the next intervals from the same physics state on the same goals, which differ only in
their perturbation. Under a controller, pairs branch off snapshots of the whole episodes. If the environment sets the
goals, pairs continue from the end of an earlier pair, in episodes that run from generation to generation.

G groups of M members, E episodes per member, L levels, S values of a physics state.

Source: SHES paper, II-A, II-E, II-F; `docs/learning.md` (intervals); compare the "vine" estimate of Schulman et al.
2015 (TRPO), section 5.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, TypeAlias

import numpy as np

from shes.es.level import LevelParameters, UpdateRule, draw_noise_index
from shes.es.noise import DEFAULT_TABLE_SIZE
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import MIRRORINGS, Signs, member_signs
from shes.es.shaping import FITNESS_SHAPINGS
from shes.evolution.state import Archive, TrainState
from shes.evolution.way_search import WaySearch
from shes.rollout.episodes import EpisodeTask, Generation, Snapshot, wander
from shes.rollout.roll_out import PopulationResults
from shes.settings import Choices, Ge, Gt, Le, Needs, Settings, Shown
from shes.streams import Purpose, stream
from shes.types import IntArray

_NEW_EPISODE = 0.3
"""Probability that an episode with goals that wander ends before a branch: else robots would gather at walls."""
_ENOUGH_ROWS = 3
"""Episodes per member from which each member has a matmul of its own. A shared one always has the rows of all."""


@dataclass(frozen=True, kw_only=True)
class EvolutionSettings(Settings):
    """Population and update."""

    population_size: Annotated[int, Ge(1), Shown(everyday=True)] = 240
    """Policies per generation, mirrored ones included (Table I: 1000)."""
    episodes_per_policy: Annotated[int, Ge(1)] = 1
    """Episodes per policy; the fitness is their mean return (Table I: 5)."""
    sigma: Annotated[float, Gt(0), Shown(everyday=True)] = 0.07
    """Standard deviation of the perturbations (Table I: 0.02)."""
    learning_rate: Annotated[float, Gt(0), Shown(everyday=True)] = 0.01
    """Learning rate (Table I, for Adam: 0.01)."""
    sigma_end: Annotated[float, Gt(0)] | None = None
    """Sigma schedule_generations after practice, reached by a constant factor each; none for a constant sigma."""
    learning_rate_end: Annotated[float, Gt(0)] | None = None
    """The same for the learning rate."""
    schedule_generations: Annotated[int, Ge(1), Needs("sigma_end"), Needs("learning_rate_end")] = 1000
    """Generations after practice in which sigma and the learning rate reach their ends."""
    weight_decay: Annotated[float, Ge(0)] = 0.005
    """Coefficient of the parameters subtracted from the gradient estimate (authors' code: 0.005)."""
    mirrored: Annotated[str, Choices(MIRRORINGS)] = "quad"
    """How the members of a group mirror its noise (section II-F)."""
    fitness_shaping: Annotated[str, Choices(FITNESS_SHAPINGS)] = "centred_rank"
    """Fitness shaping."""
    optimizer: Annotated[str, Choices(OPTIMIZERS)] = "adam"
    """Optimizer."""
    # Deviation: `group`, except in the preset `paper`, because it removes the variation between episodes from the
    # comparison within a group. In the authors' code every member draws its own seeds.
    common_random_numbers: Literal["off", "group", "population"] = "group"
    """Which policies share episode seeds: off (none), group (those of a mirrored group) or population (all)."""
    # Deviation: all of them, except in the preset `paper` (authors' code: 0.01).
    statistics_fraction: Annotated[float, Ge(0), Le(1)] = 1.0
    """Fraction of the mirrored groups whose observations enter the observation statistics."""
    noise_table_size: Annotated[int, Ge(2)] = DEFAULT_TABLE_SIZE
    """Normals in the shared noise table, 4 bytes each (authors' code: 250 million)."""

    def value(self, name: str, generation: int) -> float:
        """Return `sigma` or `learning_rate` after `generation` updates: exact at the start and the end of its schedule.

        Source: Ha 2017 (estool), `sigma_decay`, `learning_rate_decay`.
        """
        start, end, generations = getattr(self, name), getattr(self, f"{name}_end"), self.schedule_generations
        if generation <= 0 or end is None:
            return start
        return end if generation >= generations else start * (end / start) ** (generation / generations)


@dataclass(frozen=True, kw_only=True)
class IntervalEstimate:
    """Hyperparameters of the interval estimate of the primitive, the last level."""

    evolution: EvolutionSettings
    """Number of members per generation (2 G), and the schedules of sigma and the learning rate."""
    intervals: int
    """Number of intervals in a branch. With two or more, the state at the end of an interval affects the fitness."""
    controller_interval: int
    goal_distance: float
    """Distance in metres of goals that wander."""


@dataclass(frozen=True, kw_only=True)
class Hyperparameters:
    """Hyperparameters of Algorithm 1."""

    evolution: EvolutionSettings
    updates: tuple[UpdateRule, ...]
    """Update rule of each level."""
    learns: tuple[bool, ...]
    """Whether each level learns. A frozen level has no perturbation, update or new statistics (II-D)."""
    perturbation: str = "many_to_many"
    """Which levels a generation perturbs (II-E)."""
    intervals: IntervalEstimate | None = None
    """How the primitive is evaluated by intervals; None if it is evaluated by whole episodes."""
    search: WaySearch | None = None
    """Search for a way to the target; None for no search."""
    practice: int = 0
    """Number of generations at the start in which the primitive alone learns, on goals that wander."""
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

    def is_practice(self, state: TrainState) -> bool:
        """Return whether the primitive alone learns. Without a way the reward would keep controllers in dead ends."""
        return state.generation < self.practice or (state.archive is not None and not state.archive.way_steps)


@dataclass(frozen=True, kw_only=True)
class Draws:
    """The members of a population and their episodes, drawn but not yet rolled out."""

    levels: tuple[int, ...]
    """Indices in the state of the L levels that members have."""
    signs: Signs
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


def draw_episodes(
    state: TrainState,
    settings: Hyperparameters,
    table_size: int,
    before: Sequence[Population] = (),  # noqa: ARG001 - the signature of an `Estimate`
) -> Draws:
    """Return the members that whole episodes evaluate in the generation that follows `state`."""
    generation, archive, own = state.generation, state.archive, settings.evolution
    levels = tuple(LevelParameters.of(level.theta, level.statistics) for level in state.levels)
    signs = member_signs(settings.perturbation, own.mirrored, own.population_size, settings.by_episodes, generation)
    is_practice = settings.is_practice(state)
    if is_practice:
        levels = (*(level.at_zero() for level in levels[:-1]), levels[-1])
        signs[:, :, :-1] = 0
        signs = signs if signs.any() else signs[:1]  # one group shows how the primitive does
    dims, members = [len(level.theta) for level in levels], signs.shape[1]
    noise_index = draw_noise_index(state.seed, generation, len(signs), dims, table_size)
    shared = Generation(
        levels=levels,
        sigma=own.value("sigma", generation - settings.practice),
        episodes_per_policy=own.episodes_per_policy,
        members_per_lane=members if own.episodes_per_policy < _ENOUGH_ROWS else 1,
        has_frozen_control=not settings.by_episodes[-1],
        snapshot_goals=0 if settings.intervals is None else settings.intervals.intervals,
        decisions="wander" if is_practice else None,
        way=archive.way[1:] if archive is not None and archive.way_steps else None,
    )
    return Draws(
        levels=tuple(range(len(levels))),
        signs=signs,
        noise_index=noise_index,
        tasks=_episode_tasks(state, settings, signs, noise_index, shared.members_per_lane),
        generation=shared,
        learning_rate=own.value("learning_rate", generation - settings.practice),
    )


def _episode_tasks(
    state: TrainState, settings: Hyperparameters, signs: Signs, noise_index: IntArray, in_lane: int
) -> list[EpisodeTask]:
    """Return the tasks of all members, each for `in_lane` members of a group."""
    groups, members, _ = signs.shape
    own, episodes = settings.evolution, settings.evolution.episodes_per_policy
    rng = stream(state.seed, Purpose.TRAINING_EPISODES, state.generation)
    common = own.common_random_numbers if signs.any() else "off"  # without noise all members are the same
    shares = {"off": (groups, members), "group": (groups, 1), "population": (1, 1)}[common]
    seeds = np.broadcast_to(rng.integers(0, 2**63, (*shares, episodes)), (groups, members, episodes))
    sampler = stream(state.seed, Purpose.STATISTICS_SAMPLE, state.generation)
    records = [sampler.random() < own.statistics_fraction for _ in range(groups)]
    snapshot_steps = list[tuple[int, ...]]()  # before the snapshots of each episode
    if settings.intervals is not None:
        interval, pairs = settings.intervals.controller_interval, settings.intervals.evolution.population_size // 2
        rng, decisions = stream(state.seed, Purpose.SNAPSHOTS, state.generation), -(-settings.horizon // interval)
        every = np.tile(interval * np.arange(decisions), (seeds.size, 1))
        snapshot_steps = [*map(tuple, rng.permuted(every, axis=1)[:, : -(-pairs // seeds.size)].tolist())]
    starts = _starts_on_way(state.archive, stream(state.seed, Purpose.STARTS, state.generation), groups)
    return [
        EpisodeTask(
            member=group * members + first,
            start=starts[group],
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


def _starts_on_way(archive: Archive | None, rng: np.random.Generator, number: int) -> list[Snapshot | None]:
    """Return where new episodes begin: about half at random places of the way found (Salimans and Chen 2018)."""
    if archive is None or not len(known := archive.starts):
        return [None] * number
    places = np.where(rng.random(number) < 0.5, rng.integers(0, len(known), number), -1)
    return [Snapshot(state=known[i], steps=0) if i >= 0 else None for i in places.tolist()]


def draw_pairs(
    state: TrainState, settings: Hyperparameters, table_size: int, before: Sequence[Population] = ()
) -> Draws:
    """Return the mirrored pairs that intervals evaluate in the generation that follows `state`.

    They start from snapshots of the whole episodes `before`; without such episodes, running ones continue. In practice,
    running episodes with goals that wander belong to all pairs; with a search, new ones can begin on the way. Then, a
    share of pairs starts from snapshots: the success rate, at most half. Untrained controllers lead into walls, where a
    primitive forgets how to walk.
    """
    estimate, generation, level = settings.intervals, state.generation, len(state.levels) - 1
    assert estimate is not None, "pairs belong to an interval estimate"
    groups, primitive = estimate.evolution.population_size // 2, state.levels[level]
    noise_index = draw_noise_index(state.seed, generation, groups, (len(primitive.theta),), table_size, level)
    rng = stream(state.seed, Purpose.BRANCHES, generation)
    seeds, kept = rng.integers(0, 2**63, groups).tolist(), rng.integers(0, 2, groups).tolist()
    running, drawn, archive = [*(state.running or [None] * groups)], list[Snapshot](), state.archive
    if before:
        snapshots = [each for one in before for own in one.results.snapshots.values() for each in own]
        if snapshots and not settings.is_practice(state):
            success = np.mean([one.results.outcomes["success"].mean() for one in before])
            running = [] if archive is None else running[: groups - int(groups * min(0.5, success))]
        goes_on = (rng.random(len(running)) >= _NEW_EPISODE).tolist()
        angles = wander(rng, estimate.intervals, len(running)).T
        goals = estimate.goal_distance * np.stack([np.cos(angles), np.sin(angles)], axis=2)
        new, begun = Snapshot(state=None, steps=0), _starts_on_way(archive, rng, len(running))
        ends = [end if goes_on[i] and end else begun[i] or new for i, end in enumerate(running)]
        running = [replace(end, goals=own) for end, own in zip(ends, goals, strict=True)]
        order = rng.permutation(len(snapshots))
        drawn = [snapshots[order[group % len(order)]] for group in range(groups - len(running))]
    tasks = [
        EpisodeTask(
            member=2 * group,
            noise_index=(int(noise_index[0, group]),),
            signs=((1,), (-1,)),
            slots=(0, 1),
            seeds=(seeds[group],) * 2,
            start=start,
            kept_slot=kept[group] if group < len(running) else None,
        )
        for group, start in enumerate([*running, *drawn])
    ]
    return Draws(
        levels=(level,),
        signs=np.tile(np.array([[1], [-1]], dtype=np.int8), (groups, 1, 1)),  # [G, 2, 1]
        noise_index=noise_index,
        tasks=tasks,
        generation=Generation(
            levels=(LevelParameters.of(primitive.theta, primitive.statistics),),
            sigma=estimate.evolution.value("sigma", generation - settings.practice),
            episodes_per_policy=1,
            kind="branch",
            members_per_lane=2,
            branch_steps=estimate.intervals * estimate.controller_interval,
        ),
        learning_rate=estimate.evolution.value("learning_rate", generation - settings.practice),
    )


def next_running(pairs: Population, horizon: int) -> tuple[Snapshot | None, ...] | None:
    """Return the episodes after `pairs`: each continues from one of the pair's two ends.

    It starts anew if that end was terminal or reached the horizon. None means that all start anew.
    """
    ends = {member // 2: end for (member, _), (end,) in pairs.results.snapshots.items() if end.steps < horizon}
    return tuple(map(ends.get, range(len(pairs.signs)))) if ends else None


Estimate: TypeAlias = Callable[[TrainState, Hyperparameters, int, Sequence[Population]], Draws]
"""Draws a population, given those that were rolled out before it in the same generation."""
