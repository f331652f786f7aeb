"""The work of one generation: which member uses which noise, signs and episode seeds.

Source: SHES paper, Algorithm 1 lines 2 and 3, II-E, II-F; Conti et al. 2018 for the mean policy's episodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from shes.errors import UnknownNameError
from shes.es.level import TrainState
from shes.es.perturbation import Signs
from shes.es.streams import Purpose, stream
from shes.hierarchy.episodes import EpisodeTask, Generation
from shes.types import IntArray

__all__ = ["COMMON_RANDOM_NUMBERS", "Work", "mean_policy_task", "members_per_lane", "population_tasks"]

_ENOUGH_ROWS = 3
"""Episodes of a member with which its own weights are read for enough rows: then it has a matmul of its own.

Whoever shares one is computed wherever one of them is: with many episodes that would cost a cluster, where a worker has
a few episodes alone, more than it saves.
"""

COMMON_RANDOM_NUMBERS = ("off", "group", "population")
"""Who shares the episodes' seeds: nobody; the members of a mirrored group; the whole population.

Deviation: `group` unless the `paper` preset says otherwise (the authors' code: every member draws its own), because it
takes the difference between episodes out of the comparison within a group.
"""


@dataclass(frozen=True, kw_only=True)
class Work:
    """The rollouts of a population, and how its members are perturbed."""

    signs: Signs
    """Signs of every member at each level [G, M, L]; 0 where it is not perturbed."""
    noise_index: IntArray
    """Start of the noise slice of each group [L, G]."""
    tasks: list[EpisodeTask]
    """The rollouts, in the order of the members."""
    generation: Generation
    """What they have in common."""


def population_tasks(
    state: TrainState,
    signs: Signs,
    noise_index: IntArray,
    episodes: int,
    common_random_numbers: str = "group",
    statistics_fraction: float = 1.0,
    noted_steps: Sequence[int] = (),
) -> list[EpisodeTask]:
    """Return the tasks of all members: their group's noise, their own signs, their episodes' seeds.

    Args:
        state: The state before the generation.
        signs: Signs of every member at each level [G, M, L].
        noise_index: Start of each group's noise slice [L, G].
        episodes: Episodes of a member, E.
        common_random_numbers: One of `COMMON_RANDOM_NUMBERS`.
        statistics_fraction: Share of the groups, drawn at random, whose observations enter the statistics.
        noted_steps: After how many control steps each of the G * M * E episodes leaves a snapshot; none leaves one if
            empty.

    Raises:
        UnknownNameError: `common_random_numbers` is not known.
    """
    if common_random_numbers not in COMMON_RANDOM_NUMBERS:
        raise UnknownNameError(
            "way to share episodes", common_random_numbers, COMMON_RANDOM_NUMBERS, "Set --common-random-numbers."
        )
    groups, members, _ = signs.shape
    rng = stream(state.seed, Purpose.TRAINING_EPISODES, state.generation)
    draws = {"off": (groups, members), "group": (groups, 1), "population": (1, 1)}[common_random_numbers]
    seeds = rng.integers(0, 2**63, (*draws, episodes))
    sampler = stream(state.seed, Purpose.STATISTICS_SAMPLE, state.generation)
    records = [sampler.random() < statistics_fraction for _ in range(groups)]
    shared = members_per_lane(members, episodes)
    return [
        EpisodeTask(
            member=group * members + first,
            noise_index=tuple(noise_index[:, group].tolist()),
            signs=tuple(tuple(own) for own in signs[group, first : first + shared].tolist()),
            slots=tuple(range(shared * episodes)),
            seeds=tuple(
                seed
                for member in range(first, first + shared)
                for seed in seeds[group % draws[0], member % draws[1]].tolist()
            ),
            records_statistics=records[group],
            noted_steps=tuple(noted_steps[(group * members + first) * episodes :][: shared * episodes]),
        )
        for group in range(groups)
        for first in range(0, members, shared)
    ]


def members_per_lane(members: int, episodes: int) -> int:
    """Return how many of the `members` of a group share a matmul, M': all of them where `episodes` (E) are few."""
    return members if episodes < _ENOUGH_ROWS else 1


def mean_policy_task(state: TrainState, member: int, episodes: int, shared: int) -> EpisodeTask:
    """Return the task of the mean policies themselves, as one more member: where they end is what novelty is from.

    Its matmul has room for `shared` members, as everyone's; the others' rows are idle.
    """
    zeros = (0,) * len(state.levels)
    seeds = stream(state.seed, Purpose.NOVELTY_EPISODES, state.generation).integers(0, 2**63, episodes)
    return EpisodeTask(
        member=member,
        noise_index=zeros,
        signs=(zeros,) * shared,
        slots=tuple(range(episodes)),
        seeds=tuple(seeds.tolist()),
        records_statistics=False,
    )
