"""The worker's side of a conversation with its parent, over any connection.

A worker answers `("state", pickled)` and `("run", share)`. In a run it asks for tasks by `("want", units, enough)`, is
given `("tasks", pickled)` or `("end",)`, and sends `("result", number, result)` and at last `("done",)`.
"""

from __future__ import annotations

import os
import pickle
import traceback
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from shes.backends.factory import unpickle_factory
from shes.backends.work import TaskSource
from shes.errors import ShesError

ONE_THREAD: dict[str, str] = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
"""Environment variables by which linear algebra has one thread. More threads would change rounding."""


class Duplex(Protocol):
    """A connection to the parent. Both methods raise EOFError or ConnectionError if the parent has closed it."""

    def send(self, message: tuple[Any, ...], /) -> None:
        """Send a message."""

    def recv(self) -> tuple[Any, ...]:
        """Return the next message."""
        ...


def use_one_thread() -> None:
    """Limit linear algebra in this process to one thread: libraries that are loaded already, and those that will be."""
    assert np  # loaded, with its BLAS
    os.environ.update(ONE_THREAD)
    threadpool_limits(1)


def serve(connection: Duplex, factory: bytes) -> None:
    """Make the worker by the pickled `factory`, and follow the parent's messages until it closes the connection."""
    try:
        _serve(connection, factory)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except ShesError as error:
        connection.send(("refused", error))
    except BaseException:  # noqa: BLE001 - the parent must be told of any error
        connection.send(("failed", traceback.format_exc()))


def _serve(connection: Duplex, factory: bytes) -> None:
    worker = unpickle_factory(factory)()
    connection.send(("ready",))
    while True:
        kind, *content = connection.recv()
        if kind == "state":
            worker.receive(pickle.loads(content[0]))
        elif kind == "run":
            for number, result in worker.run(_Incoming(connection), content[0]):
                connection.send(("result", number, result))
            connection.send(("done",))
        else:
            return


class _Incoming(TaskSource):
    """The tasks of a run, which the parent sends when asked."""

    def __init__(self, connection: Duplex) -> None:
        self._connection = connection
        self._is_over = False

    def take(self, units: int, enough: int | None = None) -> Sequence[tuple[int, Any]]:
        """Ask the parent for tasks."""
        if self._is_over:
            return ()
        self._connection.send(("want", units, units if enough is None else enough))
        kind, *content = self._connection.recv()
        self._is_over = kind == "end"
        return () if self._is_over else pickle.loads(content[0])
