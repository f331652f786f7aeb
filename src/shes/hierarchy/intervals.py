"""The interval estimate: a primitive is evaluated by intervals that branch off the same state, not by whole episodes.

At a decision of an episode, a mirrored pair of primitives plays the next intervals from the same physics state on the
same goals. The two differ only in their perturbation, and an environment step evaluates many more directions than in
whole episodes.

If the environment sets the goals, pairs continue from the end of an earlier pair, in episodes that run from generation
to generation. Under a controller, pairs branch off snapshots of the whole episodes that evaluate the controllers.

Source: `docs/learning.md`; compare Schulman et al. 2015 (TRPO), section 5.2, the "vine" estimate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shes.es.level import LevelParameters, RunningEpisodes, TrainState, UpdateRule, draw_noise_index
from shes.es.schedules import Schedule
from shes.es.streams import Purpose, stream
from shes.hierarchy.episodes import EpisodeTask, Generation, Snapshot
from shes.hierarchy.population_tasks import Work
from shes.hierarchy.results import PopulationResults


@dataclass(frozen=True, kw_only=True)
class IntervalEstimate:
    """Hyperparameters of the interval estimate."""

    population_size: int
    """Number of members per generation (2 G)."""
    intervals: int
    """Number of intervals in a branch. With two or more, the state at the end of an interval affects the fitness."""
    controller_interval: int
    horizon: int
    """Number of control steps after which a running episode starts anew."""
    goal_distance: float
    """Half width in metres of the square from which goals are drawn if there is no snapshot."""
    update: UpdateRule
    sigma: Schedule
    learning_rate: Schedule

    @property
    def branch_steps(self) -> int:
        """Number of control steps in a branch."""
        return self.intervals * self.controller_interval

    @property
    def num_pairs(self) -> int:
        """Number of mirrored pairs per generation, G."""
        return self.population_size // 2


def branch_work(
    state: TrainState, estimate: IntervalEstimate, table_size: int, snapshots: Sequence[Snapshot] | None = None
) -> Work:
    """Return the pairs of the generation that follows `state`. The primitive is the last level.

    Pairs start from `snapshots` of whole episodes; None if the environment sets the goals, and episodes continue.
    """
    groups, level = estimate.num_pairs, len(state.levels) - 1
    primitive = state.levels[level]
    noise_index = draw_noise_index(
        state.seed, state.generation, groups, (len(primitive.theta),), table_size, first_level=level
    )
    rng = stream(state.seed, Purpose.BRANCHES, state.generation)
    seeds, kept = rng.integers(0, 2**63, groups).tolist(), rng.integers(0, 2, groups).tolist()
    starts = _running_starts(state.running, groups) if snapshots is None else _drawn_starts(rng, snapshots, estimate)
    tasks = [
        EpisodeTask(
            member=2 * group,
            noise_index=(int(noise_index[0, group]),),
            signs=((1,), (-1,)),
            slots=(0, 1),
            seeds=(seeds[group],) * 2,
            start=starts[group],
            kept_slot=kept[group] if snapshots is None else None,
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
    signs = np.tile(np.array([[1], [-1]], dtype=np.int8), (groups, 1, 1))  # [G, 2, 1]
    return Work(signs=signs, noise_index=noise_index, tasks=tasks, generation=generation)


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
) -> list[Snapshot]:
    """Return a snapshot for each pair: all `snapshots` in random order, repeated as necessary.

    Without snapshots, because every episode ended too early, pairs start at a reset with random goals.
    """
    if not snapshots:
        shape = (estimate.num_pairs, estimate.intervals, 2)
        goals = rng.uniform(-estimate.goal_distance, estimate.goal_distance, shape)
        return [Snapshot(state=None, steps=0, goals=own) for own in goals]
    order = rng.permutation(len(snapshots))
    return [snapshots[order[group % len(order)]] for group in range(estimate.num_pairs)]


def draw_snapshot_steps(state: TrainState, num_episodes: int, horizon: int, controller_interval: int) -> list[int]:
    """Return for each of `num_episodes` whole episodes the number of steps, at a decision, before its snapshot."""
    decisions = -(-horizon // controller_interval)
    rng = stream(state.seed, Purpose.SNAPSHOTS, state.generation)
    return (controller_interval * rng.integers(0, decisions, num_episodes)).tolist()


def next_running(results: PopulationResults, estimate: IntervalEstimate | None) -> RunningEpisodes | None:
    """Return the episodes after the pairs: each continues from one of the pair's two ends.

    An episode starts anew if that end was terminal or reached the horizon. None means that all episodes start anew.
    """
    assert estimate is not None, "running episodes belong to an interval estimate"
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
