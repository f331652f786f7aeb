"""A worker process of the processes backend: `python -m shes.backends.process_worker FD LIFELINE PARENT`.

The process dies with its parent. Linux sends it a signal; elsewhere a thread waits for the end of the lifeline pipe,
whose other end only the parent holds open.
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

_PR_SET_PDEATHSIG = 1


def _die_with_parent(lifeline: int, parent: int) -> None:
    """End this process when process `parent` ends."""

    def wait_for_end() -> None:
        os.read(lifeline, 1)  # returns only at end of file: nobody writes
        os._exit(1)

    threading.Thread(target=wait_for_end, daemon=True).start()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _incoming(connection: Connection) -> Iterator[tuple[int, Any]]:
    """Request tasks from the parent, one at a time, until none are left."""
    while True:
        connection.send(("want",))
        kind, *content = connection.recv()
        if kind == "end":
            return
        number, task = content
        yield number, pickle.loads(task)


def _unpickle_factory(pickled: bytes) -> Callable[[], Any]:
    """Return the function that creates the worker; raise WorkerError if a module that it needs cannot be imported."""
    try:
        return pickle.loads(pickled)
    except (ImportError, AttributeError) as error:
        raise WorkerError(
            f"a worker process cannot import a module that its work needs: {error}. Put the folder of that module on "
            "PYTHONPATH, install the module, or set --backend serial."
        ) from error


def _serve(connection: Connection) -> None:
    """Follow the parent's messages until it closes the worker."""
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
    """Serve the connection given on the command line."""
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
        except BaseException:  # noqa: BLE001 - the parent must be told of any error
            connection.send(("failed", traceback.format_exc()))


if __name__ == "__main__":
    main()
