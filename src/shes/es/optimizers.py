"""Optimizers: how a gradient estimate moves the parameters. Their state is data, their step a pure function."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shes.types import F32Array

__all__ = ["Adam", "AdamState"]


@dataclass(frozen=True, kw_only=True)
class AdamState:
    """Moments of Adam."""

    first: F32Array
    """Running mean of the gradient [D]."""
    second: F32Array
    """Running mean of the squared gradient [D]."""
    steps: int
    """Updates made so far."""


@dataclass(frozen=True, kw_only=True)
class Adam:
    """Adam, ascending. Source: Kingma and Ba 2014, end of section 2 (bias correction folded into the rate)."""

    beta1: float = 0.9
    beta2: float = 0.999
    epsilon: float = 1e-8

    def start(self, dim: int) -> AdamState:
        """Return the state before the first update of `dim` parameters."""
        return AdamState(first=np.zeros(dim, np.float32), second=np.zeros(dim, np.float32), steps=0)

    def step(self, gradient: F32Array, state: AdamState, learning_rate: float) -> tuple[F32Array, AdamState]:
        """Return the step [D] to add to the parameters, and the next state. `gradient` [D] points uphill."""
        steps = state.steps + 1
        first = _mix(state.first, gradient, self.beta1)
        second = _mix(state.second, gradient * gradient, self.beta2)
        rate = learning_rate * np.sqrt(1 - self.beta2**steps) / (1 - self.beta1**steps)
        step = np.float32(rate) * first / (np.sqrt(second) + np.float32(self.epsilon))
        return step.astype(np.float32, copy=False), AdamState(first=first, second=second, steps=steps)


def _mix(old: F32Array, new: F32Array, share: float) -> F32Array:
    """Return `share * old + (1 - share) * new` [D] in float32."""
    mixed = np.float32(share) * old + np.float32(1 - share) * new
    return mixed.astype(np.float32, copy=False)
