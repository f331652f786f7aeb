"""Schedules: quantities that change over the generations, from `start` to `end`, and then stay constant.

A generation is the number of updates so far: 0 for the first.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Value of a quantity in each generation: it changes by a constant factor, or not at all.

    Source: Ha 2017 (estool), `sigma_decay`, `learning_rate_decay`.
    """

    start: float
    """Value in generation 0, positive."""
    end: float | None = None
    """Value from generation `generations` on, positive; None for a constant."""
    generations: int = 1
    """Number of generations from `start` to `end`."""

    def value(self, generation: int) -> float:
        """Return the value in `generation`: exactly `start` in 0, exactly `end` from `generations` on."""
        if generation <= 0 or self.end is None:
            return self.start
        if generation >= self.generations:
            return self.end
        return self.start * (self.end / self.start) ** (generation / self.generations)
