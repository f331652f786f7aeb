"""What the rollout needs of an agent, whatever its levels: P lanes of R episodes, N = P * R.

The episodes of a lane are of one set of policies; or of several, that differ in what they take of one noise vector.

Three kinds fulfil it: a controller with a primitive (`hierarchical`), a primitive alone that follows goals of its
environment (`primitive`), and one policy without goals (`flat`). Nothing here knows of physics, fitness or noise.
Source: SHES paper II-A; algorithm specification sections 1, 4 and 6.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Generic, TypeVar

import numpy as np

from shes.es.level import LevelParameters
from shes.es.statistics import normalise
from shes.hierarchy.clock import Clock
from shes.hierarchy.moments import Moments
from shes.policies.mlp import MLP, Layers, Rows, aligned_rows
from shes.types import F32Array, F64Array, IntArray

__all__ = ["AgentBatch", "AgentDesign"]


Design = TypeVar("Design", bound="AgentDesign")


@dataclass(frozen=True, kw_only=True)
class AgentDesign(ABC):
    """What an agent is made of; its parameters come separately. Worker processes are sent this."""

    control_limit: float
    """Control that an output of 1 of the acting level stands for."""
    clock: Clock | None = None
    """What tells the acting level the time, if anything does."""
    controller_interval: int = 1
    """Control steps that a goal is held (c); 1 where there are no goals."""

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
    def intrinsic_level(self) -> int | None:
        """The level that the agent itself pays, if there is one; the environment pays every other one."""

    @property
    def decision_size(self) -> int:
        """Outputs of the level that decides every `controller_interval` steps; 0 where there is none."""
        return 0

    @property
    @abstractmethod
    def agent(self) -> type[AgentBatch[Any]]:
        """The class of its agents."""

    def make(
        self, num_lanes: int, rows_per_lane: int, xp: ModuleType = np, *, shares_noise: bool = False
    ) -> AgentBatch[Any]:
        """Return agents for `num_lanes` lanes of `rows_per_lane` episodes, with arrays of `xp`; see `AgentBatch`."""
        return self.agent(self, num_lanes, rows_per_lane, xp, shares_noise=shares_noise)

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


class AgentBatch(ABC, Generic[Design]):
    """P lanes of R episodes each. Rows [N] are lane after lane.

    Arrays are those of `xp`, but for the clock, which decides what is to be done: that is NumPy's. On a device all
    lanes are started together.
    """

    def __init__(
        self,
        design: Design,
        num_lanes: int,
        rows_per_lane: int,
        xp: ModuleType = np,
        *,
        shares_noise: bool = False,
    ) -> None:
        """Make room for `num_lanes` lanes of `rows_per_lane` episodes, with arrays of `xp`.

        With `shares_noise`, the policies of a lane are those of `centre_on` plus `scale` times the lane's `theta`;
        without, `theta` is the policy of all its episodes.
        """
        self.design = design
        self.num_lanes, self.rows_per_lane, self.xp = num_lanes, rows_per_lane, xp
        self.shares_noise = shares_noise
        self.num_rows = rows = num_lanes * rows_per_lane
        self.theta = tuple(self._room(num_lanes, dim) for dim in design.dims)
        """Parameters, or noise, [P, D] of each level: write those of a lane before its `start`."""
        self.scale: tuple[F32Array, ...] = tuple(
            xp.zeros((num_lanes, rows_per_lane, 1), np.float32) for _ in design.dims
        )
        """What the policy of each episode takes of its lane's noise [P, R, 1], at each level."""
        self._mean = tuple(self._room(1, dim) for dim in design.dims)
        self.moments = tuple(Moments(rows, size, xp) for size in design.observation_sizes)
        self.is_recording = False
        """Whether observations are summed into `moments`."""
        self.clock: IntArray = np.zeros(num_lanes, dtype=np.int64)
        """Steps since the start of each lane's episodes [P]."""
        self.goals_reached: IntArray = xp.zeros(rows, dtype=np.int64)
        """Goals that each episode has reached since its start [N]."""
        self._rows_of_levels: tuple[Rows, ...] = tuple(
            tuple(
                (
                    xp.zeros((num_lanes, rows_per_lane, size), np.float32),
                    xp.zeros((num_lanes, rows_per_lane, size), np.float32),
                )
                for size in policy.sizes[1:]
            )
            for policy in (design.policies if shares_noise else ())
        )
        self._policies = design.policies
        self._control_limit = np.float32(design.control_limit)
        self._clock = design.clock
        self._layers = [policy.layers(theta) for policy, theta in zip(design.policies, self.theta, strict=True)]
        self._mean_layers = [policy.layers(mean) for policy, mean in zip(design.policies, self._mean, strict=True)]
        self._normalisation: list[tuple[Any, Any]] = [(0.0, 1.0)] * len(design.dims)
        self.allocate()

    def allocate(self) -> None:
        """Make the arrays of this kind of agent, at the end of the only constructor."""

    @property
    def goal(self) -> F64Array | None:
        """Goals being held, in the world [N, 2], in metres; none where the agent knows no goals."""
        return None

    def normalise_by(self, levels: tuple[LevelParameters, ...]) -> None:
        """Use the observation statistics of `levels`; their parameters are not touched."""
        xp = self.xp
        self._normalisation = [(xp.asarray(level.mean), xp.asarray(level.inverse_std)) for level in levels]

    def centre_on(self, levels: tuple[LevelParameters, ...]) -> None:
        """Let noise be added to the parameters of `levels`."""
        for mean, level in zip(self._mean, levels, strict=True):
            mean[0] = self.xp.asarray(level.theta)
        self._mean_layers = [self._contiguous(*each) for each in zip(self._policies, self._mean, strict=True)]

    def parameters(self, lane: int) -> tuple[F32Array, ...]:
        """Return what the policies of a lane are made of at each level: parameters [D], or mean and noise [2, D]."""
        if not self.shares_noise:
            return tuple(theta[lane] for theta in self.theta)
        return tuple(self.xp.stack([mean[0], theta[lane]]) for mean, theta in zip(self._mean, self.theta, strict=True))

    def start(self, lanes: slice | IntArray) -> None:
        """Begin new episodes in `lanes`."""
        self.clock[lanes] = 0
        rows = self._rows(lanes)
        self.goals_reached[rows] = 0
        for moments in self.moments:
            moments.clear(rows)
        if self.xp is not np:
            self._layers = [self._contiguous(*each) for each in zip(self._policies, self.theta, strict=True)]
        if self.shares_noise:
            self._spread(lanes)

    def go_on(self, lane: int, steps: int, goals: F64Array) -> None:
        """Let the episodes of `lane`, just started, be ones that were reset `steps` control steps ago.

        Args:
            lane: Number of the lane.
            steps: A multiple of the decision interval.
            goals: Goals to pursue one after another [J, 2], each from where the robot is when it is set, in metres;
                none where the environment sets them.
        """
        del goals
        self.clock[lane] = steps

    def _spread(self, lanes: slice | IntArray) -> None:
        """Work out scale and biases of the policies in `lanes`, from what they take of their noise."""
        for level, rows in enumerate(self._rows_of_levels):
            scale = self.scale[level][lanes]
            layers = zip(rows, self._mean_layers[level], self._layers[level], strict=True)
            for (scales, biases), (_, mean), (_, noise) in layers:
                scales[lanes] = scale
                biases[lanes] = scale * noise[lanes] + mean

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
            decision_noise: Added to the outputs of the level that decides [P, R, decision_size].
            control_noise: Added to the controls [P, R, A].
        """

    def intrinsic_reward(self, position: F64Array) -> F64Array:
        """Return what the agent itself pays [N] for having come to `position` [N, 2]; nothing where it does not pay."""
        return np.zeros_like(position[:, 0], dtype=np.float64)

    def _room(self, rows: int, size: int) -> F32Array:
        """Return zeros [rows, size] for parameters."""
        return aligned_rows(rows, size) if self.xp is np else self.xp.zeros((rows, size), np.float32)

    def _contiguous(self, policy: MLP, theta: F32Array) -> Layers:
        """Return the layers of `theta` [P, D]: on a card copies, because it would copy what has gaps in every step."""
        layers = policy.layers(theta)
        if self.xp is np:
            return layers
        return tuple((self.xp.ascontiguousarray(weights), biases) for weights, biases in layers)

    def _rows(self, lanes: slice | IntArray) -> slice | IntArray:
        """Return the rows of the episodes of `lanes`: a slice, where all are meant, is quicker."""
        if isinstance(lanes, slice):
            assert lanes == slice(None)
            return lanes
        rows = (lanes[:, None] * self.rows_per_lane + np.arange(self.rows_per_lane)).ravel()
        return self.xp.asarray(rows)

    def _write_clock(self, out: F64Array) -> None:
        """Write the clock's features, if there are any, into `out` [N, clock_size]."""
        if self._clock is not None:
            self._clock.write(self.xp.asarray(self.clock), out.reshape(self.num_lanes, self.rows_per_lane, -1))

    def _control(self, inputs: F64Array, noise: F32Array | None) -> F32Array:
        """Return the controls [N, A] of the acting level, the last one, which observes `inputs` [N, O]."""
        if self.is_recording:
            self.moments[-1].add(slice(None), inputs)
        scaled = normalise(inputs, *self._normalisation[-1])
        control = self._forward(-1, self._by_lane(scaled))
        control *= self._control_limit
        if noise is not None:
            control += noise
        return control.reshape(len(inputs), -1)

    def _forward(self, level: int, observation: F32Array, lanes: slice | IntArray = slice(None)) -> F32Array:
        """Return what the policies of `level` in `lanes` put out on normalised `observation` [lanes, R, O]."""
        policy, layers = self._policies[level], self._layers[level]
        if not isinstance(lanes, slice):
            layers = policy.layers(self._aligned_copy(self.theta[level], lanes))
        if not self.shares_noise:
            return policy.forward(layers, observation)
        rows = self._rows_of_levels[level]
        if not isinstance(lanes, slice):
            rows = tuple((scales[lanes], biases[lanes]) for scales, biases in rows)
        return policy.forward_around(self._mean_layers[level], layers, rows, observation)

    @staticmethod
    def _aligned_copy(theta: F32Array, lanes: IntArray) -> F32Array:
        """Return the rows of `lanes`, each on a cache line as in `theta`."""
        out = aligned_rows(len(lanes), theta.shape[1])
        np.take(theta, lanes, axis=0, out=out)
        return out

    def _by_lane(self, rows: F32Array) -> F32Array:
        """View rows [N, O] as [P, R, O]."""
        return rows.reshape(-1, self.rows_per_lane, rows.shape[1])
