"""The tasks of a population: noise, signs and episode seeds of every member.

Source: SHES paper, Algorithm 1 lines 2 and 3, II-E, II-F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from shes.es.level import TrainState
from shes.es.perturbation import Signs
from shes.es.streams import Purpose, stream
from shes.hierarchy.episodes import EpisodeTask, Generation
from shes.types import IntArray

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
class Work:
    """The tasks of a population, and the perturbations of its members."""

    signs: Signs
    """Signs of every member at each level [G, M, L]; 0 for no perturbation."""
    noise_index: IntArray
    """Start of the noise slice of each group [L, G]."""
    tasks: list[EpisodeTask]
    """The tasks, in the order of the members."""
    generation: Generation


def population_tasks(
    state: TrainState,
    signs: Signs,
    noise_index: IntArray,
    episodes: int,
    common_random_numbers: str = "group",
    statistics_fraction: float = 1.0,
    snapshot_steps: Sequence[int] = (),
) -> list[EpisodeTask]:
    """Return the tasks of all members.

    Args:
        state: The state before the generation.
        signs: Signs of every member at each level [G, M, L].
        noise_index: Start of each group's noise slice [L, G].
        episodes: Number of episodes per member, E.
        common_random_numbers: One of `COMMON_RANDOM_NUMBERS`.
        statistics_fraction: Fraction of the groups, chosen at random, whose observations enter the statistics.
        snapshot_steps: Number of control steps before the snapshot of each of the G * M * E episodes; empty for no
            snapshots.
    """
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
            snapshot_steps=tuple(snapshot_steps[(group * members + first) * episodes :][: shared * episodes]),
        )
        for group in range(groups)
        for first in range(0, members, shared)
    ]


def members_per_lane(members: int, episodes: int) -> int:
    """Return how many of the `members` of a group share a matmul, M': all of them if E (`episodes`) is small."""
    return members if episodes < _ENOUGH_ROWS else 1
