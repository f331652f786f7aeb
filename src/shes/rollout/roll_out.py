"""Run episode tasks on a backend, in parts if there are fewer tasks than workers need."""

from __future__ import annotations

from collections.abc import Sequence

from shes.backends.backend import Backend
from shes.rollout.episodes import EpisodeTask, Generation
from shes.rollout.results import PopulationResults

_LANE_COST = 0.05  # of a part, in episodes per episode of the whole task: its matmul has the rows of all of them


def roll_out_tasks(tasks: Sequence[EpisodeTask], generation: Generation, backend: Backend) -> PopulationResults:
    """Return the results of `tasks`, which share `generation`, computed by the workers of `backend`."""
    backend.broadcast(generation)
    results = PopulationResults.of_tasks(tasks, generation)
    parts = divide(tasks, backend.num_workers)
    for part, result in zip(parts, backend.map(parts), strict=True):
        results.add(part, result)
    return results


def divide(tasks: Sequence[EpisodeTask], num_workers: int) -> Sequence[EpisodeTask]:
    """Return `tasks`, each cut into as many parts as makes the longest share of `num_workers` workers shortest.

    1000 members with 5 episodes each, in mirrored groups of four, are 250 tasks of 20 episodes: 600 workers do them in
    500 parts of 10. Results do not depend on it.
    """
    size = max((len(task.slots) for task in tasks), default=0)

    def longest_share(count: int) -> float:
        return -(-len(tasks) * count // num_workers) * (-(-size // count) + _LANE_COST * size)

    count = min(range(1, size + 1), key=longest_share, default=1)
    if count == 1:
        return tasks
    return [part for task in tasks for part in _parts(task, count)]


def _parts(task: EpisodeTask, count: int) -> list[EpisodeTask]:
    size = len(task.slots)
    count = min(count, size)
    return [task.part(i * size // count, (i + 1) * size // count) for i in range(count)]
