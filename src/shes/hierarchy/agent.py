"""The hierarchical agent: a controller sets a goal every c steps, a primitive acts on it every step.

Source: SHES paper II-A to II-C; algorithm specification sections 1 to 3. P policy pairs run at once, each in E
episodes; N = P * E. Nothing here knows of physics, fitness or noise tables.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shes.es.level import LevelParameters
from shes.es.statistics import normalise
from shes.hierarchy.goals import GoalEncoding
from shes.hierarchy.rewards import PrimitiveReward
from shes.policies.mlp import MLP, aligned_rows
from shes.types import CONTROLLER, PRIMITIVE, F32Array, F64Array, IntArray

__all__ = ["AgentDesign", "HierarchicalAgent", "Moments"]

_MIN_START_M = 1e-3  # a goal may be set where the robot stands; progress towards it must stay finite
MIN_COMPONENT_M = np.sqrt(0.5)
"""With a minimum goal distance, each component of a goal vector is pushed out to this: the goal is 1 m away or more."""


@dataclass(frozen=True, kw_only=True)
class AgentDesign:
    """What a hierarchical agent is made of; its parameters come separately."""

    controller: MLP
    primitive: MLP
    goal_encoding: GoalEncoding
    primitive_reward: PrimitiveReward
    goal_distance: float
    """Metres that an output of 1 of the controller stands for."""
    controller_interval: int
    """Steps that a goal is held (c)."""
    has_minimum_goal_distance: bool
    """Whether goals nearer than 1 m are pushed outward."""
    control_limit: float
    """Control that an output of 1 of the primitive stands for."""
    primitive_view: tuple[int, ...] | None = None
    """Indices in the observation of what the primitive sees; all of it if None."""

    @property
    def policies(self) -> tuple[MLP, MLP]:
        """The networks, controller first."""
        return (self.controller, self.primitive)

    @property
    def dims(self) -> tuple[int, int]:
        """Parameters of each level."""
        return (self.controller.num_params, self.primitive.num_params)

    @property
    def observation_sizes(self) -> tuple[int, int]:
        """Inputs of each level."""
        return (self.controller.sizes[0], self.primitive.sizes[0])


class Moments:
    """Sums of what each of N episodes observed at one level, for `ObservationStatistics`."""

    def __init__(self, num_episodes: int, size: int) -> None:
        """Hold sums of `size` values for `num_episodes` episodes."""
        self.count: IntArray = np.zeros(num_episodes, dtype=np.int64)
        self.total: F64Array = np.zeros((num_episodes, size))
        self.total_squares: F64Array = np.zeros((num_episodes, size))

    def add(self, rows: slice | IntArray, observation: F64Array) -> None:
        """Add one observation [rows, O] to each of `rows`."""
        self.count[rows] += 1
        self.total[rows] += observation
        self.total_squares[rows] += observation * observation

    def clear(self, rows: slice) -> None:
        """Forget what `rows` observed."""
        self.count[rows] = 0
        self.total[rows] = 0
        self.total_squares[rows] = 0


class HierarchicalAgent:
    """P policy pairs acting in E episodes each. Rows [N] are pair after pair."""

    def __init__(self, design: AgentDesign, num_policies: int, num_episodes: int) -> None:
        """Make room for `num_policies` pairs of `num_episodes` episodes; `load` fills it."""
        self.design = design
        self.num_policies, self.num_episodes = num_policies, num_episodes
        rows = num_policies * num_episodes
        self.theta = tuple(aligned_rows(num_policies, dim) for dim in design.dims)
        """Parameters [P, D] of each level: write a pair's before its `start`."""
        self.moments = tuple(Moments(rows, size) for size in design.observation_sizes)
        self.is_recording = False
        """Whether observations are summed into `moments`."""
        self.clock: IntArray = np.zeros(num_policies, dtype=np.int64)
        """Steps since the start of each pair's episodes [P]."""
        self.goal: F64Array = np.ones((rows, 2))
        """Goals in the world [N, 2], in metres."""
        self.goal_origin: F64Array = np.zeros((rows, 2))
        """Where the robots stood when their goals were set [N, 2]."""
        self.goal_start_distance: F64Array = np.ones(rows)
        """Distance to the goal when it was set [N]."""
        self._view: slice | IntArray = _columns(design.primitive_view)
        self._primitive_input: F64Array = np.zeros((rows, design.observation_sizes[PRIMITIVE]))
        self._normalisation: list[tuple[F64Array, F64Array]] = [(np.zeros(0), np.ones(0))] * 2

    def normalise_by(self, levels: tuple[LevelParameters, ...]) -> None:
        """Use the observation statistics of `levels`; their parameters are not touched."""
        self._normalisation = [(level.mean, level.inverse_std) for level in levels]

    def start(self, policy: int) -> None:
        """Begin new episodes for pair `policy`: a new goal at its next act."""
        rows = slice(policy * self.num_episodes, (policy + 1) * self.num_episodes)
        self.clock[policy] = 0
        for moments in self.moments:
            moments.clear(rows)

    def act(
        self,
        observation: F64Array,
        position: F64Array,
        heading: F64Array,
        controller_noise: F32Array | None = None,
        primitive_noise: F32Array | None = None,
    ) -> F32Array:
        """Return the controls [N, A] of one step, setting new goals where they are due.

        Args:
            observation: What the tasks show [N, O].
            position: Where the robots are [N, 2], in metres.
            heading: Their yaw [N], in radians.
            controller_noise: Added to the controllers' outputs [P, E, 2].
            primitive_noise: Added to the controls [P, E, A].
        """
        due = np.flatnonzero(self.clock % self.design.controller_interval == 0)
        if len(due):
            self._set_goals(due, observation, position, controller_noise)
        self.clock += 1

        inputs = self._primitive_input
        features = self.design.goal_encoding.size
        vector = self.goal - position
        self.design.goal_encoding.encode(vector, _length(vector), heading, inputs[:, :features])
        inputs[:, features:] = observation[:, self._view]
        if self.is_recording:
            self.moments[PRIMITIVE].add(slice(None), inputs)
        scaled = normalise(inputs, *self._normalisation[PRIMITIVE])
        control = self.design.primitive.act(self.theta[PRIMITIVE], self._by_policy(scaled))
        control *= np.float32(self.design.control_limit)
        if primitive_noise is not None:
            control += primitive_noise
        return control.reshape(len(observation), -1)

    def primitive_reward(self, position: F64Array) -> F64Array:
        """Return the primitives' reward [N] for having come to `position` [N, 2]."""
        return self.design.primitive_reward(
            _length(self.goal - position),
            self.goal_start_distance,
            position - self.goal_origin,
            self.goal - self.goal_origin,
        )

    def _set_goals(self, due: IntArray, observation: F64Array, position: F64Array, noise: F32Array | None) -> None:
        """Let the controllers of pairs `due` set goals relative to `position`."""
        rows = (due[:, None] * self.num_episodes + np.arange(self.num_episodes)).ravel()
        seen = observation[rows]
        if self.is_recording:
            self.moments[CONTROLLER].add(rows, seen)
        scaled = normalise(seen, *self._normalisation[CONTROLLER])
        everyone = len(due) == self.num_policies
        theta = self.theta[CONTROLLER] if everyone else _aligned_copy(self.theta[CONTROLLER], due)
        output = self.design.controller.act(theta, self._by_policy(scaled))
        if noise is not None:
            output += noise[due]
        vector = output.reshape(-1, 2).astype(np.float64) * self.design.goal_distance
        if self.design.has_minimum_goal_distance:
            vector = _push_outward(vector)
        self.goal_origin[rows] = position[rows]
        self.goal[rows] = position[rows] + vector
        # Not the length of `vector`: rounding must not make the goal's distance differ from its start distance.
        self.goal_start_distance[rows] = np.maximum(_length(self.goal[rows] - position[rows]), _MIN_START_M)

    def _by_policy(self, rows: F32Array) -> F32Array:
        """View rows [N, O] as [P, E, O]."""
        return rows.reshape(-1, self.num_episodes, rows.shape[1])


def _columns(indices: tuple[int, ...] | None) -> slice | IntArray:
    """Return what picks columns `indices`, all if None: a slice where it can be one, because that is quicker."""
    if indices is None or indices == tuple(range(len(indices))):
        return slice(None if indices is None else len(indices))
    return np.array(indices, dtype=np.int64)


def _aligned_copy(theta: F32Array, policies: IntArray) -> F32Array:
    """Return the rows of `policies`, each on a cache line as in `theta`."""
    out = aligned_rows(len(policies), theta.shape[1])
    np.take(theta, policies, axis=0, out=out)
    return out


def _length(vector: F64Array) -> F64Array:
    """Return the Euclidean length [N] of `vector` [N, 2]."""
    return np.sqrt(vector[:, 0] * vector[:, 0] + vector[:, 1] * vector[:, 1])


def _push_outward(vector: F64Array) -> F64Array:
    """Return `vector` [N, 2] with every component moved, away from 0, to at least `MIN_COMPONENT_M`.

    Source: `outer_clamp` of the authors' code, which sends a component of exactly 0 to the positive side.
    """
    return np.where(np.abs(vector) < MIN_COMPONENT_M, np.where(vector < 0, -MIN_COMPONENT_M, MIN_COMPONENT_M), vector)
