"""The worker's side of a conversation with its parent, over any connection.

A worker answers `("state", number, pickled)` and `("run", share, number)`, whose number is that of the tasks' state. It
keeps its last two states, of a generation and of the evaluation beside it.
In a run it asks for tasks by `("want", results, units, enough)`, is given `("tasks", pickled)` or `("end",)`, and
at last sends `("done", results)`. `results` are the numbered results since its previous message: with hundreds of
workers the parent's time goes into messages, not into bytes. One that comes more than a second after the previous
message is sent at once, by `("results", results)`.
"""

from __future__ import annotations

import os
import pickle
import traceback
from collections.abc import Sequence
from time import monotonic
from typing import Any, Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from shes.backends.factory import unpickle_factory
from shes.backends.work import TaskSource
from shes.errors import ShesError, WorkerError

ONE_THREAD: dict[str, str] = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
"""Environment variables by which linear algebra has one thread. More threads would change rounding."""

NUM_STATES = 2
"""Number of states that a worker keeps."""
KEPT_S = 1.0
"""A result waits for the next message, unless this many seconds have passed since the last one."""
_CLOSED = (EOFError, BrokenPipeError, ConnectionResetError)


class Duplex(Protocol):
    """A connection to the parent.

    Both methods raise EOFError, BrokenPipeError or ConnectionResetError if the parent has closed it.
    """

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
        _serve(_Checked(connection), factory)
    except _ClosedError:
        return
    except ShesError as error:
        connection.send(("refused", error))
    except BaseException:  # noqa: BLE001 - the parent must be told of any error
        connection.send(("failed", traceback.format_exc()))


class _ClosedError(Exception):
    """The parent has closed the connection. The work itself may raise EOFError, from a file or a socket of its own."""


class _Checked:
    """A connection whose end is told from errors of the work."""

    def __init__(self, connection: Duplex) -> None:
        self._connection = connection

    def send(self, message: tuple[Any, ...]) -> None:
        try:
            self._connection.send(message)
        except _CLOSED as error:
            raise _ClosedError from error

    def recv(self) -> tuple[Any, ...]:
        try:
            return self._connection.recv()
        except _CLOSED as error:
            raise _ClosedError from error


def _serve(connection: Duplex, factory: bytes) -> None:
    worker = unpickle_factory(factory)()
    connection.send(("ready",))
    states: dict[int, Any] = {}
    state: int | None = None  # number of the one that the worker has
    while True:
        kind, *content = connection.recv()
        if kind == "state":
            number, pickled = content
            states[number], state = pickle.loads(pickled), number
            worker.receive(states[number])
            if len(states) > NUM_STATES:
                del states[next(iter(states))]
        elif kind == "run":
            share, wanted = content
            if wanted is not None and wanted != state:
                if wanted not in states:
                    known = ", ".join(map(str, states)) or "none"
                    raise WorkerError(f"the work needs state {wanted}, and those that reached this worker are {known}")
                worker.receive(states[wanted])
                state = wanted
            run = _Run(connection)
            for numbered in worker.run(run, share):
                run.keep(numbered)
            run.send("done")
        else:
            return


class _Run(TaskSource):
    """The tasks of a run, which the parent sends when asked, and the results that it has not been sent yet."""

    def __init__(self, connection: Duplex) -> None:
        self._connection = connection
        self._is_over = False
        self._kept: list[tuple[int, Any]] = []
        self._sent_s = monotonic()

    def keep(self, numbered: tuple[int, Any]) -> None:
        """Keep a numbered result for the next message; send it if the last one was long ago."""
        self._kept.append(numbered)
        if monotonic() >= self._sent_s + KEPT_S:
            self.send("results")

    def send(self, kind: str, *content: Any) -> None:
        """Send a message, and in it the results that are kept."""
        self._connection.send((kind, self._kept, *content))
        self._kept = []
        self._sent_s = monotonic()

    def take(self, units: int, enough: int | None = None) -> Sequence[tuple[int, Any]]:
        """Ask the parent for tasks."""
        if self._is_over:
            return ()
        self.send("want", units, units if enough is None else enough)
        kind, *content = self._connection.recv()
        self._is_over = kind == "end"
        return () if self._is_over else pickle.loads(content[0])
