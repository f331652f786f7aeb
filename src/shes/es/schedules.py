"""Schedules: quantities that change over the generations, from `start` to `end`, and then stay constant.

A generation is the number of updates so far: 0 for the first.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from shes.options import subclass_of
from shes.registry import Registry


class ScheduleKind(ABC):
    """How a quantity goes from its start to its end."""

    can_end_at_zero: ClassVar[bool] = True

    @abstractmethod
    def between(self, start: float, end: float, progress: float) -> float:
        """Return the value at `progress`, a fraction of the schedule inside (0, 1)."""


class Constant(ScheduleKind):
    """No change."""

    def between(self, start: float, end: float, progress: float) -> float:
        """Return the start."""
        return start


class Linear(ScheduleKind):
    """Constant difference per generation. Source: Mnih et al. 2015, Methods (annealed exploration)."""

    def between(self, start: float, end: float, progress: float) -> float:
        """Return the value on the line."""
        return start + (end - start) * progress


class Exponential(ScheduleKind):
    """Constant factor per generation. Source: Ha 2017 (estool), `sigma_decay`, `learning_rate_decay`."""

    can_end_at_zero = False

    def between(self, start: float, end: float, progress: float) -> float:
        """Return the value on the exponential curve."""
        return start * (end / start) ** progress


class Cosine(ScheduleKind):
    """Half a cosine wave, slow at both ends. Source: Loshchilov and Hutter 2017 (SGDR), equation 5, no restarts."""

    def between(self, start: float, end: float, progress: float) -> float:
        """Return the value on the wave."""
        return end + (start - end) * (1 + math.cos(math.pi * progress)) / 2


SCHEDULES: Registry[type[ScheduleKind]] = Registry(
    "schedule",
    {"constant": Constant, "linear": Linear, "exponential": Exponential, "cosine": Cosine},
    fix="Set --learning-rate-schedule, --sigma-schedule or --episodes-schedule.",
    check=subclass_of(ScheduleKind),
)
"""Schedules by name: the choices of `--learning-rate-schedule`, `--sigma-schedule` and `--episodes-schedule`."""


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
        return SCHEDULES.find(self.kind)().between(self.start, self.end, generation / self.generations)
