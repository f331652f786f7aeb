"""The serial backend: runs the tasks in this process."""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Sequence
from typing import Any

from threadpoolctl import threadpool_limits

from shes.backends.backend import Backend, TaskList, WorkerFactory
from shes.errors import ShesError, WorkerError


class SerialBackend(Backend):
    """One worker in this process. BLAS is limited to one thread, because more threads would change rounding."""

    def __init__(self, factory: WorkerFactory, num_workers: int = 1) -> None:
        """Create the worker. `num_workers` is ignored."""
        self.num_workers = 1
        self._worker = factory()

    def broadcast(self, state: Any) -> None:
        """Send `state` to the worker."""
        self._worker.receive(state)

    def map(self, tasks: Sequence[Any]) -> Iterator[Any]:
        """Yield the result of every task, in order."""
        results: dict[int, Any] = {}
        next_number = 0
        with threadpool_limits(1):
            try:
                for number, result in self._worker.run(TaskList(enumerate(tasks)), max(1, len(tasks))):
                    results[number] = result
                    while next_number in results:
                        yield results.pop(next_number)
                        next_number += 1
            except ShesError:
                raise
            except Exception as error:
                raise WorkerError(f"the worker failed:\n{traceback.format_exc()}") from error

    def close(self) -> None:
        """Close the worker."""
        self._worker.close()
