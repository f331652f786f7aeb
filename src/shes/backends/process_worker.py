"""A worker process of the processes backend: `python -m shes.backends.process_worker FD LIFELINE PARENT`.

The process dies with its parent. Linux sends it a signal; elsewhere a thread waits for the end of the lifeline pipe,
whose other end only the parent holds open.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import socket
import struct
import sys
import threading
from typing import Any

from shes.backends.serving import ClosedError, serve

FRAME = struct.Struct("!QQ")
"""Lengths of a message and of the pickled state after it."""
_PR_SET_PDEATHSIG = 1


class PipeToParent:
    """The connection of a worker process to its parent, which closes it by SIGTERM."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._reader = connection.makefile("rb")

    def ask(self, *request: Any) -> tuple[tuple[Any, ...], bytes | None]:
        """Send a request; return the answer and the pickled state that comes with it."""
        self.tell(*request)
        message, state = self.receive()
        return pickle.loads(message), state

    def tell(self, *request: Any) -> None:
        """Send a request that has no answer."""
        message = pickle.dumps(request, pickle.HIGHEST_PROTOCOL)
        try:
            self._socket.sendall(FRAME.pack(len(message), 0) + message)
        except OSError as error:
            raise ClosedError from error

    def receive(self) -> tuple[bytes, bytes | None]:
        """Return a message, and the pickled state if one comes with it."""
        message_size, state_size = FRAME.unpack(self._read(FRAME.size))
        return self._read(message_size), self._read(state_size) or None

    def _read(self, size: int) -> bytes:
        try:
            found = self._reader.read(size)
        except OSError as error:
            raise ClosedError from error
        if len(found) < size:
            raise ClosedError
        return found

    def check(self) -> None:
        """Do nothing: the signal raises ClosedError wherever the worker is."""

    def leave(self) -> None:
        """Ignore the parent's signal from now on."""
        signal.signal(signal.SIGTERM, signal.SIG_IGN)


def die_with_parent(lifeline: int, parent: int) -> None:
    """End this process when process `parent` ends."""

    def wait_for_end() -> None:
        os.read(lifeline, 1)  # returns only at end of file: nobody writes
        os._exit(1)

    threading.Thread(target=wait_for_end, daemon=True).start()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _raise_closed(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise ClosedError


def main() -> None:
    """Serve the connection given on the command line."""
    descriptor, lifeline, parent = (int(argument) for argument in sys.argv[1:4])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: the parent decides
    die_with_parent(lifeline, parent)
    pipe = PipeToParent(socket.socket(fileno=descriptor))
    try:
        signal.signal(signal.SIGTERM, _raise_closed)
        factory, _ = pipe.receive()
        serve(pipe, factory)
    except ClosedError:
        return


if __name__ == "__main__":
    main()
