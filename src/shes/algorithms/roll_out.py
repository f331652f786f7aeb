"""Work for a backend, done."""

from __future__ import annotations

from collections.abc import Sequence

from shes.backends.backend import Backend
from shes.hierarchy.episodes import EpisodeTask, Generation, spread
from shes.hierarchy.results import PopulationResults

__all__ = ["roll_out_tasks"]


def roll_out_tasks(tasks: Sequence[EpisodeTask], generation: Generation, backend: Backend) -> PopulationResults:
    """Return what came of `tasks`, all of this `generation`, done by the workers of `backend`."""
    backend.broadcast(generation)
    results = PopulationResults.of_tasks(tasks, generation)
    cut = spread(list(tasks), backend.num_workers)
    for task, result in zip(cut, backend.map(cut), strict=True):
        results.add(task, result)
    return results
