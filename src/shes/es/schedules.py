"""Schedules: quantities that change over the generations, from `start` to `end`, and then stay constant.

A generation is the number of updates so far: 0 for the first.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from shes.errors import ConfigError
from shes.registry import Registry, subclass_of

__all__ = ["SCHEDULES", "Constant", "Cosine", "Exponential", "Linear", "Schedule", "make_schedule"]


@dataclass(frozen=True, kw_only=True)
class Schedule(ABC):
    """Value of a quantity in each generation."""

    quantity: str
    """Name of the quantity in messages: `learning_rate`, `sigma` or `episodes`."""
    start: float
    """Value in generation 0."""
    end: float
    """Value from generation `generations` on."""
    generations: int
    """Number of generations from `start` to `end`."""

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ConfigError: `start` or `end` is out of range, or `generations` is not positive.
        """
        self._check_number("start", self.start, zero=False)
        self._check_number("end", self.end, zero=True)
        if self.generations < 1:
            raise ConfigError(
                f"schedule_generations must be a positive whole number, got {self.generations}. "
                "Set --schedule-generations."
            )

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

    def _check_number(self, place: str, number: float, *, zero: bool) -> None:
        """Raise ConfigError if `number` is negative or not finite, or if it is zero and `zero` is false."""
        if not math.isfinite(number) or number < 0 or (number == 0 and not zero):
            allowed = "zero or positive" if zero else "positive"
            fix = f"Set --{self.quantity.replace('_', '-')}-schedule to another one, or change its {place}."
            raise ConfigError(
                f"the {place} of the {type(self).__name__.lower()} schedule of {self.quantity} must be {allowed}, "
                f"got {number}. {fix}"
            )


@dataclass(frozen=True, kw_only=True)
class Constant(Schedule):
    """Always `start`. `end` and `generations` have no effect."""

    end: float = 0.0
    generations: int = 1

    def __post_init__(self) -> None:
        """Check `start`."""
        self._check_number("start", self.start, zero=False)

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
        """Check every value. The end must not be zero."""
        super().__post_init__()
        self._check_number("end", self.end, zero=False)

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
    """Return the schedule registered as `kind`. For the other arguments see `Schedule`.

    Raises:
        UnknownNameError: `kind` is not in `SCHEDULES`.
        ConfigError: `start` or `end` is out of range, or `generations` is not positive.
    """
    schedule = SCHEDULES.find(kind, kind=f"schedule of {quantity}", fix=f"Set --{quantity.replace('_', '-')}-schedule.")
    return schedule(quantity=quantity, start=start, end=end, generations=generations)
