"""The processes backend: worker processes on this machine. A lost or silent worker is replaced, its work repeated.

`ProcessPoolExecutor` is not used, because it breaks as a whole when one worker is killed, and outlives a killed parent.
Workers are started as a module, so a caller's script needs no `__main__` guard.
"""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Sequence
from selectors import EVENT_READ, DefaultSelector
from typing import ClassVar

from shes.backends.backend import WorkerFactory
from shes.backends.factory import import_path, pickle_factory
from shes.backends.job import State
from shes.backends.process import SocketWorker, WorkerProcess
from shes.backends.pull import PullBackend, SilenceSettings
from shes.backends.remote_worker import RemoteWorker
from shes.errors import WorkerError
from shes.settings import Settings


class ProcessesBackend(PullBackend):
    """Worker processes on this machine, each with one thread."""

    Options: ClassVar[type[Settings]] = SilenceSettings

    def __init__(
        self,
        factory: WorkerFactory,
        num_workers: int,
        *,
        worker_warning_s: float | None = None,
        worker_timeout_s: float | None = None,
    ) -> None:
        """Start `num_workers` processes. Each creates its worker by `factory`, which cloudpickle pickles."""
        super().__init__(num_workers, worker_warning_s, worker_timeout_s)
        self._factory = pickle_factory(factory)
        self._import_path = os.pathsep.join(import_path())
        self._selector = DefaultSelector()  # of the workers' connections: asking each in turn would take too long
        self.start_workers()

    def close(self) -> None:
        """End every worker process."""
        workers, self.workers = self.workers, []
        for worker in workers:
            worker.kill()
        for worker in workers:
            self.end_worker(worker)

    def pids(self) -> list[int]:
        """Return the process ids of the workers."""
        return [worker.popen.pid for worker in self.workers]

    def start_workers(self) -> None:
        """Start the processes that are missing.

        Raises:
            WorkerError: The system allows no more processes or open files.
        """
        try:
            self.start_missing()
        except OSError as error:
            self.close()
            raise WorkerError(
                f"not all of the {self.num_workers} worker processes could be started: {error.strerror or error}. "
                "Lower --workers, or raise the limit on processes and open files (ulimit)."
            ) from error

    def start_missing(self) -> None:
        """Start workers until there are `num_workers`; a subclass may prepare them. Raises OSError."""
        while len(self.workers) < self.num_workers:
            worker = self.start_worker()
            self.workers.append(worker)
            self._selector.register(worker.connection, EVENT_READ, worker)

    def start_worker(self) -> SocketWorker:
        """Start a worker; a subclass may start another kind."""
        return WorkerProcess(self._factory, self._import_path, self.worker_timeout_s)

    def send_state(self, worker: RemoteWorker, state: State) -> None:
        """Send `state`, in a message that is pickled once for all workers."""
        assert isinstance(worker, SocketWorker)
        state.stored = state.stored or pickle.dumps(("state", state.number, state.pickled), pickle.HIGHEST_PROTOCOL)
        worker.note_state(state)
        worker.send_pickled(state.stored)

    def ready_workers(self, timeout_s: float) -> Sequence[RemoteWorker]:
        """Wait at most `timeout_s` for messages; return the workers whose sockets have some, or are closed."""
        return [key.data for key, _ in self._selector.select(timeout_s)]

    def end_worker(self, worker: RemoteWorker) -> None:
        """End a worker that is replaced, and wait for its messages no more."""
        assert isinstance(worker, SocketWorker)
        self._selector.unregister(worker.connection)
        super().end_worker(worker)

    def advice(self, worker: RemoteWorker) -> str:
        """Return advice for a process that was killed, or that ended itself."""
        if isinstance(worker, WorkerProcess) and worker.popen.returncode == -signal.SIGKILL:
            return "Usually memory ran out: lower --workers or --chunk-size."
        return "It may have printed the reason above; --backend serial does the same work in this process."
