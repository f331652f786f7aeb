"""The Backend contract: an ordered map and a broadcast over workers. A backend does not know what the work is."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar, Protocol, TypeAlias

from shes.backends.work import TaskSource
from shes.cores import num_cores
from shes.settings import Settings


class Worker(Protocol):
    """Object that a backend creates in each of its processes."""

    def receive(self, state: Any) -> None:
        """Store the state that the following tasks refer to."""

    def run(self, work: TaskSource, share: int) -> Iterator[tuple[int, Any]]:
        """Take numbered tasks from `work` and yield numbered results in any order.

        `share` is the number of units per worker in an even distribution; a task that is not divisible is one unit. A
        worker that takes more at once leaves other workers idle.
        """
        ...


WorkerFactory: TypeAlias = Callable[[], Worker]


class Pending(Protocol):
    """Work that is done beside other work."""

    @property
    def is_done(self) -> bool:
        """Whether all of it is done."""
        ...

    def results(self) -> list[Any]:
        """Return the result of every task, in order. What is left of the work is done first."""
        ...


class _Done:
    """Work that has been done."""

    is_done = True

    def __init__(self, results: list[Any]) -> None:
        self._results = results

    def results(self) -> list[Any]:
        return self._results


class Backend(ABC):
    """Distributes tasks over workers. As a context manager, it closes the workers on exit.

    A subclass is made from a `WorkerFactory`, the number of workers, and its `Options` as keyword arguments.
    """

    Options: ClassVar[type[Settings]] = Settings
    """Settings of this backend. Mark each field with `Execution`: a backend never changes the numbers of a run."""
    num_workers: int = 1
    on_event: Callable[[str], None] | None = None
    """Receives messages about silent, lost and replaced workers, if any function is set."""

    @classmethod
    def all_workers(cls) -> int:
        """Return the number of workers for `--workers 0`: one for every core that this process may use."""
        return num_cores()

    @staticmethod  # noqa: B027 - most need no package
    def check_installed() -> None:
        """Check that the packages it needs are installed.

        Raises:
            MissingExtraError: One is not.
        """

    @abstractmethod
    def broadcast(self, state: Any) -> None:
        """Send `state` to every worker, for the tasks of the following `map` calls."""

    @abstractmethod
    def map(self, tasks: Sequence[Any]) -> Iterator[Any]:
        """Yield the result of every task, in order.

        Raises:
            ShesError: A worker raised this error.
            WorkerError: A worker raised another error, or workers keep dying.
        """

    def beside(self, tasks: Sequence[Any], state: Any) -> Pending:
        """Do `tasks`, which refer to `state`, beside those of the next `map` call. By default they are done at once.

        The next `map` call needs a `broadcast` of its own.
        """
        self.broadcast(state)
        return _Done(list(self.map(tasks)))

    @abstractmethod
    def close(self) -> None:
        """Stop the workers immediately, even if they are busy."""

    def __enter__(self) -> Backend:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
