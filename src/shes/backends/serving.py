"""The worker's side of a conversation with its parent, over any connection, and the factory on its way to a worker.

The worker asks and the parent answers; in between, neither sends anything. `results` are the numbered results since
the worker's previous request: with hundreds of workers the parent's time goes into messages, not into bytes.

| request | answer |
|---|---|
| `("ready", results)`: the worker has no tasks | `("run", share)` and a new state, as soon as there are tasks |
| `("want", results, most, least)`: see `TaskSource.take` | `("tasks", numbered)`, empty at the end |
| `("results", results)`: it has been silent for long | `("noted",)` |
| `("failed", error, text)`: the last request | none |
"""

from __future__ import annotations

import os
import pickle
import sys
import traceback
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any, TypeAlias

import cloudpickle
import numpy as np
from threadpoolctl import threadpool_limits

from shes.backends.backend import TaskSource, Worker, WorkerFactory
from shes.errors import ConfigError, ShesError, WorkerError

ONE_THREAD: dict[str, str] = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)
"""Environment variables by which linear algebra has one thread. More threads would change rounding."""
RESULTS_WAIT_S, LONGEST_SILENCE_S = 1.0, 10.0
"""Seconds since its last request after which a worker sends a result, or only its progress, in a request of its own."""
Answer: TypeAlias = tuple[tuple[Any, ...], bytes | None]
"""An answer of the parent, and the pickled state that comes with it."""


class ClosedError(BaseException):
    """The parent has closed the connection. Not an Exception, so that an environment does not catch it."""


class ParentConnection(ABC):
    """A connection to the parent. Every method but `leave` raises ClosedError if the parent has closed it."""

    @abstractmethod
    def tell(self, *request: Any) -> None:
        """Send a request."""

    @abstractmethod
    def receive(self) -> Answer:
        """Wait for the answer to a request."""

    def check(self) -> None:  # noqa: B027 - a signal may close the connection
        """Do nothing, unless the parent has closed it."""

    def leave(self) -> None:  # noqa: B027 - of most there is nothing to ignore
        """Ignore the parent from now on: the worker is about to end."""


def serve(parent: ParentConnection, factory: bytes, clock: Callable[[], float] = monotonic) -> None:
    """Make the worker by the pickled `factory`, do the parent's tasks until it closes the connection, and close it."""
    assert np  # loaded, with its BLAS
    threadpool_limits(1)
    os.environ.update(ONE_THREAD)  # for the libraries that will be loaded
    worker: Worker | None = None
    try:
        worker = _unpickle_factory(factory)()
        run = _Run(parent, clock)
        while True:
            (_, share), state = run.ask("ready")
            if state is not None:
                worker.receive(pickle.loads(state))
            run.is_over = False
            for numbered in worker.run(run, share):
                run.kept.append(numbered)
                run.note_progress()
    except ClosedError:
        pass
    except BaseException as error:  # noqa: BLE001 - the parent must be told of any error
        pickled = None
        with suppress(Exception):  # an error that cannot be pickled is told by its traceback
            pickled = pickle.dumps(error) if isinstance(error, ShesError) else None
        with suppress(ClosedError):
            parent.tell("failed", pickled, traceback.format_exc())
    finally:
        parent.leave()
        if worker is not None:
            worker.close()


class _Run(TaskSource):
    """The tasks that the parent sends when asked, and the results that it has not been sent yet."""

    def __init__(self, parent: ParentConnection, clock: Callable[[], float]) -> None:
        self._parent, self._clock = parent, clock
        self.is_over = False
        self.kept: list[tuple[int, Any]] = []
        self._sent_s = clock()

    def ask(self, kind: str, *content: Any) -> Answer:
        """Send a request, and in it the results that are kept; return the answer."""
        self._parent.tell(kind, self.kept, *content)
        answer = self._parent.receive()
        self.kept = []
        self._sent_s = self._clock()
        return answer

    def note_progress(self) -> None:
        """Send the results that are kept, or only a sign of life, if the last request was long ago."""
        self._parent.check()
        if self._clock() >= self._sent_s + (RESULTS_WAIT_S if self.kept else LONGEST_SILENCE_S):
            self.ask("results")

    def take(self, most: int, least: int) -> Sequence[tuple[int, Any]]:
        """Ask the parent for tasks."""
        if self.is_over:
            return ()
        (_, given), _ = self.ask("want", most, least)
        self.is_over = not given
        return given


def pickle_factory(factory: WorkerFactory) -> bytes:
    """Return `factory` pickled, and classes of the caller's script by value; raise ConfigError if that fails."""
    try:
        return cloudpickle.dumps(factory)
    except Exception as error:
        raise ConfigError(
            f"the work cannot be sent to worker processes: {error}. Move what your own class refers to into a module "
            "next to your script, which workers import, or set --backend serial."
        ) from error


def _unpickle_factory(pickled: bytes) -> WorkerFactory:
    try:
        return pickle.loads(pickled)
    except (ImportError, AttributeError) as error:
        raise WorkerError(
            f"a worker process cannot import a module that its work needs: {error}. Put the folder of that module on "
            "PYTHONPATH, install the module, or set --backend serial."
        ) from error


def import_path() -> list[str]:
    """Return the import path of this process, on which workers find the modules of the caller's classes."""
    path = [entry for entry in sys.path if entry]
    # An empty entry is the working directory: of a notebook, of `python -c`. Workers search it last, so that no file
    # there replaces a module of the standard library. It is resolved now, because it may change later.
    if len(path) < len(sys.path):
        with suppress(FileNotFoundError):
            path.append(str(Path.cwd()))
    return path
