"""A worker process of the processes backend: `python -m shes.backends.process_worker FD PARENT`.

The process dies with its parent: Linux sends it a signal, and elsewhere a thread notices it.
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
import time
from typing import Any

from shes.backends.serving import ClosedError, serve

FRAME = struct.Struct("!QQ")
"""Lengths of a message and of the pickled state after it."""
_PR_SET_PDEATHSIG = 1
_WATCH_S = 0.5


class _PipeToParent:
    """The connection of a worker process to its parent, which closes it by SIGTERM."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection
        self._reader = connection.makefile("rb")

    def ask(self, *request: Any) -> tuple[tuple[Any, ...], bytes | None]:
        self.tell(*request)
        message, state = self.receive()
        return pickle.loads(message), state

    def tell(self, *request: Any) -> None:
        message = pickle.dumps(request, pickle.HIGHEST_PROTOCOL)
        try:
            self._socket.sendall(FRAME.pack(len(message), 0) + message)
        except OSError as error:
            raise ClosedError from error

    def receive(self) -> tuple[bytes, bytes | None]:
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
        signal.signal(signal.SIGTERM, signal.SIG_IGN)


def _die_with(parent: int) -> None:
    """End this process when process `parent` ends."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_S)
        os._exit(1)

    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)
    else:
        threading.Thread(target=watch, daemon=True).start()


def _raise_closed(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise ClosedError


def main() -> None:
    """Serve the connection given on the command line."""
    descriptor, parent = (int(argument) for argument in sys.argv[1:3])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: the parent decides
    _die_with(parent)
    pipe = _PipeToParent(socket.socket(fileno=descriptor))
    try:
        signal.signal(signal.SIGTERM, _raise_closed)
        factory, _ = pipe.receive()
        serve(pipe, factory)
    except ClosedError:
        return


if __name__ == "__main__":
    main()
