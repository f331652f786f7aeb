"""The tasks of a `map` call as a worker takes them. A task may be divisible, so that several workers share it."""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Protocol


class Divisible(Protocol):
    """A task of several units of work, which may be done by different workers: any that has `num_units`."""

    @property
    def num_units(self) -> int:
        """Number of units."""
        ...

    def part(self, start: int, stop: int) -> Any:
        """Return the task of the units from `start` to `stop`, exclusive."""
        ...

    def join(self, results: Sequence[Any]) -> Any:
        """Return the result of this task, given those of its parts in order."""
        ...


def num_units(task: Any) -> int:
    """Return the number of units of `task`: 1 if it is not divisible."""
    return getattr(task, "num_units", 1)  # isinstance with a protocol takes 10 microseconds


class TaskSource(Iterator[tuple[int, Any]]):
    """Numbered tasks for a worker: one unit at a time as an iterator, or several by `take`."""

    @abstractmethod
    def take(self, units: int, enough: int | None = None) -> Sequence[tuple[int, Any]]:
        """Return the next tasks, with at most `units` units in all; an empty sequence at the end.

        There may be fewer, but not fewer than `enough` of those that are left, so that all workers end at the same
        time. `enough` is `units` if None. A task may be a part of a larger one.
        """

    def __next__(self) -> tuple[int, Any]:
        for numbered in self.take(1):
            return numbered
        raise StopIteration


class TaskList(TaskSource):
    """The tasks of a single worker, which are not divided."""

    def __init__(self, numbered: Iterable[tuple[int, Any]]) -> None:
        self._left = deque(numbered)

    def take(self, units: int, enough: int | None = None) -> Sequence[tuple[int, Any]]:
        """Return the next tasks with up to `units` units, and at least one task."""
        taken: list[tuple[int, Any]] = []
        while self._left and (not taken or num_units(self._left[0][1]) <= units):
            units -= num_units(self._left[0][1])
            taken.append(self._left.popleft())
        return taken
