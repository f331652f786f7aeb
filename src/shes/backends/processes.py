"""The processes backend: worker processes on this machine, `python -m shes.backends.processes FD PARENT`.

`ProcessPoolExecutor` is not used, because it breaks as a whole when one worker is killed, and outlives a killed parent.
A worker dies with its parent: Linux sends it a signal, and elsewhere a thread notices it. Workers are started as a
module, so a caller's script needs no `__main__` guard.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from selectors import EVENT_READ, EVENT_WRITE, BaseSelector, DefaultSelector
from typing import Any

from shes.backends.backend import WorkerFactory
from shes.backends.serving import ONE_THREAD, Answer, ClosedError, ParentConnection, import_path, pickle_factory, serve
from shes.backends.supervision import RemoteWorker, SupervisingBackend
from shes.errors import WorkerError

_FRAME = struct.Struct("!QQ")  # lengths of a message and of the pickled state after it
_READ_BYTES = 2**20
_END_S = 10.0  # wait for a killed process; one that waits for a disk may take longer
_PR_SET_PDEATHSIG = 1
_WATCH_S = 0.5


class ProcessesBackend(SupervisingBackend):
    """Worker processes on this machine, each with one thread. A lost or silent one is replaced."""

    advice = (
        "SIGKILL usually means that memory ran out: lower --workers or --chunk-size. Any other reason may be printed "
        f"above. {SupervisingBackend.advice}"
    )

    def __init__(self, factory: WorkerFactory, num_workers: int) -> None:
        """Start `num_workers` processes. Each creates its worker by `factory`, which cloudpickle pickles."""
        super().__init__(num_workers)
        self._factory = pickle_factory(factory)
        self._import_path = os.pathsep.join(import_path())
        self._selector = DefaultSelector()  # of the workers' sockets: asking each in turn would take too long
        self.start_workers()

    def start_workers(self) -> None:
        """Start the processes that are missing; raise WorkerError if the system does not allow as many."""
        try:
            while len(self.workers) < self.num_workers:
                self.workers.append(_WorkerProcess(self._factory, self._import_path, self._selector))
        except OSError as error:
            self.close()
            raise WorkerError(
                f"not all of the {self.num_workers} worker processes could be started: {error.strerror or error}. "
                "Lower --workers, or raise the limit on processes and open files (ulimit)."
            ) from error

    def wait(self, timeout_s: float) -> Sequence[RemoteWorker]:
        """Wait at most `timeout_s` for requests; return the workers whose sockets have some, or are closed."""
        found = self._selector.select(timeout_s)
        for key, events in found:
            if events & EVENT_WRITE:
                key.data.flush()
        return [key.data for key, events in found if events & EVENT_READ]


class _WorkerProcess(RemoteWorker):
    """A worker process as its parent sees it. The socket never blocks: a stopped worker does not read, nor write."""

    def __init__(self, factory: bytes, import_path: str, selector: BaseSelector) -> None:
        self._socket, theirs = socket.socketpair()
        # -P: a file in the working directory must not replace a module of the standard library.
        command = [sys.executable, "-P", "-m", "shes.backends.processes", str(theirs.fileno()), str(os.getpid())]
        # The worker inherits the mask: Ctrl-C or the end of a terminal reach it even before it can ignore them.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})
        try:
            self._popen = subprocess.Popen(
                command,
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
        super().__init__(str(self._popen.pid))
        self._incoming = bytearray()
        self._outgoing: deque[memoryview] = deque()
        self._selector = selector
        self._socket.setblocking(False)
        selector.register(self._socket, EVENT_READ, self)
        self.answer(("begin",), factory)

    def answer(self, message: tuple[Any, ...], state: bytes | None = None) -> None:
        content, state = pickle.dumps(message, pickle.HIGHEST_PROTOCOL), state or b""
        frame = _FRAME.pack(len(content), len(state)) + content
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
        while len(self._incoming) >= _FRAME.size:
            end = _FRAME.size + _FRAME.unpack_from(self._incoming)[0]
            if len(self._incoming) < end:
                break
            found.append(pickle.loads(self._incoming[_FRAME.size : end]))
            del self._incoming[:end]
        return found

    def stop(self) -> None:
        self._popen.terminate()
        self._popen.send_signal(signal.SIGCONT)

    def has_stopped(self) -> bool:
        return self._popen.poll() is not None

    def end(self) -> str:
        """Kill the process, even if it has been stopped, and wait for its end; return its signal or exit code."""
        self._popen.kill()
        self._selector.unregister(self._socket)
        self._socket.close()
        with suppress(subprocess.TimeoutExpired):
            self._popen.wait(_END_S)
        names = {-each.value: f"killed by {each.name}" for each in signal.Signals}
        return names.get(self._popen.returncode, f"exit code {self._popen.returncode}")


class _Parent(ParentConnection):
    """The connection of a worker process to its parent, which closes it by SIGTERM."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._reader = connection.makefile("rb")

    def tell(self, *request: Any) -> None:
        message = pickle.dumps(request, pickle.HIGHEST_PROTOCOL)
        try:
            self._socket.sendall(_FRAME.pack(len(message), 0) + message)
        except OSError as error:
            raise ClosedError from error

    def receive(self) -> Answer:
        message_size, state_size = _FRAME.unpack(self._read(_FRAME.size))
        return pickle.loads(self._read(message_size)), self._read(state_size) or None

    def _read(self, size: int) -> bytes:
        found = b""
        with suppress(OSError):
            found = self._reader.read(size)
        if len(found) < size:
            raise ClosedError
        return found

    def leave(self) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)


def _die_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_S)
    os._exit(1)


def _raise_closed(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise ClosedError


def main() -> None:
    """Serve the parent: the file descriptor of the connection and its process id are on the command line."""
    descriptor, parent = (int(argument) for argument in sys.argv[1:3])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: the parent decides
    if sys.platform == "linux":  # a parent that has ended already is noticed by its closed connection
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    else:
        threading.Thread(target=_die_with, args=(parent,), daemon=True).start()
    connection = _Parent(socket.socket(fileno=descriptor))
    with suppress(ClosedError):
        signal.signal(signal.SIGTERM, _raise_closed)
        _, factory = connection.receive()
        serve(connection, factory or b"")


if __name__ == "__main__":
    main()
