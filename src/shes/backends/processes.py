"""The processes backend: worker processes on this machine.

`ProcessPoolExecutor` is not used, because it breaks as a whole when one worker is killed, and outlives a killed parent.
Workers are started as a module, so a caller's script needs no `__main__` guard.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from selectors import EVENT_READ, EVENT_WRITE, BaseSelector, DefaultSelector
from typing import Any

from shes.backends.backend import WorkerFactory
from shes.backends.process_worker import FRAME
from shes.backends.serving import ONE_THREAD, import_path, pickle_factory
from shes.backends.supervision import REPLACED_S, RemoteWorker, SupervisingBackend
from shes.errors import WorkerError

_READ_BYTES = 2**20
_END_S = 10.0  # wait for a killed process; one that waits for a disk may take longer


class ProcessesBackend(SupervisingBackend):
    """Worker processes on this machine, each with one thread. A lost or silent one is replaced."""

    def __init__(self, factory: WorkerFactory, num_workers: int, *, worker_timeout_s: float = REPLACED_S) -> None:
        """Start `num_workers` processes. Each creates its worker by `factory`, which cloudpickle pickles.

        One without a sign of life for `worker_timeout_s` seconds is replaced.
        """
        super().__init__(num_workers, worker_timeout_s)
        self._factory = pickle_factory(factory)
        self._import_path = os.pathsep.join(import_path())
        self._selector = DefaultSelector()  # of the workers' sockets: asking each in turn would take too long
        self.start_workers()

    def pids(self) -> list[int]:
        """Return the process ids of the workers."""
        return [worker.popen.pid for worker in self.workers]

    def start_workers(self) -> None:
        """Start the processes that are missing; raise WorkerError if the system does not allow as many."""
        try:
            while len(self.workers) < self.num_workers:
                self.add_worker(self.start_worker())
        except OSError as error:
            self.close()
            raise WorkerError(
                f"not all of the {self.num_workers} worker processes could be started: {error.strerror or error}. "
                "Lower --workers, or raise the limit on processes and open files (ulimit)."
            ) from error

    def start_worker(self) -> RemoteWorker:
        """Start a worker; a subclass may prepare it."""
        return _WorkerProcess(self._factory, self._import_path, self._selector)

    def wait(self, timeout_s: float) -> Sequence[RemoteWorker]:
        """Wait at most `timeout_s` for requests; return the workers whose sockets have some, or are closed."""
        found = self._selector.select(timeout_s)
        for key, events in found:
            if events & EVENT_WRITE:
                key.data.flush()
        return [key.data for key, events in found if events & EVENT_READ]

    def advice(self, ending: str) -> str:
        """Return advice about processes that were killed, or that ended by themselves."""
        if signal.SIGKILL.name in ending:
            return "Usually memory ran out: lower --workers or --chunk-size."
        return f"It may have printed the reason above. {super().advice(ending)}"


class _WorkerProcess(RemoteWorker):
    """A worker process as its parent sees it. The socket never blocks: a stopped worker does not read, nor write."""

    def __init__(self, factory: bytes, import_path: str, selector: BaseSelector) -> None:
        super().__init__()
        self._socket, theirs = socket.socketpair()
        # -P: a file in the working directory must not replace a module of the standard library.
        module = [sys.executable, "-P", "-m", "shes.backends.process_worker"]
        # The worker inherits the mask: a Ctrl-C in a terminal reaches it even before it can ignore it.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self.popen = subprocess.Popen(
                [*module, str(theirs.fileno()), str(os.getpid())],
                pass_fds=[theirs.fileno()],
                env={**os.environ, **ONE_THREAD, "PYTHONPATH": import_path},
                stdin=subprocess.DEVNULL,
            )
        except OSError:
            self._socket.close()
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            theirs.close()
        self.name = str(self.popen.pid)
        self._incoming = bytearray()
        self._outgoing: deque[memoryview] = deque()
        self._selector = selector
        self._socket.setblocking(False)
        selector.register(self._socket, EVENT_READ, self)
        self._send(factory)

    def answer(self, message: tuple[Any, ...], state: bytes | None = None) -> None:
        self._send(pickle.dumps(message, pickle.HIGHEST_PROTOCOL), state or b"")

    def _send(self, message: bytes, state: bytes = b"") -> None:
        frame = FRAME.pack(len(message), len(state)) + message
        self._outgoing += [memoryview(part) for part in (frame, state) if part]
        self.flush()

    def flush(self) -> None:
        """Send as much as the socket takes, and let the selector wait until it takes more."""
        with suppress(OSError):  # BlockingIOError; if the worker is gone, the next read notices it
            while self._outgoing:
                sent = self._socket.send(self._outgoing[0])
                rest = self._outgoing.popleft()[sent:]
                if rest:
                    self._outgoing.appendleft(rest)
        self._selector.modify(self._socket, EVENT_READ | (EVENT_WRITE if self._outgoing else 0), self)

    def requests(self) -> Sequence[tuple[Any, ...]]:
        with suppress(BlockingIOError):
            read = self._socket.recv(_READ_BYTES)
            if not read:
                raise EOFError
            self._incoming += read
        found: list[tuple[Any, ...]] = []
        while len(self._incoming) >= FRAME.size:
            end = FRAME.size + FRAME.unpack_from(self._incoming)[0]
            if len(self._incoming) < end:
                break
            found.append(pickle.loads(self._incoming[FRAME.size : end]))
            del self._incoming[:end]
        return found

    def stop(self) -> None:
        self.popen.terminate()
        self.popen.send_signal(signal.SIGCONT)

    def has_stopped(self) -> bool:
        return self.popen.poll() is not None

    def end(self) -> str:
        """Kill the process, even if it has been stopped, and wait for its end; return its signal or exit code."""
        self.popen.kill()
        self._selector.unregister(self._socket)
        self._socket.close()
        with suppress(subprocess.TimeoutExpired):
            self.popen.wait(_END_S)
        names = {-each.value: f"killed by {each.name}" for each in signal.Signals}
        return names.get(self.popen.returncode, f"exit code {self.popen.returncode}")
