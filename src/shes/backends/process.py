"""A worker process as its parent sees it: its start, its messages, its tasks and its end."""

from __future__ import annotations

import os
import pickle
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from queue import SimpleQueue
from threading import Thread
from typing import Any

from shes.backends.remote_worker import RemoteWorker
from shes.backends.serving import ONE_THREAD

_AT_ONCE_BYTES = 2**16  # of a message that is not worth the switch to a thread
_END_S = 10.0  # wait for a killed process; one that waits for a disk may take longer


class SocketWorker(RemoteWorker):
    """A worker at the other end of a socket."""

    def __init__(self, own: socket.socket, factory: bytes, timeout_s: float | None) -> None:
        """Let the worker be made by the pickled `factory`.

        A message that has been sent in part raises BlockingIOError after `timeout_s` seconds.
        """
        super().__init__()
        self._socket = own
        if timeout_s is not None:
            limit = struct.pack("ll", int(min(timeout_s, 1e9)), int(timeout_s % 1 * 1e6))  # a struct timeval
            own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)
        self.connection = Connection(own.fileno())
        # What the socket does not take at once, a thread sends: a stopped worker does not read, and would block the
        # parent.
        self._outgoing: SimpleQueue[bytes | memoryview | None] = SimpleQueue()
        self._num_queued = self._num_sent = 0  # what the thread was given, and has done
        self._sender = Thread(target=self._send_all, name="shes-send", daemon=True)
        self._sender.start()
        self.send_pickled(factory)

    @property
    def name(self) -> str:
        """Number of the socket."""
        return f"at socket {self._socket.fileno()}"

    @property
    def ending(self) -> str:
        """How the worker ended, in words."""
        return "the connection ended"

    def send(self, *message: Any) -> None:
        """Send a message soon. If the worker is gone, the next read notices it."""
        self.send_pickled(pickle.dumps(message, pickle.HIGHEST_PROTOCOL))

    def send_pickled(self, message: bytes) -> None:
        """Send a pickled message soon."""
        header = _header(len(message))
        rest: list[bytes | memoryview] = [header, message]
        if self._num_sent == self._num_queued and len(message) <= _AT_ONCE_BYTES:
            rest = [memoryview(header + message)]
            with suppress(OSError):  # BlockingIOError if there is no room; if the worker is gone, the thread meets it
                rest = [rest[0][self._socket.send(rest[0], socket.MSG_DONTWAIT) :]]
        for part in filter(None, rest):
            self._num_queued += 1
            self._outgoing.put(part)

    def receive(self) -> Sequence[tuple[Any, ...]]:
        """Return the next message."""
        return [self.connection.recv()]

    def _send_all(self) -> None:
        while (message := self._outgoing.get()) is not None:
            with suppress(OSError):
                self._socket.sendall(message)
            self._num_sent += 1

    def kill(self) -> None:
        """End the process of the worker, if it has one of its own. Call `end` afterwards."""

    def end(self) -> None:
        """Close the connection."""
        self._outgoing.put(None)
        self._socket.shutdown(socket.SHUT_RDWR)  # what is being sent fails
        self._sender.join()
        self.connection.close()
        self._socket.detach()


class WorkerProcess(SocketWorker):
    """A worker process and the tasks it is working on."""

    def __init__(self, factory: bytes, import_path: str, timeout_s: float | None) -> None:
        """Start the process, which imports from `import_path` and makes its worker by the pickled `factory`.

        A message that the process has sent in part raises BlockingIOError after `timeout_s` seconds.
        """
        own, theirs = socket.socketpair()
        read_end, self._lifeline = os.pipe()
        # -P: a file in the working directory must not replace a module of the standard library.
        module = [sys.executable, "-P", "-m", "shes.backends.process_worker"]
        arguments = [str(theirs.fileno()), str(read_end), str(os.getpid())]
        # The worker inherits the mask: a Ctrl-C in a terminal reaches it even before it can ignore it.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self.popen = subprocess.Popen(
                [*module, *arguments],
                pass_fds=(theirs.fileno(), read_end),
                env={**os.environ, **ONE_THREAD, "PYTHONPATH": import_path},
                stdin=subprocess.DEVNULL,
            )
        except OSError:
            own.close()
            os.close(self._lifeline)
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            theirs.close()
            os.close(read_end)
        super().__init__(own, factory, timeout_s)

    @property
    def name(self) -> str:
        """Process id."""
        return str(self.popen.pid)

    @property
    def ending(self) -> str:
        """Exit code."""
        return f"exit code {self.popen.returncode}"

    @property
    def cause(self) -> str:
        """Signal, if any, and exit code."""
        return cause_of_death(self.popen.returncode)

    def kill(self) -> None:
        """End the process immediately, even if it has been stopped."""
        self.popen.kill()

    def end(self) -> None:
        """End the process immediately, even if it has been stopped, and wait for its end."""
        self.kill()
        super().end()
        os.close(self._lifeline)
        with suppress(subprocess.TimeoutExpired):
            self.popen.wait(_END_S)


def _header(size: int) -> bytes:
    """Return what `Connection` reads before a message of `size` bytes."""
    return struct.pack("!i", size) if size < 2**31 else struct.pack("!iQ", -1, size)


def cause_of_death(code: int | None) -> str:
    """Return in words how a process with this exit code ended; None is unknown."""
    if code is None or code >= 0:
        return f"exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return f"killed by {name}, exit code {code}"
