"""A worker process of the processes backend: `python -m shes.backends.process_worker FD LIFELINE PARENT`.

It dies with its parent: by the kernel's signal where there is one, and by a thread that waits for the end of the
lifeline pipe, which only the parent holds open.
"""

from __future__ import annotations

import ctypes
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import Any

from shes.errors import ShesError, WorkerError

__all__ = ["main"]

_PR_SET_PDEATHSIG = 1


def _die_with_parent(lifeline: int, parent: int) -> None:
    """End this process as soon as process `parent` is gone."""

    def wait_for_end() -> None:
        os.read(lifeline, 1)  # returns only at end of file: nobody writes
        os._exit(1)

    threading.Thread(target=wait_for_end, daemon=True).start()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _incoming(connection: Connection) -> Iterator[tuple[int, Any]]:
    """Ask the parent for one task at a time until it says that there is none."""
    while True:
        connection.send(("want",))
        kind, *content = connection.recv()
        if kind == "end":
            return
        number, task = content
        yield number, pickle.loads(task)


def _unpickle_factory(pickled: bytes) -> Callable[[], Any]:
    """Return what makes the worker.

    Raises:
        WorkerError: A module that it comes from is not there.
    """
    try:
        return pickle.loads(pickled)
    except (ImportError, AttributeError) as error:
        raise WorkerError(
            f"a worker process cannot import what its work is made of: {error}. Put the folder of that module on "
            "PYTHONPATH, or install it; or set --backend serial."
        ) from error


def _serve(connection: Connection) -> None:
    """Do what the parent says until it says close."""
    worker = _unpickle_factory(connection.recv_bytes())()
    connection.send(("ready",))
    while True:
        kind, *content = connection.recv()
        if kind == "state":
            worker.receive(pickle.loads(content[0]))
        elif kind == "run":
            for number, result in worker.run(_incoming(connection), content[0]):
                connection.send(("result", number, result))
            connection.send(("done",))
        else:
            return


def main() -> None:
    """Serve the connection named on the command line."""
    descriptor, lifeline, parent = (int(argument) for argument in sys.argv[1:4])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: the parent decides
    _die_with_parent(lifeline, parent)
    with Connection(descriptor) as connection:
        try:
            _serve(connection)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return  # the parent has closed the connection
        except ShesError as error:
            connection.send(("refused", error))
        except BaseException:  # noqa: BLE001 - whatever it is, the parent must hear of it
            connection.send(("failed", traceback.format_exc()))


if __name__ == "__main__":
    main()
