"""What the rooms above need of an environment, whoever built it: N episodes, stepped together.

Two kinds fulfil it: `Task`, a world of our own on MuJoCo, and `ExternalTask`, N environments of Gymnasium. Nobody asks
which one it has.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any, ClassVar

import mujoco
import numpy as np

from shes.envs.bodies.body import Body
from shes.envs.markers import Marker
from shes.errors import ConfigError
from shes.types import BoolArray, F64Array, FloatArray, IntArray

__all__ = ["EpisodeBatch", "Reader"]

_NO_STATES = (
    "episodes of an environment that Gymnasium makes cannot be branched: its physics state is its own. "
    "Set --primitive-estimate episode."
)


class Reader(ABC):
    """What an agent must know of an environment to act in it: no simulation, nothing that is live."""

    observation_size: int
    """Number of observed values, O."""

    @abstractmethod
    def rows(self, observation: Any, num_envs: int) -> tuple[F64Array, bool]:
        """Return `observation` as rows [num_envs, O], and whether it is that of one environment alone.

        Raises:
            ShapeError: It is not an observation of `num_envs` environments.
        """

    @abstractmethod
    def locate(self, rows: F64Array, info: Mapping[str, Any] | None, env: Any = None) -> tuple[F64Array, F64Array]:
        """Return position [N, 2] in metres and heading [N] in radians of robots that observe `rows` [N, O].

        Args:
            rows: What they observe.
            info: What the environment says beside it.
            env: The environment itself.

        Raises:
            ConfigError: What they are read from was not given: `info` or `env`.
        """

    def goal(self, rows: F64Array, position: F64Array, heading: F64Array) -> F64Array | None:
        """Return where the environment itself tells robots to go [N, 2], in metres; none where it does not.

        Args:
            rows: What they observe [N, O].
            position: Where they are [N, 2], in metres.
            heading: Their yaw [N], in radians.
        """
        del rows, position, heading
        return None

    @abstractmethod
    def to_action(self, control: F64Array) -> FloatArray:
        """Return `control` [N, A], cut to its limits, as actions of the environment's own action space."""


class EpisodeBatch(ABC):
    """N episodes of one environment. Arrays are live and belong to it: copy what must outlast the next step."""

    num_episodes: int
    """Number of episodes, N."""
    time: IntArray
    """Control steps since the reset [N]."""
    reward: F64Array
    """Reward of the last step [N]; 0 where the simulation diverged."""
    running_return: F64Array
    """Sum of the rewards since the reset [N]."""
    step_s: float
    """Simulated time of a control step, in seconds."""
    _physics_s: float = 0.0
    ground_m: ClassVar[float] = 0.0
    """Height of the ground that the robot starts on."""

    @property
    def xp(self) -> ModuleType:
        """Array module of every array here: NumPy, or CuPy on a card."""
        return np

    @property
    def starts_together(self) -> bool:
        """Whether episodes had best be reset all together, rather than as lanes become free."""
        return False

    @property
    def physics_s(self) -> float:
        """Seconds of wall clock spent in the simulation so far."""
        return self._physics_s

    def check_buffers(self) -> None:  # noqa: B027 - only a device has fixed buffers
        """Refuse physics for which the simulator had too little room; ask once a generation.

        Raises:
            ConfigError: Contacts or constraints were left out.
        """

    def check_position(self) -> None:  # noqa: B027 - most know it
        """Refuse a robot whose position nobody knows: goals need it; ask after the first reset.

        Raises:
            ConfigError: It is not known.
        """

    @property
    @abstractmethod
    def observation_size(self) -> int:
        """Number of observed values, O."""

    @property
    @abstractmethod
    def action_size(self) -> int:
        """Number of controls, A."""

    @property
    @abstractmethod
    def control_limit(self) -> float:
        """Controls lie in [-control_limit, control_limit]."""

    @property
    @abstractmethod
    def observation_names(self) -> tuple[str, ...]:
        """What each value of the observation is called."""

    @property
    @abstractmethod
    def position_columns(self) -> IntArray:
        """Indices in the observation of the robot's absolute x and y; none where it does not show them."""

    @property
    def robot(self) -> Body | None:
        """The robot, where it is one of our own."""
        return None

    @property
    def goal(self) -> F64Array | None:
        """Where the environment itself tells the robot to go [N, 2], in metres; none where a controller decides."""
        return None

    @property
    @abstractmethod
    def proprioception(self) -> IntArray:
        """Indices in the observation of the robot's own pose and velocity."""

    @property
    @abstractmethod
    def primitive_view(self) -> IntArray:
        """Indices in the observation of what the primitive may see; the rest is for the controller alone."""

    @property
    @abstractmethod
    def position(self) -> F64Array:
        """Place of the robot [N, 2] in metres."""

    @property
    @abstractmethod
    def heading(self) -> F64Array:
        """Yaw of the robot [N] in radians."""

    @property
    @abstractmethod
    def terminated(self) -> BoolArray:
        """Whether the episode has ended by the environment's own rule [N]; never by the time limit."""

    @property
    def fallen(self) -> BoolArray:
        """Whether the robot's fall has ended the episode [N]; every end, where the robot is not known."""
        return self.terminated

    @property
    @abstractmethod
    def diverged(self) -> BoolArray:
        """Whether the physics blew up since the reset [N]: the episode ends there and does not score."""

    @property
    @abstractmethod
    def score(self) -> F64Array:
        """The test score so far [N]; 0 where the simulation diverged."""

    @property
    @abstractmethod
    def success(self) -> BoolArray:
        """Whether the episode counts as solved so far [N]."""

    @property
    @abstractmethod
    def reader(self) -> Reader:
        """How an agent reads what it shows."""

    @abstractmethod
    def observe(self) -> F64Array:
        """Return what is observed now [N, O]: a live array, rewritten by the next call."""

    @abstractmethod
    def reset(self, ids: IntArray, seeds: Sequence[int], states: Sequence[F64Array | None] = ()) -> None:
        """Start episodes `ids` anew, each from its own seed (a non-negative integer).

        Args:
            ids: The episodes.
            seeds: What each draws from.
            states: Whole physics states [S] that episodes begin in instead of a reset pose, as `states` returned them;
                none, or None for an episode, leaves it in its reset pose. What belongs to the task is drawn anew.

        Raises:
            ConfigError: States were given, and episodes of this kind have none.
        """

    def states(self, ids: IntArray) -> F64Array:
        """Return copies of the whole physics states of episodes `ids` [ids, S], in NumPy's array.

        Raises:
            ConfigError: Nobody can read them: the physics is somebody else's.
        """
        del ids
        raise ConfigError(_NO_STATES)

    @abstractmethod
    def step(self, ids: IntArray, action: FloatArray) -> None:
        """Apply `action` [N, A] in control units for one control step of episodes `ids` (sorted, unique).

        Rows that are not in `ids` do not move; what is computed for them means nothing.
        """

    @property
    def draws_itself(self) -> bool:
        """Whether a `pose` is a picture that the environment has drawn, not the qpos of `world_to_draw`."""
        return False

    def world_to_draw(self) -> mujoco.MjSpec:
        """Return the world to draw poses in, made anew.

        Raises:
            ConfigError: The environment draws itself.
        """
        raise ConfigError("this environment draws itself: nobody else can.")

    def draw_by(self, mode: str) -> None:
        """Let an environment that draws itself do so in render mode `mode` from the next reset on.

        Raises:
            ConfigError: It has no such render mode.
        """
        raise ConfigError(f"this environment has no render mode {mode!r}: it does not draw itself.")

    @abstractmethod
    def pose(self, episode: int) -> Any:
        """Return a copy of what a drawer or a window needs to show episode `episode` as it is now."""

    def markers(self, episode: int) -> list[Marker]:
        """Return what to draw of episode `episode` beside its pose."""
        return []

    def close(self) -> None:  # noqa: B027 - most hold nothing
        """Give back what it holds."""
