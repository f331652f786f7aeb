"""Optimizers: how a gradient estimate becomes a step. The state is data, and the step is a pure function.

Optimizers ascend: the gradient estimate [D] points uphill, and the step [D] is added to the parameters. To add one,
write a class and a line in `OPTIMIZERS`. A class that is also a `Settings` dataclass has its fields as flags of
`shes train`; see `shes.options`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from shes.options import subclass_of
from shes.registry import Registry
from shes.types import F32Array


@dataclass(frozen=True, kw_only=True)
class OptimizerState:
    """State of an optimizer between updates."""

    steps: int
    """Number of updates so far."""
    slots: dict[str, F32Array]
    """Running vectors [D] by name, one for each of the optimizer's `slots`. Never changed in place."""


class Optimizer(ABC):
    """Turns a gradient estimate into a step."""

    slots: ClassVar[tuple[str, ...]]
    """Names of the running vectors in the state."""

    def start(self, dim: int) -> OptimizerState:
        """Return the state before the first update of `dim` parameters."""
        return OptimizerState(steps=0, slots={name: np.zeros(dim, np.float32) for name in self.slots})

    @abstractmethod
    def step(self, gradient: F32Array, state: OptimizerState, learning_rate: float) -> tuple[F32Array, OptimizerState]:
        """Return the step [D] to add to the parameters, and the next state, for an uphill `gradient` estimate [D].

        The arguments are not changed.
        """


@dataclass(frozen=True, kw_only=True)
class Adam(Optimizer):
    """Adaptive moment estimation. Source: Kingma and Ba 2014, end of section 2 (bias correction in the rate)."""

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
        return step, OptimizerState(steps=steps, slots={"first": first, "second": second})


@dataclass(frozen=True, kw_only=True)
class SGD(Optimizer):
    """Gradient ascent with momentum: the velocity is `v = m v + (1 - m) g`, the step `rate * v`.

    Source: Polyak 1964, in the form of Salimans et al.'s code (evolution-strategies-starter, `optimizers.py`).
    """

    slots: ClassVar[tuple[str, ...]] = ("velocity",)
    """Running mean of the gradient."""

    momentum: float = 0.9
    """Momentum (m): share of the velocity that is kept, in [0, 1)."""

    def step(self, gradient: F32Array, state: OptimizerState, learning_rate: float) -> tuple[F32Array, OptimizerState]:
        """Return the step [D] and the next state."""
        velocity = _mix(state.slots["velocity"], gradient, self.momentum)
        step = np.float32(learning_rate) * velocity
        return step, OptimizerState(steps=state.steps + 1, slots={"velocity": velocity})


OPTIMIZERS: Registry[type[Optimizer]] = Registry(
    "optimizer", {"adam": Adam, "sgd": SGD}, fix="Set --optimizer.", check=subclass_of(Optimizer)
)
"""Optimizers by name: the choices of `--optimizer`."""


def _mix(old: F32Array, new: F32Array, share: float) -> F32Array:
    return (np.float32(share) * old + np.float32(1 - share) * new).astype(np.float32, copy=False)
