"""The contract of agents with any number of levels, batched over P lanes of R episodes, N = P * R; see `mlp`.

Two kinds of agent exist: one that pursues goals (`goal_agent`), and a single policy without goals, the flat baseline of
the SHES paper's figure 6 (Salimans et al. 2017). This module does not depend on physics or fitness.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np

from shes.agents.mlp import MLP, LevelPolicies
from shes.agents.views import Clock, View
from shes.es.level import LevelParameters
from shes.es.statistics import CLIP
from shes.types import F32Array, F64Array, IntArray

Design = TypeVar("Design", bound="AgentDesign")


class AgentInputs(NamedTuple):
    """The inputs of N agents, in P lanes of R episodes, in one step."""

    observation: F64Array
    """Observations of the task [N, O]."""
    position: F64Array
    """Positions of the robots [N, 2] in metres."""
    heading: F64Array
    """Yaw of the robots [N] in radians."""
    goal: F64Array | None = None
    """Goals set by the environment [N, 2] in metres, if it sets goals."""
    decision_noise: F32Array | None = None
    """Added to the outputs of the deciding level [P, R, decision_size]."""
    control_noise: F32Array | None = None
    """Added to the controls [P, R, A]."""


@dataclass(frozen=True, kw_only=True)
class AgentDesign:
    """Design of an agent, without its parameters. It is sent to worker processes."""

    agent: ClassVar[type[AgentBatch[Any]]]
    """The class of the agents."""
    has_intrinsic_reward: ClassVar[bool] = False
    """Whether the acting level is paid by `AgentBatch.intrinsic_reward`. Other levels get the environment's reward."""
    networks: dict[str, MLP]
    """The network of each level by name. The level that acts every step comes last."""
    controller_view: View | None = None
    """The part of the observation that a controller sees; None without a controller."""
    control_limit: float
    """Control for an output of 1 of the acting level."""
    clock: Clock | None = None
    """Clock that the acting level observes, if any."""
    controller_interval: int = 1
    """Control steps for which a goal is held (c); 1 without goals."""
    input_clip: float = CLIP
    """Largest absolute value of a normalised input; infinity for no limit."""

    @property
    def policies(self) -> tuple[MLP, ...]:
        """The network of each level."""
        return tuple(self.networks.values())

    def exported(self) -> dict[str, Any]:
        """Return what an exported agent holds of its own, as JSON types. `shes.runs.export` adds what is common."""
        return {}

    @property
    def decision_size(self) -> int:
        """Number of outputs of the level that decides every `controller_interval` steps; 0 if there is none."""
        return self.policies[0].sizes[-1] if len(self.networks) > 1 else 0

    def direction_outputs(self, angles: F64Array) -> F64Array:
        """Return the outputs [K, decision_size] of the controller for goals in directions `angles` [K] in radians.

        The goals are at full distance. Angles are counter-clockwise in the frame of the outputs. By default the first
        two outputs are x and y.
        """
        outputs = np.zeros((len(angles), self.decision_size))
        outputs[:, 0], outputs[:, 1] = np.cos(angles), np.sin(angles)
        return outputs

    @property
    def dims(self) -> tuple[int, ...]:
        """Number of parameters of each level."""
        return tuple(policy.num_params for policy in self.policies)

    @property
    def observation_sizes(self) -> tuple[int, ...]:
        """Number of inputs of each level."""
        return tuple(policy.sizes[0] for policy in self.policies)


class AgentBatch(ABC, Generic[Design]):
    """Agents in P lanes of R episodes each. Rows [N] are ordered by lane.

    Arrays belong to `xp`, except the clock, which is always NumPy's, because it controls the program flow. On a device
    all lanes are started together.
    """

    goal: F64Array | None = None
    """Current goals in the world frame [N, 2] in metres; None if the agent has no goals."""
    controller_inputs: F64Array | None = None
    """Inputs of the controllers [N, inputs] when they set the current goals; None without a controller."""

    def __init__(
        self, design: Design, num_lanes: int, rows_per_lane: int, xp: ModuleType = np, *, shares_noise: bool = False
    ) -> None:
        """Allocate the arrays for `num_lanes` lanes of `rows_per_lane` episodes; for the rest see `LevelPolicies`."""
        self.design = design
        self.num_lanes, self.rows_per_lane, self.xp = num_lanes, rows_per_lane, xp
        self.num_rows = rows = num_lanes * rows_per_lane
        limits = [1.0] * (len(design.policies) - 1) + [design.control_limit]
        self.levels = tuple(
            LevelPolicies(
                policy, num_lanes, rows_per_lane, xp, clip=design.input_clip, limit=limit, shares_noise=shares_noise
            )
            for policy, limit in zip(design.policies, limits, strict=True)
        )
        """The policies of each level."""
        self.clock: IntArray = np.zeros(num_lanes, dtype=np.int64)
        """Steps since the start of each lane's episodes [P]."""
        self.goals_reached: IntArray = xp.zeros(rows, dtype=np.int64)
        """Number of goals reached in each episode [N]."""

    def centre_on(self, levels: tuple[LevelParameters, ...]) -> None:
        """Set normalisation and mean of each level; see `LevelPolicies.centre_on`."""
        for own, level in zip(self.levels, levels, strict=True):
            own.centre_on(level)

    def start(self, lanes: slice | IntArray) -> None:
        """Start new episodes in `lanes`."""
        self.clock[lanes] = 0
        rows = self.rows(lanes)
        self.goals_reached[rows] = 0
        for level in self.levels:
            level.start(lanes, rows)

    def go_on(self, lane: int, steps: int, goals: F64Array) -> None:
        """Continue, in the just started `lane`, episodes that were reset `steps` control steps ago.

        Args:
            lane: Index of the lane.
            steps: A multiple of the controller interval.
            goals: Successive goals [J, 2] relative to the robot at the time each is set, in metres. Empty if the
                environment sets the goals.
        """
        self.clock[lane] = steps

    @abstractmethod
    def act(self, inputs: AgentInputs) -> F32Array:
        """Return the controls [N, A] of one step."""

    def intrinsic_reward(self, position: F64Array) -> F64Array:
        """Return the intrinsic reward [N] for moving to `position` [N, 2]; zeros without an intrinsic reward."""
        return np.zeros_like(position[:, 0], dtype=np.float64)

    def rows(self, lanes: slice | IntArray) -> slice | IntArray:
        """Return the rows of the episodes of `lanes`. All lanes are given as a slice, which is faster."""
        if isinstance(lanes, slice):
            assert lanes == slice(None)
            return lanes
        rows = (lanes[:, None] * self.rows_per_lane + np.arange(self.rows_per_lane)).ravel()
        return self.xp.asarray(rows)


class FlatAgent(AgentBatch["FlatDesign"]):
    """Policies without goals, in P lanes of R episodes each."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._inputs: F64Array = self.xp.zeros((self.num_rows, self.design.observation_sizes[0]))

    def act(self, inputs: AgentInputs) -> F32Array:
        """Return the controls [N, A] of one step."""
        clock, size = self.design.clock, 0
        if clock is not None:
            size = clock.size
            clock.write(self.xp.asarray(self.clock), self._inputs[:, :size])
        self._inputs[:, size:] = inputs.observation
        self.clock += 1
        return self.levels[0].act(self._inputs, inputs.control_noise)


@dataclass(frozen=True, kw_only=True)
class FlatDesign(AgentDesign):
    """Design of a flat agent. The policy observes the clock, then the observation of the task."""

    agent = FlatAgent
