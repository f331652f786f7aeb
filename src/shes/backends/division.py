"""The order in which the units of work of a `map` call are handed out.

A worker asks for as many units as it does at a time. If its share takes several rounds, the last ones are cut smaller
and smaller, so that all workers end at the same time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple


class Part(NamedTuple):
    """The units from `start` to `stop`, exclusive, of a task."""

    task: int
    """Number of the task."""
    start: int
    stop: int

    @property
    def units(self) -> int:
        """Number of units."""
        return self.stop - self.start


class Division:
    """The units that no worker has yet."""

    def __init__(self, sizes: Sequence[int], num_workers: int) -> None:
        """Begin with all units of tasks with these `sizes`."""
        self.num_workers = num_workers
        self.units_left = sum(sizes)
        self.share = max(1, -(-self.units_left // num_workers))
        """Units for each worker in an even distribution, rounded up."""
        self._left = deque(Part(task, 0, size) for task, size in enumerate(sizes))
        self._num_expected = 0

    @property
    def wants_worker(self) -> bool:
        """Whether there is work beyond the shares of the workers that will ask for the first time."""
        return self.units_left > self._num_expected * self.share

    def expect(self) -> None:
        """Expect a worker to ask for the first time."""
        self._num_expected += 1

    def meet(self) -> None:
        """Note that an expected worker has asked, or is lost."""
        self._num_expected -= 1

    def take(self, units: int, enough: int) -> list[Part]:
        """Return the next parts: `units` units, or near the end fewer, but not fewer than `enough`; none at the end."""
        most = min(units, max(enough, -(-self.units_left // (2 * self.num_workers))))
        taken: list[Part] = []
        while most and self._left:
            part = self._left.popleft()
            if part.units > most:
                self._left.appendleft(part._replace(start=part.start + most))
                part = part._replace(stop=part.start + most)
            taken.append(part)
            most -= part.units
            self.units_left -= part.units
        return taken

    def give_back(self, parts: Iterable[Part]) -> None:
        """Put the parts of a lost worker before all others."""
        lost = list(parts)
        self._left.extendleft(reversed(lost))
        self.units_left += sum(part.units for part in lost)
