"""A worker process of the processes backend: `python -m shes.backends.process_worker FD LIFELINE PARENT`.

The process dies with its parent. Linux sends it a signal; elsewhere a thread waits for the end of the lifeline pipe,
whose other end only the parent holds open.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection

from shes.backends.serving import serve

_PR_SET_PDEATHSIG = 1


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


def main() -> None:
    """Serve the connection given on the command line."""
    descriptor, lifeline, parent = (int(argument) for argument in sys.argv[1:4])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: the parent decides
    die_with_parent(lifeline, parent)
    with Connection(descriptor) as connection, suppress(EOFError, BrokenPipeError, ConnectionResetError):
        serve(connection, connection.recv_bytes())


if __name__ == "__main__":
    main()
