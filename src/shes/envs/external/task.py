"""N single Gymnasium environments as a batch of episodes: stepped one after another, never at once."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from shes.envs.episode_batch import EpisodeBatch
from shes.envs.external.environment import ExternalEnvironment, explained
from shes.envs.external.reader import ExternalReader
from shes.envs.external.success import check_last_info, read_success
from shes.errors import ConfigError
from shes.sim.cpu import count_divergences, forget_divergences
from shes.types import BoolArray, F64Array, FloatArray, IntArray

if TYPE_CHECKING:
    import gymnasium

__all__ = ["ExternalTask"]

_SEEDS = 2**31
"""Seeds are taken modulo this: some environments hand theirs on to generators that take no more."""


class ExternalTask(EpisodeBatch):
    """N episodes of a described environment. An environment is made when its first episode begins.

    An episode depends on its seed alone if the environment's own `reset(seed=...)` sees to that.
    """

    def __init__(self, environment: ExternalEnvironment, num_episodes: int) -> None:
        """Make room for `num_episodes` environments."""
        self.environment = environment
        self.num_episodes = num_episodes
        self.step_s = environment.step_s
        self.time: IntArray = np.zeros(num_episodes, dtype=np.int64)
        self.reward: F64Array = np.zeros(num_episodes)
        self.running_return: F64Array = np.zeros(num_episodes)
        self._envs: list[gymnasium.Env[Any, Any] | None] = [None] * num_episodes
        self._physics: list[mujoco.MjData | None] = [None] * num_episodes
        self._rows: F64Array = np.zeros((num_episodes, environment.reader.row_size))
        self._terminated: BoolArray = np.zeros(num_episodes, dtype=np.bool_)
        self._diverged: BoolArray = np.zeros(num_episodes, dtype=np.bool_)
        self._success: BoolArray = np.zeros(num_episodes, dtype=np.bool_)
        self._render_mode: str | None = None

    @property
    def reader(self) -> ExternalReader:
        """How an agent reads what it shows."""
        return self.environment.reader

    @property
    def observation_size(self) -> int:
        """Number of values of the flat observation, O."""
        return self.reader.observation_size

    @property
    def observation_names(self) -> tuple[str, ...]:
        """The places in the flat observation: Gymnasium knows no names."""
        return tuple(f"{self.environment.description.id}[{i}]" for i in range(self.observation_size))

    @property
    def position_columns(self) -> IntArray:
        """Indices in the observation of the robot's x and y; none where they are in `info`."""
        return self.reader.position[self.reader.position < self.observation_size]

    @property
    def action_size(self) -> int:
        """Number of controls, A."""
        return int(np.prod(self.reader.action_space.shape))

    @property
    def control_limit(self) -> float:
        """Controls lie in [-1, 1]; the action space's bounds are where they lead."""
        return 1.0

    @property
    def proprioception(self) -> IntArray:
        """Indices in the observation of the robot's own dimensions."""
        return self.environment.proprioception

    @property
    def primitive_view(self) -> IntArray:
        """Indices in the observation of what the primitive may see."""
        return self.environment.primitive_view

    @property
    def position(self) -> F64Array:
        """Place of the robot [N, 2] in metres."""
        return self.reader.whereabouts(self._rows)[0]

    @property
    def heading(self) -> F64Array:
        """Yaw of the robot [N] in radians."""
        return self.reader.whereabouts(self._rows)[1]

    @property
    def terminated(self) -> BoolArray:
        """Whether the environment has ended the episode [N], also by a truncation of its own making."""
        return self._terminated

    @property
    def diverged(self) -> BoolArray:
        """Whether it showed or paid what is not finite, or its MuJoCo blew up [N]."""
        return self._diverged

    @property
    def success(self) -> BoolArray:
        """Whether `info` reported success at the last step [N]; False where it said nothing."""
        return self._success & ~self._diverged

    @property
    def score(self) -> F64Array:
        """The return, or 1 for success, as the description says [N]."""
        if self.environment.description.score == "success":
            return self.success.astype(np.float64)
        return np.where(self._diverged, 0.0, self.running_return)

    def observe(self) -> F64Array:
        """Return what is observed now [N, O]; zeros where the simulation diverged."""
        return self._rows[:, : self.observation_size]

    def reset(self, ids: IntArray, seeds: Sequence[int], states: Sequence[F64Array | None] = ()) -> None:
        """Start episodes `ids` anew, each from its own seed.

        Raises:
            ConfigError: The environment failed, or shows something else than it said.
        """
        if any(state is not None for state in states):
            self.states(ids)
        for values in (self.time, self.reward, self.running_return, self._terminated, self._diverged):
            values[ids] = 0
        with explained(self.environment.spec.id, "reset"):
            for i, seed in zip(ids.tolist(), seeds, strict=True):
                env = self._env(i)
                observation, info = env.reset(seed=int(seed) % _SEEDS)
                physics = self._physics[i] = _physics(env)
                if physics is not None:
                    forget_divergences(physics)
                self._take(i, observation, 0.0, info)

    def step(self, ids: IntArray, action: FloatArray) -> None:
        """Apply `action` [N, A] in [-1, 1] for one step of episodes `ids`.

        Raises:
            ConfigError: The environment failed, shows something else than it said, or does not say how it ended.
        """
        actions = self.reader.to_action(np.asarray(action, dtype=np.float64))
        with explained(self.environment.spec.id, "step"):
            for i in ids.tolist():
                start = perf_counter()
                observation, reward, terminated, truncated, info = self._env(i).step(actions[i])
                self._physics_s += perf_counter() - start
                self._terminated[i] = terminated or truncated
                self._take(i, observation, float(reward), info)
                if self._terminated[i] and not self._diverged[i]:
                    check_last_info(self.environment.description, info)
        self.time[ids] += 1
        self.running_return[ids] += self.reward[ids]

    def _take(self, i: int, observation: Any, reward: float, info: dict[str, Any]) -> None:
        """Write down what environment `i` shows and pays."""
        row, physics = self._rows[i], self._physics[i]
        self.reader.write(observation, info, row)
        is_finite = bool(np.isfinite(row).all()) and np.isfinite(reward)
        has_blown_up = bool(info.get("diverged", False)) or (physics is not None and count_divergences(physics) > 0)
        self._success[i] = read_success(info)
        self.reward[i] = reward
        if has_blown_up or not is_finite:
            self._diverged[i] = True
            self.reward[i] = 0.0
            np.nan_to_num(row, copy=False, nan=0.0, posinf=0.0, neginf=0.0)

    def _env(self, i: int) -> gymnasium.Env[Any, Any]:
        env = self._envs[i]
        if env is None:
            env = self._envs[i] = self.environment.make_one(self._render_mode)
        return env

    @property
    def draws_itself(self) -> bool:
        """Return True: Gymnasium's environments do."""
        return True

    def draw_by(self, mode: str) -> None:
        """Make the environments anew, at their next reset, with render mode `mode`.

        Raises:
            ConfigError: There is no such render mode.
        """
        modes = self.environment.render_modes
        if mode not in modes:
            raise ConfigError(
                f"{self.environment.description.id} has no render mode {mode!r}, so it cannot be drawn so. "
                f"It has {', '.join(map(repr, modes)) or 'none'}."
            )
        self.close()
        self._render_mode = mode

    def pose(self, episode: int) -> NDArray[np.uint8] | None:
        """Return the environment's own picture [H, W, 3]; None in its window, which needs none.

        Raises:
            ConfigError: It cannot be drawn, for example without OpenGL.
        """
        if self._render_mode != "rgb_array":
            return None
        with explained(self.environment.spec.id, "be drawn"):
            return np.array(self._env(episode).render(), dtype=np.uint8)

    def close(self) -> None:
        """Close the environments."""
        for i, env in enumerate(self._envs):
            if env is not None:
                env.close()
            self._envs[i] = self._physics[i] = None


def _physics(env: gymnasium.Env[Any, Any]) -> mujoco.MjData | None:
    """Return the MuJoCo simulation in an environment, or in one that this holds, if there is one."""
    import gymnasium

    inner = env.unwrapped
    for holder in (inner, *(each.unwrapped for each in vars(inner).values() if isinstance(each, gymnasium.Env))):
        data = vars(holder).get("data")
        if isinstance(data, mujoco.MjData):
            return data
    return None
