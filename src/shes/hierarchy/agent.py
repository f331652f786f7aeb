"""What the roll-out needs of an agent, whatever its levels: P sets of policies, each acting in E episodes; N = P * E.

Three kinds fulfil it: a controller with a primitive (`hierarchical`), a primitive alone that follows goals of its
environment (`primitive`), and one policy without goals (`flat`). Nothing here knows of physics, fitness or noise.
Source: SHES paper II-A; algorithm specification sections 1, 4 and 6.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from shes.es.level import LevelParameters
from shes.es.statistics import normalise
from shes.hierarchy.clock import Clock
from shes.hierarchy.moments import Moments
from shes.policies.mlp import MLP, Layers, aligned_rows
from shes.types import F32Array, F64Array, IntArray

__all__ = ["Agent", "AgentDesign", "columns"]


@dataclass(frozen=True, kw_only=True)
class AgentDesign(ABC):
    """What an agent is made of; its parameters come separately. Worker processes are sent this."""

    control_limit: float
    """Control that an output of 1 of the acting level stands for."""
    clock: Clock | None = None
    """What tells the acting level the time, if anything does."""

    @property
    @abstractmethod
    def level_names(self) -> tuple[str, ...]:
        """What the levels are called, the one that acts every step last."""

    @property
    @abstractmethod
    def policies(self) -> tuple[MLP, ...]:
        """The network of each level."""

    @property
    @abstractmethod
    def internal_level(self) -> int | None:
        """The level that the agent itself pays, if there is one; the environment pays every other one."""

    @property
    def decision_size(self) -> int:
        """Outputs of the level that decides every `decision_interval` steps; 0 where there is none."""
        return 0

    @property
    def decision_interval(self) -> int:
        """Steps between two decisions (c); 1 where nothing is decided."""
        return 1

    @abstractmethod
    def make(self, num_policies: int, num_episodes: int, xp: ModuleType = np) -> Agent:
        """Return an agent of `num_policies` sets of policies, each in `num_episodes` episodes, with arrays of `xp`."""

    @property
    def dims(self) -> tuple[int, ...]:
        """Parameters of each level."""
        return tuple(policy.num_params for policy in self.policies)

    @property
    def observation_sizes(self) -> tuple[int, ...]:
        """Inputs of each level."""
        return tuple(policy.sizes[0] for policy in self.policies)

    @property
    def clock_size(self) -> int:
        """Features of the clock."""
        return 0 if self.clock is None else self.clock.size


class Agent(ABC):
    """P sets of policies acting in E episodes each. Rows [N] are set after set.

    Arrays are those of `xp`, but for the clock, which decides what is to be done: that is NumPy's.
    """

    def __init__(self, design: AgentDesign, num_policies: int, num_episodes: int, xp: ModuleType = np) -> None:
        """Make room for `num_policies` sets of `num_episodes` episodes, with arrays of `xp`."""
        self.num_policies, self.num_episodes, self.xp = num_policies, num_episodes, xp
        rows = num_policies * num_episodes
        self.theta = tuple(
            aligned_rows(num_policies, dim) if xp is np else xp.zeros((num_policies, dim), np.float32)
            for dim in design.dims
        )
        """Parameters [P, D] of each level: write those of a set before its `start`."""
        self.moments = tuple(Moments(rows, size, xp) for size in design.observation_sizes)
        self.is_recording = False
        """Whether observations are summed into `moments`."""
        self.clock: IntArray = np.zeros(num_policies, dtype=np.int64)
        """Steps since the start of each set's episodes [P]."""
        self.goals_reached: IntArray = xp.zeros(rows, dtype=np.int64)
        """Goals that each episode has reached since its start [N]."""
        self._policies = design.policies
        self._control_limit = np.float32(design.control_limit)
        self._clock = design.clock
        self._layers: list[Layers] = [
            policy.layers(theta) for policy, theta in zip(design.policies, self.theta, strict=True)
        ]
        self._normalisation: list[tuple[Any, Any]] = [(0.0, 1.0)] * len(design.dims)

    @property
    def goal(self) -> F64Array | None:
        """Goals being held, in the world [N, 2], in metres; none where the agent knows no goals."""
        return None

    def normalise_by(self, levels: tuple[LevelParameters, ...]) -> None:
        """Use the observation statistics of `levels`; their parameters are not touched."""
        xp = self.xp
        self._normalisation = [(xp.asarray(level.mean), xp.asarray(level.inverse_std)) for level in levels]

    def start(self, policies: slice | IntArray) -> None:
        """Begin new episodes for sets `policies`."""
        self.clock[policies] = 0
        rows = self._rows(policies)
        self.goals_reached[rows] = 0
        for moments in self.moments:
            moments.clear(rows)
        if self.xp is not np:
            # What a card multiplies must be contiguous, or it is copied in every step.
            self._layers = [
                tuple((self.xp.ascontiguousarray(weights), biases) for weights, biases in policy.layers(theta))
                for policy, theta in zip(self._policies, self.theta, strict=True)
            ]

    @abstractmethod
    def act(
        self,
        observation: F64Array,
        position: F64Array,
        heading: F64Array,
        *,
        goal: F64Array | None = None,
        decision_noise: F32Array | None = None,
        control_noise: F32Array | None = None,
    ) -> F32Array:
        """Return the controls [N, A] of one step.

        Args:
            observation: What the tasks show [N, O].
            position: Where the robots are [N, 2], in metres.
            heading: Their yaw [N], in radians.
            goal: Where the environment itself tells them to go [N, 2], in metres, if it does.
            decision_noise: Added to the outputs of the level that decides [P, E, decision_size].
            control_noise: Added to the controls [P, E, A].
        """

    def internal_reward(self, position: F64Array) -> F64Array:
        """Return what the agent itself pays [N] for having come to `position` [N, 2]; nothing where it does not pay."""
        return np.zeros_like(position[:, 0], dtype=np.float64)

    def _rows(self, policies: slice | IntArray) -> slice | IntArray:
        """Return the rows of the episodes of sets `policies`: a slice, where all are meant, is quicker."""
        if isinstance(policies, slice):
            assert policies == slice(None)
            return policies
        rows = (policies[:, None] * self.num_episodes + np.arange(self.num_episodes)).ravel()
        return self.xp.asarray(rows)

    def _write_clock(self, out: F64Array) -> None:
        """Write the clock's features, if there are any, into `out` [N, clock_size]."""
        if self._clock is not None:
            self._clock.write(self.xp.asarray(self.clock), out.reshape(self.num_policies, self.num_episodes, -1))

    def _control(self, inputs: F64Array, noise: F32Array | None) -> F32Array:
        """Return the controls [N, A] of the acting level, the last one, which observes `inputs` [N, O]."""
        if self.is_recording:
            self.moments[-1].add(slice(None), inputs)
        scaled = normalise(inputs, *self._normalisation[-1])
        control = self._policies[-1].forward(self._layers[-1], self._by_policy(scaled))
        control *= self._control_limit
        if noise is not None:
            control += noise
        return control.reshape(len(inputs), -1)

    def _by_policy(self, rows: F32Array) -> F32Array:
        """View rows [N, O] as [P, E, O]."""
        return rows.reshape(-1, self.num_episodes, rows.shape[1])


def columns(indices: tuple[int, ...] | None) -> slice | IntArray:
    """Return what picks columns `indices`, all if None: a slice where it can be one, because that is quicker."""
    if indices is None or indices == tuple(range(len(indices))):
        return slice(None if indices is None else len(indices))
    return np.array(indices, dtype=np.int64)
