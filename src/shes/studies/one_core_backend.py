"""Worker processes, each pinned to one core, so that the time of a run is the time of one core."""

from __future__ import annotations

from shes.backends.backend import WorkerFactory
from shes.backends.processes import ProcessesBackend
from shes.backends.supervision import RemoteWorker
from shes.cores import core_numbers, on_one_core


class OneCoreBackend(ProcessesBackend):
    """Worker processes, each pinned to one core where the system can do that.

    A library may use all cores that are idle, as JAX does for HIRO: without this, the last runs of a study would be
    faster than those beside others.
    """

    def __init__(self, factory: WorkerFactory, num_workers: int) -> None:
        """Start `num_workers` processes. Each creates its worker by `factory`, which cloudpickle pickles."""
        self._cores: dict[RemoteWorker, int] = {}
        super().__init__(factory, num_workers)

    def start_worker(self) -> RemoteWorker:
        """Start a worker on the core that has the fewest."""
        taken = [self._cores[worker] for worker in self.workers]
        core = min(core_numbers(), key=taken.count)
        with on_one_core(core):
            worker = super().start_worker()
        self._cores[worker] = core
        return worker
