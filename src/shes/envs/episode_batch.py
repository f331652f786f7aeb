"""The contract of an environment: N episodes, stepped together.

Two classes implement it: `Task`, a MuJoCo world of this package, and `ExternalTask`, N Gymnasium environments. Callers
never ask which one they have.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any, ClassVar, NamedTuple

import mujoco
import numpy as np

from shes.envs.bodies.body import Body
from shes.envs.markers import Marker
from shes.types import BoolArray, F64Array, FloatArray, IntArray


class Reader(ABC):
    """Interprets observations and actions of an environment for an agent. It holds no simulation."""

    observation_size: int
    """Number of observed values, O."""

    @abstractmethod
    def rows(self, observation: Any, num_envs: int) -> tuple[F64Array, bool]:
        """Return `observation` as rows [num_envs, O], and whether it belongs to a single environment."""

    @abstractmethod
    def locate(self, rows: F64Array, info: Mapping[str, Any] | None, env: Any = None) -> tuple[F64Array, F64Array]:
        """Return positions [N, 2] and headings [N] in radians of robots that observe `rows` [N, O].

        Positions are in units of `EpisodeBatch.scale`. An environment may need its `info`, or `env` itself.
        """

    def goal(self, rows: F64Array, position: F64Array, heading: F64Array) -> F64Array | None:
        """Return the goals [N, 2] that the environment sets, in units of what `locate` has found; None without."""
        return None

    @abstractmethod
    def to_action(self, control: F64Array) -> FloatArray:
        """Return actions of the environment's action space for `control` [N, A], clipped to the limits."""


class Places(NamedTuple):
    """Where robots are, for a search that goes back."""

    cells: IntArray
    """Cells [N, K], in whole steps of coordinates that matter in the task."""
    positions: F64Array
    """Positions [N, X] in units of `scale`: of the robot and, in Fall, of the block."""
    is_upright: BoolArray
    """Whether the robot has not fallen [N]."""
    is_success: BoolArray
    """Whether the task is solved there [N]."""


class EpisodeBatch(ABC):
    """N episodes of one environment. Its arrays are live: copy what must outlast the next step."""

    xp: ModuleType = np
    """Array module of every array here: NumPy, or CuPy on a CUDA device."""
    starts_together: bool = False
    """Whether resetting all episodes at once is faster than resetting each as its lane becomes free."""
    Options: ClassVar[Any]
    """Class of its options: a subclass of `TaskOptions` if the task adds its own."""
    sets_goals: ClassVar[bool] = False
    """Whether the task sets the goals, so that a primitive can be trained without a controller."""
    has_places: ClassVar[bool] = False
    """Whether the task has a target, and `places` to search for a way to it."""
    ground_m: float = 0.0
    """Height of the ground at the robot's start, in units of `scale`."""
    scale: float = 1.0
    """Unit of positions, goals, distances and rewards in metres: 1, but for a robot from a file; see `Body.scale`.

    Observed coordinates and velocities are in metres in any case."""
    robot: Body | None = None
    """The robot; None in an external environment, which draws itself."""
    num_episodes: int
    """Number of episodes, N."""
    action_size: int
    """Number of controls, A."""
    control_limit: float
    """Controls lie in [-control_limit, control_limit]."""
    step_s: float
    """Simulated time of a control step in seconds."""
    observation_size: int
    """Number of observed values, O."""
    observation_names: tuple[str, ...]
    """Name of each observed value."""
    proprioception: IntArray
    """Indices in the observation of the robot's own coordinates and velocities."""
    primitive_view: IntArray
    """Indices in the observation that the primitive may see; the others are for the controller only."""
    position_columns: IntArray = np.zeros(0, np.int64)
    """Indices in the observation of the robot's absolute x and y; none if they are unknown."""
    sensor_rings: IntArray = np.zeros((0, 0), np.int64)
    """Indices in the observation of range sensors around the robot [rings, sectors]; none if this is empty.

    Sectors are counter-clockwise; the first begins straight behind the robot. Ring 0 senses what attracts it.
    """
    reader: Reader
    """The reader of this environment's observations and actions."""
    time: IntArray
    """Control steps since the reset [N]."""
    reward: F64Array
    """Reward of the last step [N]; 0 where the simulation diverged."""
    running_return: F64Array
    """Sum of the rewards since the reset [N]."""
    diverged: BoolArray
    """Whether the physics has diverged since the reset [N]: the episode ends and does not score."""
    truncated: BoolArray
    """Whether a time limit of the environment's own has ended the episode [N]: its state is not a terminal one."""
    goal: F64Array | None = None
    """Goals that the environment sets [N, 2], in units of `scale`; None if a controller sets them."""
    ends_early: bool = False
    """Whether an aid of training ends episodes that the task itself would not end."""

    @property
    @abstractmethod
    def physics_s(self) -> float:
        """Wall-clock seconds spent in the simulation so far."""

    def check_buffers(self) -> None:  # noqa: B027 - only a device has fixed buffers
        """Raise a ConfigError if a buffer of the simulator has overflowed since the start; called once a generation."""

    def check_position(self) -> None:  # noqa: B027 - most environments know it
        """Raise a ConfigError if the robot's position, which goals need, is unknown; called after the first reset."""

    @property
    @abstractmethod
    def position(self) -> F64Array:
        """Robots' positions [N, 2], in units of `scale`."""

    @property
    @abstractmethod
    def heading(self) -> F64Array:
        """Robots' headings (yaw) [N] in radians."""

    @property
    @abstractmethod
    def terminated(self) -> BoolArray:
        """Whether the environment has ended the episode [N]. The horizon of training is not part of it."""

    @property
    @abstractmethod
    def fallen(self) -> BoolArray:
        """Whether the episode has ended by a fall [N]; in an external environment, by a termination without success."""

    @property
    def tilt(self) -> F64Array:
        """Tilt as a fraction of a fall [N]: (1 - cos tilt) / (1 - cos 60 degrees), at most 1; 0 if unknown."""
        return self.xp.zeros(self.num_episodes)

    @property
    def reward_after_end(self) -> F64Array:
        """Reward of each step up to the horizon that an ended episode no longer makes [N]; 0 unless it `ends_early`."""
        return self.xp.zeros(self.num_episodes)

    @property
    @abstractmethod
    def score(self) -> F64Array:
        """Test score so far [N]; 0 where the simulation diverged."""

    @property
    @abstractmethod
    def success(self) -> BoolArray:
        """Whether the episode counts as solved so far [N]."""

    @abstractmethod
    def observe(self) -> F64Array:
        """Return the current observations [N, O]: a live array, overwritten by the next call."""

    @abstractmethod
    def reset(self, ids: IntArray, seeds: Sequence[int], states: Sequence[F64Array | None] = ()) -> None:
        """Start new episodes in rows `ids`.

        Args:
            ids: Rows to reset.
            seeds: Seed of each episode, a non-negative integer of any size.
            states: Physics state [S] that each episode starts from, as returned by `states`; None, or an empty
                sequence, starts from the reset pose. What belongs to the task is drawn from the seed in any case.
        """

    def states(self, ids: IntArray) -> F64Array:
        """Return copies of the physics states of episodes `ids` [ids, S], as a NumPy array."""
        raise NotImplementedError

    def places(self, states: F64Array) -> Places:
        """Return where robots in physics states [N, S] are, if the task `has_places`."""
        raise NotImplementedError

    def set_way(self, way: F64Array | None) -> None:  # noqa: B027 - most environments have no way to a target
        """Let the reward lead through `way` [points, X] of `Places` from the next reset on; None for no way."""

    @abstractmethod
    def step(self, ids: IntArray, action: FloatArray) -> None:
        """Apply `action` [N, A], in control units, for one control step of episodes `ids` (sorted, unique).

        The other rows do not move; their rewards and features are undefined.
        """

    def world_to_draw(self) -> mujoco.MjSpec:
        """Return a new world to draw poses in, unless the environment draws itself."""
        raise NotImplementedError

    def draw_by(self, mode: str) -> None:
        """Make an environment that draws itself use render mode `mode` from the next reset on."""
        raise NotImplementedError

    @abstractmethod
    def pose(self, episode: int) -> Any:
        """Return a copy of the qpos of episode `episode`, for `world_to_draw`, or the picture that it draws itself."""

    def markers(self, episode: int) -> list[Marker]:
        """Return the markers to draw in episode `episode`."""
        return []

    def sensor_markers(self, episode: int) -> list[Marker]:
        """Return markers of what the robot's sensors read in episode `episode`; none without such sensors."""
        return []

    def close(self) -> None:  # noqa: B027 - most environments hold no resources
        """Release the environment's resources."""
