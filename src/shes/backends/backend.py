"""The Backend contract: an ordered map and a broadcast over workers. The serial backend is the shortest example.

A backend does not know what the tasks are.
"""

from __future__ import annotations

import traceback
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Any, ClassVar, Protocol, TypeAlias

from threadpoolctl import threadpool_limits

from shes.errors import ShesError, WorkerError
from shes.machine import num_cores
from shes.settings import Settings


class TaskSource(ABC):
    """The numbered tasks of a `map` call, from which each worker takes its own."""

    @abstractmethod
    def take(self, most: int, least: int) -> Sequence[tuple[int, Any]]:
        """Return the next tasks, at most `most` of them; an empty sequence at the end.

        Near the end there are fewer, so that all workers finish at the same time, but not fewer than `least` while
        there are any.
        """

    def note_progress(self) -> None:  # noqa: B027 - a worker in the same process need not prove that it is alive
        """Show that the worker is alive. A worker whose tasks take longer than seconds calls this now and then."""


class TaskList(TaskSource):
    """The tasks of a single worker."""

    def __init__(self, numbered: Iterable[tuple[int, Any]]) -> None:
        self._left = deque(numbered)

    def take(self, most: int, least: int) -> Sequence[tuple[int, Any]]:
        """Return the next tasks, `most` of them if there are as many."""
        return [self._left.popleft() for _ in range(min(most, len(self._left)))]


class Worker(Protocol):
    """Object that a backend creates in each of its processes."""

    def receive(self, state: Any) -> None:
        """Store the state that the following tasks refer to."""

    def run(self, tasks: TaskSource, share: int) -> Iterator[tuple[int, Any]]:
        """Take numbered tasks from `tasks`, and yield numbered results in any order.

        `share` is the number of tasks per worker in an even distribution. A worker that takes more at once leaves other
        workers idle.
        """
        ...

    def close(self) -> None:
        """Release what it holds, such as environments. More tasks may follow."""


WorkerFactory: TypeAlias = Callable[[], Worker]


class Backend(AbstractContextManager["Backend"]):
    """Distributes tasks over workers. As a context manager, it closes the workers on exit.

    A subclass is made from a `WorkerFactory`, the number of workers, and its `Options` as keyword arguments.
    """

    Options: ClassVar[type[Settings]] = Settings
    """Settings of this backend. Mark each field with `Execution`: a backend never changes the numbers of a run."""
    num_workers: int = 1

    @classmethod
    def all_workers(cls) -> int:
        """Return the number of workers for `--workers 0`: one for every core that this process may use."""
        return num_cores()

    def on_event(self, event: str, /) -> None:
        """Receive a message about silent, lost and replaced workers; replaced by whoever wants to hear of them."""

    @abstractmethod
    def broadcast(self, state: Any) -> None:
        """Send `state` to every worker, for the tasks of the following `map` calls."""

    @abstractmethod
    def map(self, tasks: Sequence[Any]) -> Iterator[Any]:
        """Yield the result of every task, in order; raise a worker's ShesError, or WorkerError for another failure."""

    @abstractmethod
    def close(self) -> None:
        """Close the workers, even if they are busy."""

    def __exit__(self, *exception: object) -> None:
        self.close()


class SerialBackend(Backend):
    """One worker in this process. BLAS is limited to one thread, because more threads would change rounding."""

    def __init__(self, factory: WorkerFactory, num_workers: int = 1) -> None:
        """Create the worker. `num_workers` is ignored."""
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
