"""The serial backend: the work is done in this process."""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Sequence
from typing import Any

from threadpoolctl import threadpool_limits

from shes.backends.backend import Backend, Worker, WorkerFactory
from shes.errors import ShesError, WorkerError

__all__ = ["SerialBackend"]


class SerialBackend(Backend):
    """One worker, here. Its linear algebra is held to one thread, because threads change bits."""

    def __init__(self, factory: WorkerFactory) -> None:
        """Make the worker."""
        self.num_workers = 1
        self._worker: Worker = factory()

    def broadcast(self, state: Any) -> None:
        """Give `state` to the worker."""
        self._worker.receive(state)

    def map(self, tasks: Sequence[Any]) -> Iterator[Any]:
        """Yield the result of every task, in order."""
        waiting: dict[int, Any] = {}
        due = 0
        with threadpool_limits(1):
            for number, result in self._results(tasks):
                waiting[number] = result
                while due in waiting:
                    yield waiting.pop(due)
                    due += 1

    def _results(self, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        """Yield numbered results as the worker makes them."""
        try:
            yield from self._worker.run(iter(enumerate(tasks)), max(1, len(tasks)))
        except ShesError:
            raise
        except Exception as error:
            raise WorkerError(f"the worker failed:\n{traceback.format_exc()}") from error

    def close(self) -> None:
        """Do nothing: there is no process to end."""
