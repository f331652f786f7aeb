"""The Backend contract: an ordered map over workers, and a broadcast. It knows nothing of what the work is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

__all__ = ["Backend", "Worker", "WorkerFactory"]


class Worker(Protocol):
    """What a backend starts copies of, one per process."""

    def receive(self, state: Any) -> None:
        """Take the state that the following tasks refer to."""

    def run(self, work: Iterator[tuple[int, Any]], share: int) -> Iterator[tuple[int, Any]]:
        """Take numbered tasks from `work` as it has room, and yield numbered results in any order.

        `share` is the number of tasks that an even distribution gives to a worker: taking many more at once would leave
        others idle.
        """
        ...


WorkerFactory = Callable[[], Worker]


class Backend(ABC):
    """Spreads tasks over workers. A context manager: leaving it ends the workers."""

    num_workers: int
    """Number of workers."""

    @abstractmethod
    def broadcast(self, state: Any) -> None:
        """Give `state` to every worker before the tasks of the next `map`."""

    @abstractmethod
    def map(self, tasks: Sequence[Any]) -> Iterator[Any]:
        """Yield the result of every task, in order.

        Raises:
            ShesError: As a worker raised it.
            WorkerError: A worker raised something else, or workers keep dying.
        """

    @abstractmethod
    def close(self) -> None:
        """End the workers, at once if they are at work."""

    def take_events(self) -> list[str]:
        """Return, once, what happened to the workers since the last call (lost, replaced)."""
        return []

    def __enter__(self) -> Backend:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
