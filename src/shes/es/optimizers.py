"""Optimizers: how a gradient estimate moves the parameters. Their state is data, their step a pure function.

All of them ascend: the gradient estimate [D] points uphill, and a step [D] is added to the parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from shes.errors import ConfigError
from shes.registry import Registry, subclass_of
from shes.types import F32Array, F64Array

__all__ = ["OPTIMIZERS", "SGD", "Adam", "ClipUp", "Optimizer", "OptimizerState", "make_optimizer"]


@dataclass(frozen=True, kw_only=True)
class OptimizerState:
    """What an optimizer carries from one update to the next."""

    steps: int
    """Updates made so far."""
    slots: dict[str, F32Array]
    """The optimizer's running vectors [D] by name: one for each of its `slots`. Never changed in place."""


class Optimizer(ABC):
    """From a gradient estimate to a step."""

    slots: ClassVar[tuple[str, ...]]
    """Names of the running vectors in its state."""

    def start(self, dim: int) -> OptimizerState:
        """Return the state before the first update of `dim` parameters."""
        return OptimizerState(steps=0, slots={name: np.zeros(dim, np.float32) for name in self.slots})

    @abstractmethod
    def step(self, gradient: F32Array, state: OptimizerState, learning_rate: float) -> tuple[F32Array, OptimizerState]:
        """Return the step [D] to add to the parameters, and the next state; the arguments stay as they are.

        Args:
            gradient: Gradient estimate [D], uphill.
            state: State after the update before.
            learning_rate: Scale of the step.
        """

    @classmethod
    def of(cls, *, momentum: float) -> Self:
        """Return this optimizer with those of the options that concern it."""
        del momentum
        return cls()


@dataclass(frozen=True, kw_only=True)
class Adam(Optimizer):
    """Adam. Source: Kingma and Ba 2014, end of section 2 (bias correction folded into the rate)."""

    slots: ClassVar[tuple[str, ...]] = ("first", "second")
    """Running means of the gradient and of the squared gradient."""

    beta1: float = 0.9
    beta2: float = 0.999
    epsilon: float = 1e-8

    def step(self, gradient: F32Array, state: OptimizerState, learning_rate: float) -> tuple[F32Array, OptimizerState]:
        """Return the step [D] and the next state."""
        steps = state.steps + 1
        first = _mix(state.slots["first"], gradient, self.beta1)
        second = _mix(state.slots["second"], gradient * gradient, self.beta2)
        rate = learning_rate * np.sqrt(1 - self.beta2**steps) / (1 - self.beta1**steps)
        step = np.float32(rate) * first / (np.sqrt(second) + np.float32(self.epsilon))
        return step.astype(np.float32, copy=False), _state(steps, first=first, second=second)


@dataclass(frozen=True, kw_only=True)
class SGD(Optimizer):
    """Heavy ball, `v = m v + (1 - m) g`, step `rate * v`: as large as a step without momentum, but smoother.

    Source: Polyak 1964, in the form of Salimans et al.'s code (evolution-strategies-starter, `optimizers.py`).
    """

    slots: ClassVar[tuple[str, ...]] = ("velocity",)
    """Running mean of the gradient."""

    momentum: float = 0.9
    """Share of the velocity that is kept (m), in [0, 1)."""

    def __post_init__(self) -> None:
        """Refuse a momentum outside [0, 1) (ConfigError)."""
        _check_momentum(self.momentum)

    def step(self, gradient: F32Array, state: OptimizerState, learning_rate: float) -> tuple[F32Array, OptimizerState]:
        """Return the step [D] and the next state."""
        velocity = _mix(state.slots["velocity"], gradient, self.momentum)
        step = np.float32(learning_rate) * velocity
        return step.astype(np.float32, copy=False), _state(state.steps + 1, velocity=velocity)

    @classmethod
    def of(cls, *, momentum: float) -> Self:
        """Return SGD with `momentum`."""
        return cls(momentum=momentum)


@dataclass(frozen=True, kw_only=True)
class ClipUp(Optimizer):
    """Momentum on the gradient's direction, with a speed limit: `v = m v + rate g / |g|`, `|v|` clipped, step `v`.

    The learning rate is a distance in the parameter space; how long the gradient is does not matter. A gradient of
    zero has no direction: only `m v` is left of the velocity.

    Norms are summed in float64, elementwise and without BLAS: their bits do not depend on threads.

    Source: Toklu, Liskowski and Srivastava 2020 (ClipUp), the algorithm and its rule of thumb for the maximum speed:
    twice the step size.
    """

    slots: ClassVar[tuple[str, ...]] = ("velocity",)
    """The last step."""

    momentum: float = 0.9
    """Share of the velocity that is kept (m), in [0, 1)."""
    max_speed_ratio: float = 2.0
    """Longest step, in learning rates."""

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ConfigError: `momentum` is outside [0, 1), or `max_speed_ratio` not positive.
        """
        _check_momentum(self.momentum)
        if not 0 < self.max_speed_ratio < float("inf"):
            raise ConfigError(f"max_speed_ratio must be a positive number, got {self.max_speed_ratio}; 2 is usual.")

    def step(self, gradient: F32Array, state: OptimizerState, learning_rate: float) -> tuple[F32Array, OptimizerState]:
        """Return the step [D] and the next state."""
        velocity = self.momentum * state.slots["velocity"].astype(np.float64)
        direction = gradient.astype(np.float64)
        length = _norm(direction)
        if length > 0:
            velocity += learning_rate * (direction / length)
        speed, max_speed = _norm(velocity), self.max_speed_ratio * learning_rate
        if speed > max_speed:
            velocity *= max_speed / speed
        step = velocity.astype(np.float32)
        return step, _state(state.steps + 1, velocity=step.copy())  # who changes the step changes no state

    @classmethod
    def of(cls, *, momentum: float) -> Self:
        """Return ClipUp with `momentum`."""
        return cls(momentum=momentum)


OPTIMIZERS: Registry[type[Optimizer]] = Registry(
    "optimizer",
    {
        "adam": Adam,
        "sgd": SGD,
        "clipup": ClipUp,
    },
    fix="Set --optimizer.",
    check=subclass_of(Optimizer),
)


def make_optimizer(name: str, *, momentum: float = 0.9) -> Optimizer:
    """Return the optimizer of this name.

    Args:
        name: One of `OPTIMIZERS`.
        momentum: Share of the velocity that `sgd` and `clipup` keep, in [0, 1); `adam` has its own.

    Raises:
        UnknownNameError: `name` is not in `OPTIMIZERS`.
        ConfigError: `momentum` is outside [0, 1).
    """
    return OPTIMIZERS.find(name).of(momentum=momentum)


def _state(steps: int, **slots: F32Array) -> OptimizerState:
    """Return the state of these `slots` [D]."""
    return OptimizerState(steps=steps, slots=slots)


def _mix(old: F32Array, new: F32Array, share: float) -> F32Array:
    """Return `share * old + (1 - share) * new` [D] in float32."""
    mixed = np.float32(share) * old + np.float32(1 - share) * new
    return mixed.astype(np.float32, copy=False)


def _norm(vector: F64Array) -> float:
    """Return the Euclidean norm of `vector` [D]."""
    return float(np.sqrt(np.sum(np.square(vector))))


def _check_momentum(momentum: float) -> None:
    """Refuse a momentum outside [0, 1)."""
    if not 0 <= momentum < 1:
        raise ConfigError(f"momentum must be at least 0 and below 1, got {momentum}. Set --momentum.")
