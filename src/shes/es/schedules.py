"""Schedules: quantities that change over the generations, from `start` to `end`, and then stay constant.

A generation is the number of updates so far: 0 for the first.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from shes.errors import ConfigError
from shes.registry import Registry, subclass_of


@dataclass(frozen=True, kw_only=True)
class Schedule(ABC):
    """Value of a quantity in each generation."""

    quantity: str
    """Name of the quantity in messages: `learning_rate`, `sigma` or `episodes`."""
    start: float
    """Value in generation 0, positive."""
    end: float
    """Value from generation `generations` on, zero or positive."""
    generations: int
    """Number of generations from `start` to `end`."""

    def value(self, generation: int) -> float:
        """Return the value in `generation`: exactly `start` in 0, exactly `end` from `generations` on."""
        if generation <= 0:
            return self.start
        if generation >= self.generations:
            return self.end
        return self.between(generation / self.generations)

    @abstractmethod
    def between(self, progress: float) -> float:
        """Return the value at the fraction `progress` of the schedule, inside (0, 1)."""


@dataclass(frozen=True, kw_only=True)
class Constant(Schedule):
    """Always `start`. `end` and `generations` have no effect."""

    end: float = 0.0
    generations: int = 1

    def value(self, generation: int) -> float:
        """Return `start`."""
        return self.start

    def between(self, progress: float) -> float:
        """Return `start`."""
        return self.start


@dataclass(frozen=True, kw_only=True)
class Linear(Schedule):
    """Constant difference per generation. Source: Mnih et al. 2015, Methods (annealed exploration)."""

    def between(self, progress: float) -> float:
        """Return the value on the straight line."""
        return self.start + (self.end - self.start) * progress


@dataclass(frozen=True, kw_only=True)
class Exponential(Schedule):
    """Constant factor per generation. Source: Ha 2017 (estool), `sigma_decay`, `learning_rate_decay`."""

    def __post_init__(self) -> None:
        """Raise ConfigError if `end` is zero, which a factor cannot reach."""
        if not self.end:
            raise ConfigError(
                f"the end of the exponential schedule of {self.quantity} must be positive, got {self.end}. "
                f"Set --{self.quantity.replace('_', '-')}-schedule to another one, or change its end."
            )

    def between(self, progress: float) -> float:
        """Return the value on the geometric curve."""
        return self.start * (self.end / self.start) ** progress


@dataclass(frozen=True, kw_only=True)
class Cosine(Schedule):
    """Half a cosine wave, slow at both ends. Source: Loshchilov and Hutter 2017 (SGDR), equation 5, no restarts."""

    def between(self, progress: float) -> float:
        """Return the value on the half wave."""
        return self.end + (self.start - self.end) * (1 + math.cos(math.pi * progress)) / 2


SCHEDULES: Registry[type[Schedule]] = Registry(
    "schedule",
    {"constant": Constant, "linear": Linear, "exponential": Exponential, "cosine": Cosine},
    fix="Set --learning-rate-schedule.",
    check=subclass_of(Schedule, keywords=("quantity", "start", "end", "generations")),
)
"""Schedules by name: the choices of `--learning-rate-schedule`, `--sigma-schedule` and `--episodes-schedule`."""


def make_schedule(quantity: str, kind: str, start: float, end: float, generations: int) -> Schedule:
    """Return the schedule registered as `kind`. For the other arguments see `Schedule`."""
    schedule = SCHEDULES.find(kind, kind=f"schedule of {quantity}", fix=f"Set --{quantity.replace('_', '-')}-schedule.")
    return schedule(quantity=quantity, start=start, end=end, generations=generations)
