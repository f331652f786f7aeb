"""Random results instead of rollouts, to measure the work of the parent alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from shes.hierarchy.episodes import EpisodeResults, EpisodeTask, Generation, Snapshot, empty_outcomes
from shes.hierarchy.moments import Moments


class RandomResults:
    """A `Worker` that returns random results at once."""

    def __init__(self, state_size: int) -> None:
        self._state = np.zeros(state_size)
        self._rng = np.random.default_rng(0)
        self._generation: Generation | None = None

    def receive(self, state: Generation) -> None:
        """Keep the generation of the next tasks."""
        self._generation = state

    def run(self, work: Iterator[tuple[int, EpisodeTask]], share: int) -> Iterator[tuple[int, EpisodeResults]]:
        """Yield the results of `work` with their numbers."""
        for number, task in work:
            yield number, self.of(task)

    def of(self, task: EpisodeTask) -> EpisodeResults:
        """Return random results of `task`; no episode diverges."""
        assert self._generation is not None, "receive() comes first"
        generation = self._generation
        rng, k = self._rng, len(task.slots)
        outcomes = empty_outcomes(len(generation.levels), k)
        for name in ("returns", "environment_returns", "score", "final_position"):
            outcomes[name] = rng.standard_normal(outcomes[name].shape)
        outcomes["steps"] = 1
        outcomes["has_terminated"] = outcomes["has_fallen"] = rng.random(k) < 0.5
        return EpisodeResults(
            outcomes=outcomes,
            moments=_moments(generation, k) if task.records_statistics else None,
            snapshots=self._snapshots(task, generation),
        )

    def _snapshots(self, task: EpisodeTask, generation: Generation) -> list[Snapshot | None]:
        left = Snapshot(state=self._state, steps=0, goals=np.zeros((generation.snapshot_goals, 2)))
        return [left if task.snapshot_steps or slot == task.kept_slot else None for slot in task.slots]


def _moments(generation: Generation, episodes: int) -> tuple[Moments, ...]:
    """Return the moments of one observation per episode at each level, with mean 0 and variance 1."""
    sizes = [len(level.mean) for level in generation.levels]
    return tuple(
        Moments(
            count=np.ones(episodes, np.int64), total=np.zeros((episodes, size)), total_squares=np.ones((episodes, size))
        )
        for size in sizes
    )
