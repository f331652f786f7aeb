"""Schedules: quantities that change over the generations, from `start` to `end`, and then stay constant.

A generation is the number of updates so far: 0 for the first.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass


def _linear(start: float, end: float, progress: float) -> float:
    """Constant difference per generation. Source: Mnih et al. 2015, Methods (annealed exploration)."""
    return start + (end - start) * progress


def _exponential(start: float, end: float, progress: float) -> float:
    """Constant factor per generation. Source: Ha 2017 (estool), `sigma_decay`, `learning_rate_decay`."""
    return start * (end / start) ** progress


def _cosine(start: float, end: float, progress: float) -> float:
    """Half a cosine wave, slow at both ends. Source: Loshchilov and Hutter 2017 (SGDR), equation 5, no restarts."""
    return end + (start - end) * (1 + math.cos(math.pi * progress)) / 2


_BETWEEN: dict[str, Callable[[float, float, float], float]] = {
    "linear": _linear,
    "exponential": _exponential,
    "cosine": _cosine,
}
"""Value at a fraction of the schedule inside (0, 1), by the kind of the schedule. A new one is a line here."""
SCHEDULES = ("constant", *_BETWEEN)
"""The choices of `--learning-rate-schedule`, `--sigma-schedule` and `--episodes-schedule`."""


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Value of a quantity in each generation."""

    kind: str = "constant"
    """One of `SCHEDULES`."""
    start: float
    """Value in generation 0, positive."""
    end: float = 0.0
    """Value from generation `generations` on, zero or positive; positive if exponential. A constant has none."""
    generations: int = 1
    """Number of generations from `start` to `end`."""

    def value(self, generation: int) -> float:
        """Return the value in `generation`: exactly `start` in 0, exactly `end` from `generations` on."""
        if generation <= 0 or self.kind == "constant":
            return self.start
        if generation >= self.generations:
            return self.end
        return _BETWEEN[self.kind](self.start, self.end, generation / self.generations)
