"""Run episode tasks on a backend."""

from __future__ import annotations

from collections.abc import Sequence

from shes.backends.backend import Backend
from shes.hierarchy.episodes import EpisodeTask, Generation, spread
from shes.hierarchy.results import PopulationResults


def roll_out_tasks(tasks: Sequence[EpisodeTask], generation: Generation, backend: Backend) -> PopulationResults:
    """Return the results of `tasks`, which share `generation`, computed by the workers of `backend`."""
    backend.broadcast(generation)
    results = PopulationResults.of_tasks(tasks, generation)
    spread_tasks = spread(list(tasks), backend.num_workers)
    for task, result in zip(spread_tasks, backend.map(spread_tasks), strict=True):
        results.add(task, result)
    return results
