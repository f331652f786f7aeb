"""A model of a worker: episodes of known lengths in lockstep, whose steps take as long as measured.

`shes.bench.simulation` runs it in simulated time, and `shes.bench.sleepers` in real time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from shes.types import F64Array, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class StepCost:
    """Seconds of a step of episodes in lockstep."""

    rows: IntArray
    """Measured numbers of episodes, ascending."""
    seconds: F64Array
    """Seconds of a step for each number."""
    row_s: float
    """Seconds that an episode saves in each step after its end: its physics."""

    def of(self, rows: int, running: int) -> float:
        """Return the seconds of a step of a worker that began with `rows` episodes, of which some are `running`."""
        whole = float(np.interp(rows, self.rows, self.seconds))
        if rows > self.rows[-1]:
            whole *= rows / float(self.rows[-1])
        return max(whole - (rows - running) * self.row_s, 0.0)


@dataclass(kw_only=True)
class Lockstep:
    """Episodes that a worker runs in lockstep, up to `rows` of them; the rules are those of `RolloutWorker`."""

    cost: StepCost
    rows: int
    _left: dict[int, list[int]] = field(default_factory=dict)  # steps left of the episodes of each task
    _asked_at: int | None = None  # number of tasks after the last question
    _size: int = 0  # number of episodes of the tasks at work

    @property
    def is_idle(self) -> bool:
        """Whether no episode is running."""
        return not self._left

    @property
    def room(self) -> int:
        """Number of episodes to ask for; 0 until a task has its result."""
        has_fewer = self.is_idle or self._asked_at is None or len(self._left) < self._asked_at
        return max(0, self.rows - self._size) if has_fewer else 0

    def add(self, number: int, lengths: Sequence[int]) -> None:
        """Begin a task whose episodes have these `lengths`."""
        self._left[number] = list(lengths)
        self._size += len(lengths)
        self._asked_at = len(self._left)

    def advance(self) -> tuple[float, list[int]]:
        """Run until the next episodes end; return the seconds that it took, and the numbers of finished tasks."""
        running = [steps for lengths in self._left.values() for steps in lengths if steps]
        steps, size = min(running), self._size
        self._left = {number: [max(0, left - steps) for left in lengths] for number, lengths in self._left.items()}
        finished = [number for number, lengths in self._left.items() if not any(lengths)]
        for number in finished:
            self._size -= len(self._left.pop(number))
        return steps * self.cost.of(size, len(running)), finished
