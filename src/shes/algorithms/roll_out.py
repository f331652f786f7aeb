"""Run episode tasks on a backend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from shes.backends.backend import Backend, Pending
from shes.hierarchy.episodes import EpisodeTask, Generation
from shes.hierarchy.results import PopulationResults


def roll_out_tasks(tasks: Sequence[EpisodeTask], generation: Generation, backend: Backend) -> PopulationResults:
    """Return the results of `tasks`, which share `generation`, computed by the workers of `backend`."""
    backend.broadcast(generation)
    results = PopulationResults.of_tasks(tasks, generation)
    for task, result in zip(tasks, backend.map(tasks), strict=True):
        results.add(task, result)
    return results


@dataclass(frozen=True, kw_only=True)
class RollOutBeside:
    """Tasks that are done beside the next `roll_out_tasks`."""

    tasks: Sequence[EpisodeTask]
    generation: Generation
    pending: Pending

    @classmethod
    def start(cls, tasks: Sequence[EpisodeTask], generation: Generation, backend: Backend) -> RollOutBeside:
        """Let the workers of `backend` do `tasks`, which share `generation`, beside the next `roll_out_tasks`."""
        return cls(tasks=tasks, generation=generation, pending=backend.beside(tasks, generation))

    def results(self) -> PopulationResults:
        """Return the results of all tasks, after the work that is left."""
        results = PopulationResults.of_tasks(self.tasks, self.generation)
        for task, result in zip(self.tasks, self.pending.results(), strict=True):
            results.add(task, result)
        return results
