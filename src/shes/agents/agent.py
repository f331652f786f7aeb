"""The contract of agents with any number of levels, batched over P lanes of R episodes, N = P * R.

The episodes of a lane share one set of policies, or belong to several members that perturb the mean by the same noise.

Two kinds of agent exist: one that pursues goals (`goal_agent`), and a single policy without goals, the flat baseline of
the SHES paper's figure 6 (Salimans et al. 2017). This module does not depend on physics or fitness.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from shes.agents.mlp import MLP, Layers, Rows, aligned_rows
from shes.agents.views import View
from shes.es.level import LevelParameters
from shes.es.statistics import CLIP, Moments, normalise
from shes.types import F32Array, F64Array, IntArray

Design = TypeVar("Design", bound="AgentDesign")


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Sine and cosine of the time since the start of the episode, at one frequency: a network has no rhythm of its own.

    Source: Siekmann et al. 2021, section III (sine and cosine of a gait's phase as inputs).
    """

    size: ClassVar[int] = 2
    """Number of features."""
    frequency_hz: float
    """Frequency in simulated time."""
    step_s: float
    """Simulated time of a control step in seconds."""

    def write(self, steps: IntArray, out: F64Array) -> None:
        """Write sine and cosine into `out` [P, R, 2], for lanes `steps` [P] control steps after their start."""
        phase = (2 * np.pi * self.frequency_hz * self.step_s) * steps[:, None]
        np.sin(phase, out=out[..., 0])  # broadcast over the episodes of a lane, which started together
        np.cos(phase, out=out[..., 1])


@dataclass(frozen=True, kw_only=True)
class AgentDesign(ABC):
    """Design of an agent, without its parameters. It is sent to worker processes."""

    control_limit: float
    """Control for an output of 1 of the acting level."""
    clock: Clock | None = None
    """Clock that the acting level observes, if any."""
    controller_interval: int = 1
    """Control steps for which a goal is held (c); 1 without goals."""
    input_clip: float = CLIP
    """Largest absolute value of a normalised input; infinity for no limit."""

    @property
    @abstractmethod
    def networks(self) -> dict[str, MLP]:
        """The network of each level by name. The level that acts every step comes last."""

    @property
    def level_names(self) -> tuple[str, ...]:
        """The name of each level."""
        return tuple(self.networks)

    @property
    def policies(self) -> tuple[MLP, ...]:
        """The network of each level."""
        return tuple(self.networks.values())

    @property
    def controller_view(self) -> View | None:
        """The part of the observation that a controller sees; None without a controller."""
        return None

    @property
    def intrinsic_level(self) -> int | None:
        """Index of the primitive, which has an intrinsic reward; None without. Others get the environment's reward."""
        return self.level_names.index("primitive") if "primitive" in self.level_names else None

    def exported(self) -> dict[str, Any]:
        """Return what an exported agent holds of its own, as JSON types. `shes.runs.export` adds what is common."""
        return {}

    @property
    @abstractmethod
    def agent(self) -> type[AgentBatch[Any]]:
        """The class of the agents."""

    @property
    def decision_size(self) -> int:
        """Number of outputs of the level that decides every `controller_interval` steps; 0 if there is none."""
        return 0

    def direction_outputs(self, angles: F64Array) -> F64Array:
        """Return the outputs [K, decision_size] of the controller for goals in directions `angles` [K] in radians.

        The goals are at full distance. Angles are counter-clockwise in the frame of the outputs. A design with a
        controller overrides this.
        """
        raise NotImplementedError(f"{type(self).__name__} has no controller, or no direction_outputs for it")

    def make(
        self, num_lanes: int, rows_per_lane: int, xp: ModuleType = np, *, shares_noise: bool = False
    ) -> AgentBatch[Any]:
        """Return agents for `num_lanes` lanes of `rows_per_lane` episodes. For the arguments see `AgentBatch`."""
        return self.agent(self, num_lanes, rows_per_lane, xp, shares_noise=shares_noise)

    @property
    def dims(self) -> tuple[int, ...]:
        """Number of parameters of each level."""
        return tuple(policy.num_params for policy in self.policies)

    @property
    def observation_sizes(self) -> tuple[int, ...]:
        """Number of inputs of each level."""
        return tuple(policy.sizes[0] for policy in self.policies)

    @property
    def clock_size(self) -> int:
        """Number of clock features."""
        return 0 if self.clock is None else self.clock.size


class AgentBatch(ABC, Generic[Design]):
    """Agents in P lanes of R episodes each. Rows [N] are ordered by lane.

    Arrays belong to `xp`, except the clock, which is always NumPy's, because it controls the program flow. On a device
    all lanes are started together.
    """

    def __init__(
        self, design: Design, num_lanes: int, rows_per_lane: int, xp: ModuleType = np, *, shares_noise: bool = False
    ) -> None:
        """Allocate arrays of `xp` for `num_lanes` lanes of `rows_per_lane` episodes.

        With `shares_noise`, the parameters of an episode are those given to `centre_on` plus its `scale` times the
        lane's `theta`. Without, `theta` holds the parameters for all episodes of the lane.
        """
        self.design = design
        self.num_lanes, self.rows_per_lane, self.xp = num_lanes, rows_per_lane, xp
        self.shares_noise = shares_noise
        self.num_rows = rows = num_lanes * rows_per_lane
        self.theta = tuple(self._zero_parameters(num_lanes, dim) for dim in design.dims)
        """Parameters, or noise, [P, D] of each level. Write those of a lane before `start`, which expands them."""

        def zeros(size: int) -> F32Array:
            return xp.zeros((num_lanes, rows_per_lane, size), np.float32)

        self.scale: tuple[F32Array, ...] = tuple(zeros(1) for _ in design.dims)
        """Factor of the lane's noise in the parameters of each episode [P, R, 1], at each level."""
        self._weights = tuple(  # those of a network without ties are its parameters
            self._zero_parameters(num_lanes, policy.num_weights) if policy.is_tied else theta
            for policy, theta in zip(design.policies, self.theta, strict=True)
        )
        self._mean = tuple(self._zero_parameters(1, policy.num_weights) for policy in design.policies)
        self.moments = tuple(Moments.zeros(rows, size, xp) for size in design.observation_sizes)
        self.is_recording = False
        """Whether observations are summed into `moments`."""
        self.clock: IntArray = np.zeros(num_lanes, dtype=np.int64)
        """Steps since the start of each lane's episodes [P]."""
        self.goals_reached: IntArray = xp.zeros(rows, dtype=np.int64)
        """Number of goals reached in each episode [N]."""
        self._rows_of_levels: tuple[Rows, ...] = tuple(
            tuple((zeros(size), zeros(size)) for size in policy.sizes[1:])
            for policy in (design.policies if shares_noise else ())
        )
        self._policies = design.policies
        self._control_limit = np.float32(design.control_limit)
        self._clock = design.clock
        self._layers = [policy.layers(own) for policy, own in zip(design.policies, self._weights, strict=True)]
        self._mean_layers = [policy.layers(mean) for policy, mean in zip(design.policies, self._mean, strict=True)]
        self._normalisation: list[tuple[Any, Any]] = [(0.0, 1.0)] * len(design.dims)
        self.allocate()

    def allocate(self) -> None:
        """Allocate the arrays of a subclass, at the end of the constructor."""

    @property
    def goal(self) -> F64Array | None:
        """Current goals in the world frame [N, 2] in metres; None if the agent has no goals."""
        return None

    def normalise_by(self, levels: tuple[LevelParameters, ...]) -> None:
        """Set the input normalisation to that of `levels`. Parameters are not changed."""
        xp = self.xp
        self._normalisation = [(xp.asarray(level.mean), xp.asarray(level.inverse_std)) for level in levels]

    def centre_on(self, levels: tuple[LevelParameters, ...]) -> None:
        """Set the mean parameters, to which noise is added, to those of `levels`."""
        for policy, mean, level in zip(self._policies, self._mean, levels, strict=True):
            mean[:] = policy.expand(self.xp.asarray(level.theta)[None], self.xp)
        self._mean_layers = [self._contiguous(*each) for each in zip(self._policies, self._mean, strict=True)]

    def parameters(self, lane: int) -> tuple[F32Array, ...]:
        """Return for each level the weights [W] of a lane, or mean and noise [2, W] if noise is shared."""
        if not self.shares_noise:
            return tuple(weights[lane] for weights in self._weights)
        return tuple(self.xp.stack([mean[0], own[lane]]) for mean, own in zip(self._mean, self._weights, strict=True))

    def start(self, lanes: slice | IntArray) -> None:
        """Start new episodes in `lanes`."""
        self.clock[lanes] = 0
        rows = self._rows(lanes)
        self.goals_reached[rows] = 0
        for moments in self.moments:
            moments.clear(rows)
        for policy, theta, weights in zip(self._policies, self.theta, self._weights, strict=True):
            if policy.is_tied:
                weights[lanes] = policy.expand(theta[lanes], self.xp)
        if self.xp is not np:
            self._layers = [self._contiguous(*each) for each in zip(self._policies, self._weights, strict=True)]
        if self.shares_noise:
            self._spread(lanes)

    def go_on(self, lane: int, steps: int, goals: F64Array) -> None:
        """Continue, in the just started `lane`, episodes that were reset `steps` control steps ago.

        Args:
            lane: Index of the lane.
            steps: A multiple of the controller interval.
            goals: Successive goals [J, 2] relative to the robot at the time each is set, in metres. Empty if the
                environment sets the goals.
        """
        self.clock[lane] = steps

    def _spread(self, lanes: slice | IntArray) -> None:
        """Compute the scales and the biases of the policies in `lanes`."""
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
            observation: Observations of the task [N, O].
            position: Positions of the robots [N, 2] in metres.
            heading: Yaw of the robots [N] in radians.
            goal: Goals set by the environment [N, 2] in metres, if it sets goals.
            decision_noise: Added to the outputs of the deciding level [P, R, decision_size].
            control_noise: Added to the controls [P, R, A].
        """

    def intrinsic_reward(self, position: F64Array) -> F64Array:
        """Return the intrinsic reward [N] for moving to `position` [N, 2]; zeros without an intrinsic reward."""
        return np.zeros_like(position[:, 0], dtype=np.float64)

    def _zero_parameters(self, rows: int, size: int) -> F32Array:
        return aligned_rows(rows, size) if self.xp is np else self.xp.zeros((rows, size), np.float32)

    def _contiguous(self, policy: MLP, own: F32Array) -> Layers:
        """Return the layers of weights [P, W]: on a GPU as contiguous copies, else it would copy them in every step."""
        layers = policy.layers(own)
        if self.xp is np:
            return layers
        return tuple((self.xp.ascontiguousarray(weights), biases) for weights, biases in layers)

    def _rows(self, lanes: slice | IntArray) -> slice | IntArray:
        """Return the rows of the episodes of `lanes`. All lanes are given as a slice, which is faster."""
        if isinstance(lanes, slice):
            assert lanes == slice(None)
            return lanes
        rows = (lanes[:, None] * self.rows_per_lane + np.arange(self.rows_per_lane)).ravel()
        return self.xp.asarray(rows)

    def _write_clock(self, out: F64Array) -> None:
        """Write the clock features, if any, into `out` [N, clock_size]."""
        if self._clock is not None:
            self._clock.write(self.xp.asarray(self.clock), out.reshape(self.num_lanes, self.rows_per_lane, -1))

    def _control(self, inputs: F64Array, noise: F32Array | None) -> F32Array:
        """Return the controls [N, A] of the acting level for its `inputs` [N, O]."""
        control = self._outputs(len(self._policies) - 1, inputs)
        control *= self._control_limit
        if noise is not None:
            control += noise
        return control.reshape(len(inputs), -1)

    def _outputs(
        self,
        level: int,
        inputs: F64Array,
        rows: slice | IntArray = slice(None),
        lanes: slice | IntArray = slice(None),
    ) -> F32Array:
        """Return the outputs [lanes, R, A] of `level` for its `inputs` [rows, O], which are recorded."""
        if self.is_recording:
            self.moments[level].add(rows, inputs)
        scaled = normalise(inputs, *self._normalisation[level], self.design.input_clip)
        return self._forward(level, self._by_lane(scaled), lanes)

    def _forward(self, level: int, observation: F32Array, lanes: slice | IntArray = slice(None)) -> F32Array:
        """Return the outputs of the policies of `level` in `lanes` for normalised `observation` [lanes, R, O]."""
        policy, layers, rows = self._policies[level], self._layers[level], None
        if self.shares_noise:
            rows = self._rows_of_levels[level]
        if not isinstance(lanes, slice):
            # Each row on a cache line, as in theta: the place of a policy must not change its rounding.
            weights = self._weights[level]
            own = np.take(weights, lanes, axis=0, out=aligned_rows(len(lanes), weights.shape[1]))
            layers = policy.layers(own)
            rows = rows and tuple((scales[lanes], biases[lanes]) for scales, biases in rows)
        if rows is None:
            return policy.forward(layers, observation)
        return policy.forward_around(self._mean_layers[level], layers, rows, observation)

    def _by_lane(self, rows: F32Array) -> F32Array:
        """Return rows [N, O] as a view [P, R, O]."""
        return rows.reshape(-1, self.rows_per_lane, rows.shape[1])


@dataclass(frozen=True, kw_only=True)
class FlatDesign(AgentDesign):
    """Design of a flat agent. The policy observes the clock, then the observation of the task."""

    policy: MLP

    @property
    def networks(self) -> dict[str, MLP]:
        """The network of the policy."""
        return {"policy": self.policy}

    @property
    def agent(self) -> type[FlatAgent]:
        """The class of the agents."""
        return FlatAgent


class FlatAgent(AgentBatch[FlatDesign]):
    """Policies without goals, in P lanes of R episodes each."""

    def allocate(self) -> None:
        """Allocate the inputs of the policies."""
        self._clock_size = self.design.clock_size
        self._inputs: F64Array = self.xp.zeros((self.num_rows, self.design.observation_sizes[0]))

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
        """Return the controls [N, A] of one step; see `AgentBatch.act`."""
        self._write_clock(self._inputs[:, : self._clock_size])
        self._inputs[:, self._clock_size :] = observation
        self.clock += 1
        return self._control(self._inputs, control_noise)
