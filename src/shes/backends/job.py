"""The tasks of a `map` call, their parts at the workers, and their results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import count
from typing import Any

from shes.backends.division import Division, Part
from shes.backends.work import num_units


class State:
    """A state of the tasks, pickled, in the form in which a backend sends it."""

    _numbers = count()

    def __init__(self, pickled: bytes) -> None:
        self.pickled = pickled
        self.number = next(self._numbers)
        """Number by which a run of tasks refers to it."""
        self.stored: Any = None
        """Reference to it where an engine has stored it."""


class Job:
    """Tasks that refer to one state. Workers do parts of them, under numbers of their own."""

    def __init__(self, tasks: Sequence[Any], state: State | None, num_workers: int) -> None:
        self.state = state
        sizes = [num_units(task) for task in tasks]
        self.division = Division(sizes, num_workers)
        self._losses: Counter[tuple[int, int]] = Counter()  # workers that were lost at each unit of each task
        self._tasks = tasks
        self._parts: list[Part] = []
        self._results: list[dict[int, Any]] = [{} for _ in tasks]  # of each task, by the first unit of the part
        self._units_missing = sizes
        self._num_missing = len(tasks)
        self._next = 0

    @property
    def is_done(self) -> bool:
        """Whether every task has its result."""
        return not self._num_missing

    def give(self, units: int, enough: int) -> list[tuple[int, Any]]:
        """Return the next parts with their numbers; see `Division.take`."""
        first = len(self._parts)
        self._parts += self.division.take(units, enough)
        return [(number, self.task(number)) for number in range(first, len(self._parts))]

    def task(self, number: int) -> Any:
        """Return the task, or the part of a task, with this number."""
        part = self._parts[number]
        task = self._tasks[part.task]
        return task if part.units == num_units(task) else task.part(part.start, part.stop)

    def take_back(self, numbers: Sequence[int]) -> None:
        """Take back the parts of a lost worker."""
        parts = [self._parts[number] for number in numbers]
        self.division.give_back(parts)
        self._losses.update(self._units(numbers))

    @property
    def has_losses(self) -> bool:
        """Whether workers were lost with parts of it."""
        return bool(self._losses)

    def most_losses(self, numbers: Sequence[int]) -> tuple[int, int | None]:
        """Return how many workers were lost at one unit of these parts, at most, and the number of its task."""
        unit = max(self._units(numbers), key=self._losses.__getitem__, default=None)
        return (0, None) if unit is None else (self._losses[unit], unit[0])

    def _units(self, numbers: Sequence[int]) -> list[tuple[int, int]]:
        parts = [self._parts[number] for number in numbers]
        return [(part.task, unit) for part in parts for unit in range(part.start, part.stop)]

    def add(self, number: int, result: Any) -> None:
        """Keep the result of a part."""
        part = self._parts[number]
        self._results[part.task][part.start] = result
        self._units_missing[part.task] -= part.units
        self._num_missing -= not self._units_missing[part.task]

    def finished(self) -> Iterator[Any]:
        """Yield the results of the next tasks that are done, in order and once."""
        while self._next < len(self._tasks) and not self._units_missing[self._next]:
            task, parts = self._tasks[self._next], self._results[self._next]
            self._results[self._next] = {}
            self._next += 1
            results = [parts[start] for start in sorted(parts)]
            yield results[0] if len(results) == 1 else task.join(results)
