# pyright: reportIncompatibleMethodOverride=false
"""N single Gymnasium environments as a batch of episodes: stepped one after another, never at once."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from time import perf_counter
from typing import Any

import gymnasium
import numpy as np

from shes.envs.episode_batch import EpisodeBatch
from shes.envs.external.environment import ExternalEnvironment
from shes.envs.external.reader import ExternalReader, find_physics
from shes.errors import ConfigError
from shes.sim.cpu import count_divergences, forget_divergences
from shes.types import F64Array, FloatArray, IntArray

__all__ = ["ExternalTask"]

_SEEDS = 2**31  # seeds are taken modulo this: some environments hand theirs on to generators that take no more


class ExternalTask(EpisodeBatch):
    """N episodes of an environment of others; each depends on its seed alone if the environment sees to that."""

    # The contract's properties, which pyright does not know from `attrgetter`: nothing is computed when asked for.
    reader = property(attrgetter("_reader"))
    observation_size = property(attrgetter("_reader.observation_size"))
    action_size = property(attrgetter("_reader.action_size"))
    control_limit = property(lambda _: 1.0)
    observation_names = property(lambda own: tuple(f"{own.environment.name}[{i}]" for i in range(own.observation_size)))
    position_columns = property(lambda _: np.zeros(0, np.int64))  # nobody knows them
    primitive_view = proprioception = property(attrgetter("_reader.primitive_view"))
    position, heading = property(attrgetter("_position")), property(attrgetter("_heading"))
    terminated, diverged = property(attrgetter("_terminated")), property(attrgetter("_diverged"))
    draws_itself = property(lambda _: True)
    score, success = property(attrgetter("_score")), property(attrgetter("_success"))

    def __init__(self, environment: ExternalEnvironment, num_episodes: int) -> None:
        """Make the first of `num_episodes` environments, and look at it; a ConfigError says what is wrong with it."""
        self.environment, self.num_episodes = environment, num_episodes
        self._render_mode: str | None = None
        self._envs: list[gymnasium.Env[Any, Any] | None] = [None] * num_episodes
        env = self._env(0)
        with environment.explained("be used"):
            self._reader = ExternalReader(env, environment.locate, environment.primitive_view)
        self.step_s = 1 / (env.metadata.get("render_fps") or 10)
        self.time: IntArray = np.zeros(num_episodes, np.int64)
        self.reward, self.running_return, self._score, self._heading = np.zeros((4, num_episodes))
        self._terminated, self._diverged, self._success = np.zeros((3, num_episodes), np.bool_)
        self._position, self._rows = np.zeros((num_episodes, 2)), np.zeros((num_episodes, self.observation_size))

    def check_position(self) -> None:
        """Refuse a robot that nobody can find; see `EpisodeBatch.check_position`."""
        if not self._reader.can_locate:
            raise ConfigError(
                f"nobody has told where the robot of {self.environment.name} is, nor do joints in MuJoCo. Tell it by "
                "shes.register_external(name, make, locate=...), or set --algorithm es, which needs no position."
            )

    def observe(self) -> F64Array:
        """Return what is observed now [N, O]; zeros where the simulation diverged."""
        return self._rows

    def reset(self, ids: IntArray, seeds: Sequence[int], states: Sequence[F64Array | None] = ()) -> None:
        """Start episodes `ids` anew, each from its own seed; see `EpisodeBatch.reset`."""
        if any(state is not None for state in states):
            self.states(ids)
        for values in (self.time, self.running_return, self._score, self._terminated, self._diverged):
            values[ids] = 0
        for i, seed in zip(ids.tolist(), seeds, strict=True):
            env = self._env(i)
            with self.environment.explained("reset"):
                observation, info = env.reset(seed=int(seed) % _SEEDS)
                physics = find_physics(env)
                if physics is not None:
                    forget_divergences(physics)
                self._take(i, env, observation, 0.0, info)

    def step(self, ids: IntArray, action: FloatArray) -> None:
        """Apply `action` [N, A] in [-1, 1] for one step of episodes `ids`; see `EpisodeBatch.step`."""
        actions = self._reader.to_action(np.asarray(action, dtype=np.float64))
        for i in ids.tolist():
            env, start = self._env(i), perf_counter()
            with self.environment.explained("step"):
                observation, reward, terminated, truncated, info = env.step(actions[i])
                self._physics_s += perf_counter() - start
                self._terminated[i] = terminated or truncated
                self._take(i, env, observation, float(reward), info)
        self.time[ids] += 1

    def _take(self, i: int, env: gymnasium.Env[Any, Any], observation: Any, reward: float, info: Any) -> None:
        """Write down what environment `i` shows, pays and reports; what has diverged neither pays nor scores."""
        row, physics = self._reader.flat(observation), find_physics(env)
        is_broken = bool(info.get("diverged", False)) or not (np.isfinite(reward) and np.isfinite(row).all())
        self._rows[i] = np.nan_to_num(row, nan=0.0, posinf=0.0, neginf=0.0)
        self._diverged[i] |= is_broken or (physics is not None and count_divergences(physics) > 0)
        if self._diverged[i]:
            self.reward[i] = self._score[i] = self._success[i] = 0
            return
        self.reward[i] = reward
        self.running_return[i] += reward
        success, is_score = info.get("success", info.get("is_success")), self.environment.is_scored_by_success
        if is_score and success is None and self._terminated[i]:
            raise ConfigError(f"its score is success, but the last info has none: {', '.join(info) or 'nothing'}.")
        self._success[i] = bool(success)
        self._score[i] = self._success[i] if is_score else self.running_return[i]
        if self._reader.can_locate:
            *self._position[i], self._heading[i] = self._reader.place(row, info, env)

    def _env(self, i: int) -> gymnasium.Env[Any, Any]:
        env = self._envs[i] = self._envs[i] or self.environment.make_one(self._render_mode)
        return env

    def draw_by(self, mode: str) -> None:
        """Make the environments anew, at their next reset, with render mode `mode`; see `EpisodeBatch.draw_by`."""
        if mode not in (modes := self._env(0).metadata.get("render_modes") or ["none"]):
            raise ConfigError(f"{self.environment.name} has no render mode {mode!r}, only {', '.join(modes)}.")
        self.close()
        self._render_mode = mode

    def pose(self, episode: int) -> Any:
        """Return the environment's own picture [H, W, 3]; None in its window, which needs none."""
        with self.environment.explained("be drawn"):
            return np.array(self._env(episode).render(), np.uint8) if self._render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the environments."""
        for env in filter(None, self._envs):
            env.close()
        self._envs = [None] * self.num_episodes
