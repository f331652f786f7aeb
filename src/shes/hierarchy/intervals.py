"""The interval-branched estimate: a primitive is judged by intervals that branch off the same state, not by episodes.

A primitive answers for one goal at a time. At a decision of an episode, a mirrored pair of primitives plays the next
intervals from the same physics state, on the same goals. What differs between the two is their perturbation alone, and
a step of the environment tells of many more directions than in whole episodes.

Where the environment sets the goals, the pairs' own ends go on: episodes that run from generation to generation. Under
a controller, the pairs branch off states that the generation's whole episodes, which judge the controllers, have left.

Source: learning specification, section 2; e.g. Schulman et al. 2015 (TRPO), section 5.2, the "vine" estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shes.es.level import LevelParameters, RunningEpisodes, TrainState, UpdateRule, draw_noise_index
from shes.es.perturbation import Signs
from shes.es.schedules import Schedule
from shes.es.streams import Purpose, stream
from shes.hierarchy.episodes import EpisodeTask, Generation, Snapshot
from shes.hierarchy.population import Work
from shes.hierarchy.results import PopulationResults

__all__ = ["IntervalEstimate", "branch_work", "next_running", "noted_steps"]


@dataclass(frozen=True, kw_only=True)
class IntervalEstimate:
    """How a primitive is judged by intervals."""

    population_size: int
    """Members evaluated in a generation, both of every pair (2 G)."""
    intervals: int
    """Intervals that a branch plays (K): with two, how one ends counts for the next."""
    controller_interval: int
    """Control steps of an interval (c)."""
    horizon: int
    """Control steps after which an episode that runs from generation to generation begins anew."""
    goal_distance: float
    """Half width of the square from which goals are drawn where no episode has left any, in metres."""
    update: UpdateRule
    """How fitness becomes a step."""
    sigma: Schedule
    """Standard deviation of the perturbations."""
    learning_rate: Schedule
    """Rate of the optimizer."""

    @property
    def branch_steps(self) -> int:
        """Control steps of a branch."""
        return self.intervals * self.controller_interval

    @property
    def num_pairs(self) -> int:
        """Mirrored pairs of a generation, G."""
        return self.population_size // 2


def branch_work(
    state: TrainState, estimate: IntervalEstimate, table_size: int, left: Sequence[Snapshot] | None = None
) -> Work:
    """Return the pairs of the generation that follows `state`: the primitive is its last level.

    Args:
        state: The state before the generation.
        estimate: How the primitive is judged.
        table_size: Numbers in the noise table.
        left: What whole episodes left; None where the environment sets goals, and episodes run on.
    """
    groups, level = estimate.num_pairs, len(state.levels) - 1
    primitive = state.levels[level]
    noise_index = draw_noise_index(
        state.seed, state.generation, groups, (len(primitive.theta),), table_size, first_level=level
    )
    rng = stream(state.seed, Purpose.BRANCHES, state.generation)
    seeds, kept = rng.integers(0, 2**63, groups).tolist(), rng.integers(0, 2, groups).tolist()
    starts = _running_starts(state.running, groups) if left is None else _drawn_starts(rng, left, estimate)
    tasks = [
        EpisodeTask(
            member=2 * group,
            noise_index=(int(noise_index[0, group]),),
            signs=((1,), (-1,)),
            slots=(0, 1),
            seeds=(seeds[group],) * 2,
            start=starts[group],
            kept_slot=kept[group] if left is None else None,
        )
        for group in range(groups)
    ]
    generation = Generation(
        levels=LevelParameters.of_all((primitive,)),
        sigma=estimate.sigma.value(state.generation),
        episodes_per_policy=1,
        is_evaluation=False,
        members_per_lane=2,
        branch_steps=estimate.branch_steps,
    )
    return Work(signs=_pair_signs(groups), noise_index=noise_index, tasks=tasks, generation=generation)


def _pair_signs(groups: int) -> Signs:
    """Return the signs [G, 2, 1] of mirrored pairs."""
    signs: NDArray[np.int8] = np.ones((groups, 2, 1), dtype=np.int8)
    signs[:, 1] = -1
    return signs


def _running_starts(running: RunningEpisodes | None, groups: int) -> list[Snapshot | None]:
    """Return where each running episode is; None for one that begins anew."""
    if running is None:
        return [None] * groups
    return [
        None if steps < 0 else Snapshot(state=state, steps=steps)
        for state, steps in zip(running.states, running.steps.tolist(), strict=True)
    ]


def _drawn_starts(rng: np.random.Generator, left: Sequence[Snapshot], estimate: IntervalEstimate) -> list[Snapshot]:
    """Return a snapshot for each pair: all that were left, in random order, as often as it takes.

    Where every episode ended before it left one, pairs begin at a reset, on goals that are drawn.
    """
    if not left:
        shape = (estimate.num_pairs, estimate.intervals, 2)
        goals = rng.uniform(-estimate.goal_distance, estimate.goal_distance, shape)
        return [Snapshot(state=None, steps=0, goals=own) for own in goals]
    order = rng.permutation(len(left))
    return [left[order[group % len(left)]] for group in range(estimate.num_pairs)]


def noted_steps(state: TrainState, num_episodes: int, horizon: int, controller_interval: int) -> list[int]:
    """Return for each of `num_episodes` whole episodes the steps after which it leaves a snapshot, at a decision."""
    decisions = -(-horizon // controller_interval)
    rng = stream(state.seed, Purpose.SNAPSHOTS, state.generation)
    return (controller_interval * rng.integers(0, decisions, num_episodes)).tolist()


def next_running(results: PopulationResults, estimate: IntervalEstimate | None) -> RunningEpisodes | None:
    """Return the episodes as the pairs leave them: one of the two ends goes on, unless that fell or was the last.

    None stands for all of them beginning anew.
    """
    assert estimate is not None, "pairs that nobody judges do not run"
    ends = {
        member // 2: end
        for (member, _), end in results.snapshots.items()
        if end.state is not None and end.steps < estimate.horizon
    }
    size = next((len(end.state) for end in ends.values() if end.state is not None), 0)
    if not size:
        return None
    states, steps = np.zeros((estimate.num_pairs, size)), np.full(estimate.num_pairs, -1)
    for group, end in ends.items():
        states[group], steps[group] = end.state, end.steps
    return RunningEpisodes(states=states, steps=steps)
