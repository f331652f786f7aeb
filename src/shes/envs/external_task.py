# pyright: reportIncompatibleMethodOverride=false
"""External environments: what makes one, and N of them as a batch of episodes, stepped one after another."""

from __future__ import annotations

import gc
import importlib
import io
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, redirect_stderr
from copy import deepcopy
from dataclasses import dataclass, replace
from difflib import get_close_matches
from operator import attrgetter
from time import perf_counter
from typing import Annotated, Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec

from shes.envs.episode_batch import EpisodeBatch
from shes.envs.external_reader import LARGEST, ExternalReader, Locate, find_physics
from shes.envs.tasks.task import SimulatorFactory, TaskOptions
from shes.errors import ConfigError, MissingExtraError, ShesError, UnknownNameError, place_of
from shes.machine import resident_memory, signals_delayed
from shes.registry import full_name
from shes.settings import Example
from shes.sim.simulator import DIVERGENCE, CpuSimulator, log_physics_warnings
from shes.types import F64Array, FloatArray, IntArray

_LOG = logging.getLogger("shes.run")
_ROBOTICS = ("AntMaze", "PointMaze", "Fetch", "HandManipulate", "HandReach", "AdroitHand", "FrankaKitchen")
_NUM_SEEDS = 2**31  # seeds are taken modulo this: some environments pass theirs on to generators that accept no more


@dataclass(frozen=True, kw_only=True)
class ExternalOptions(TaskOptions):
    """Options of every external environment."""

    env_kwargs: Annotated[dict[str, Any] | None, Example("""'{"size": 3}'""")] = None
    """Keyword arguments of `gymnasium.make`, or of the function that makes the environment, in JSON."""
    reset_options: Annotated[dict[str, Any] | None, Example("""'{"start": [0, 1]}'""")] = None
    """Options of every reset, `reset(options=...)`, in JSON."""


class ExternalTask(EpisodeBatch):
    """N episodes of an external environment.

    `terminated` is True where the environment has ended the episode: by termination or by its own truncation.
    `fallen` is True only where it has terminated the episode and `info` reports no success.
    """

    Options = ExternalOptions
    control_limit = 1.0
    # The contract's read-only properties.
    position, heading = property(attrgetter("_position")), property(attrgetter("_heading"))
    terminated, fallen = property(attrgetter("_terminated")), property(attrgetter("_fallen"))
    physics_s = property(attrgetter("_physics_s"))
    score, success = property(attrgetter("_score")), property(attrgetter("_success"))

    def __init__(self, environment: ExternalEnvironment, num_episodes: int) -> None:
        """Make the first of `num_episodes` environments and inspect it; the others are made at their first reset."""
        self.environment, self.num_episodes = environment, num_episodes
        self._render_mode: str | None = None
        self._envs: list[gymnasium.Env[Any, Any] | None] = [None] * num_episodes
        env = self._env(0)
        with environment.explained("be used"):
            self.reader = self._reader = ExternalReader(env, environment.locate, environment.primitive_view)
            self.step_s = 1 / float(env.metadata.get("render_fps") or 10)
        self.action_size, self.observation_size = self.reader.action_size, self.reader.observation_size
        self.observation_names = tuple(f"{environment.name}[{i}]" for i in range(self.observation_size))
        self.primitive_view = self.proprioception = self.reader.primitive_view
        self._physics_s = 0.0
        self.time: IntArray = np.zeros(num_episodes, np.int64)
        self.reward, self.running_return, self._score, self._heading = np.zeros((4, num_episodes))
        self._terminated, self.truncated, self._fallen = np.zeros((3, num_episodes), np.bool_)
        self.diverged, self._success = np.zeros((2, num_episodes), np.bool_)
        self._position, self._rows = np.zeros((num_episodes, 2)), np.zeros((num_episodes, self.observation_size))

    def check_position(self) -> None:
        """Check that the robot can be located; see `EpisodeBatch.check_position`."""
        if not self._reader.can_locate:
            raise ConfigError(
                f"the position of the robot of {self.environment.name} is unknown, and no MuJoCo joints determine it. "
                "Call shes.register_external(name, make, locate=...), or set --algorithm es, which needs no position."
            )

    def observe(self) -> F64Array:
        """Return the current observations [N, O]; values that are not finite, or beyond `LARGEST`, are 0."""
        return self._rows

    def reset(self, ids: IntArray, seeds: Sequence[int], states: Sequence[F64Array | None] = ()) -> None:
        """Start new episodes in rows `ids`; see `EpisodeBatch.reset`."""
        for values in (self.time, self.running_return, self._terminated, self.truncated, self._fallen, self.diverged):
            values[ids] = 0
        asked = self.environment.options.reset_options
        for i, seed in zip(ids.tolist(), seeds, strict=True):
            env, options = self._env(i), {} if asked is None else {"options": deepcopy(asked)}
            with self.environment.explained("reset"):
                observation, info = env.reset(seed=int(seed) % _NUM_SEEDS, **options)
                physics = find_physics(env)
                if physics is not None:
                    physics.warning.number[DIVERGENCE] = 0  # as `mj_resetData` does
                self._record(i, env, observation, 0.0, info)

    def step(self, ids: IntArray, action: FloatArray) -> None:
        """Apply `action` [N, A] in [-1, 1] for one step of episodes `ids`; see `EpisodeBatch.step`."""
        actions = self.reader.to_action(np.asarray(action, dtype=np.float64))
        for i in ids.tolist():
            env, start = self._env(i), perf_counter()
            with self.environment.explained("step"):
                observation, reward, terminated, truncated, info = env.step(actions[i])
                self._physics_s += perf_counter() - start
                terminated, truncated = _truth("terminated", terminated), _truth("truncated", truncated)
                self._terminated[i] = terminated or truncated
                self.truncated[i] = truncated and not terminated
                self._record(i, env, observation, reward, info)
                self._fallen[i] = terminated and not self._success[i]
        self.time[ids] += 1

    def _record(self, i: int, env: gymnasium.Env[Any, Any], observation: Any, reward: Any, info: Any) -> None:
        """Store the results of a step or reset of environment `i`; a diverged episode earns and scores 0."""
        row, physics = self._reader.flat(observation), find_physics(env)
        if np.ndim(reward) or not hasattr(reward, "__float__"):  # as None and text, which float() would read
            raise ConfigError(f"its reward must be a number, got {reward!r}.")
        reward = float(reward)
        is_number = np.abs(row) <= LARGEST  # False for NaN, too
        is_broken = _truth("diverged", info.get("diverged", False)) or not (abs(reward) <= LARGEST and is_number.all())
        self._rows[i] = np.where(is_number, row, 0.0)
        self.diverged[i] |= is_broken or (physics is not None and physics.warning.number[DIVERGENCE].any())
        if self.diverged[i]:
            self.reward[i] = self._score[i] = self._success[i] = 0
            return
        self.reward[i] = reward
        self.running_return[i] += reward
        success, is_score = info.get("success", info.get("is_success")), self.environment.is_scored_by_success
        if is_score and success is None and self._terminated[i]:
            entries = ", ".join(info) or "empty"
            raise ConfigError(f"its score is success, but the last info does not report it: {entries}.")
        self._success[i] = success is not None and _truth("is_success", success)
        self._score[i] = self._success[i] if is_score else self.running_return[i]
        if self._reader.can_locate:
            *self._position[i], self._heading[i] = self._reader.planar_pose(row, info, env)

    def _env(self, i: int) -> gymnasium.Env[Any, Any]:
        """Return environment `i`, which is made at the first call."""
        if (env := self._envs[i]) is None:
            with signals_delayed():
                env = self._envs[i] = self.environment.make_one(self._render_mode)
        return env

    def draw_by(self, mode: str) -> None:
        """Make the environments anew, with render mode `mode`, at their next reset; see `EpisodeBatch.draw_by`."""
        if mode not in (modes := self._env(0).metadata.get("render_modes") or ["none"]):
            raise ConfigError(f"{self.environment.name} has no render mode {mode!r}, only {', '.join(modes)}.")
        self.close()
        self._render_mode = mode

    def pose(self, episode: int) -> Any:
        """Return the environment's picture [H, W, 3]; None in mode `human`, where its own window shows it."""
        with self.environment.explained("be drawn"):
            return np.array(self._env(episode).render(), np.uint8) if self._render_mode == "rgb_array" else None

    def close(self) -> None:
        """Close the environments: all of them, even if some raise an error."""
        envs = filter(None, self._envs)
        self._envs = [None] * self.num_episodes
        for env in envs:
            try:
                env.close()
            except (Exception, SystemExit) as error:  # noqa: BLE001 - of the user's code, and nothing depends on it any more
                _LOG.warning("%s cannot be closed: %s: %s", self.environment.name, type(error).__name__, error)


@dataclass(frozen=True, kw_only=True)
class ExternalEnvironment:
    """Makes episodes of a Gymnasium environment. Nothing is imported or made before it is needed."""

    task: ClassVar[type[EpisodeBatch]] = ExternalTask
    has_own_physics: ClassVar[bool] = True

    name: str
    source: str | EnvSpec | Callable[..., gymnasium.Env[Any, Any]]
    """Gymnasium id, registration, or a function that makes it. For the others see `shes.register_external`."""
    locate: Locate | None = None
    primitive_view: tuple[int, ...] | None = None
    is_scored_by_success: bool = False
    options: ExternalOptions = ExternalOptions()

    def with_options(self, values: Mapping[str, Any]) -> ExternalEnvironment:
        """Return this environment with its options among `values`."""
        return replace(self, options=ExternalOptions.of(values))

    def __repr__(self) -> str:
        """Return what makes it, by which `Registry` compares."""
        return full_name(self.source)

    def __getstate__(self) -> dict[str, Any]:
        """Replace the id by its registration, which a worker process lacks if a script made it."""
        return {**vars(self), "source": self.spec or self.source}

    @property
    def spec(self) -> EnvSpec | None:
        """Registration in Gymnasium; None if a function makes the environment. An unknown id raises."""
        if not isinstance(self.source, str):
            return None if callable(self.source) else self.source
        with self.explained("be found"):
            _import_robotics(self.source)
        if self.source not in gymnasium.registry:
            close = get_close_matches(self.source, gymnasium.registry, n=5) or ["none like it"]
            raise UnknownNameError("Gymnasium environment", self.source, close, "Import its package: --import MODULE.")
        return gymnasium.spec(self.source)

    @property
    def max_episode_steps(self) -> int | None:
        """Time limit of the registration, or None. An environment made by a function is made once to find out."""
        spec = self.spec
        if spec is None:
            with closing(self.make_one()) as env:
                spec = env.spec
        elif (limit := (self.options.env_kwargs or {}).get("max_episode_steps")) is not None:  # of `gymnasium.make`
            return limit
        return spec and spec.max_episode_steps

    def make(
        self, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
    ) -> ExternalTask:
        """Return `num_episodes` episodes. The options and the simulator of SHES's own physics have no effect."""
        return ExternalTask(self, num_episodes)

    def make_one(self, render_mode: str | None = None) -> gymnasium.Env[Any, Any]:
        """Return a single environment without the time limit of its registration: the caller counts the steps."""
        spec, asked = self.spec, deepcopy(self.options.env_kwargs or {})
        asked |= {} if render_mode is None else {"render_mode": render_mode}
        log_physics_warnings()  # MuJoCo's compiler warns too
        with self.explained(f"be made{f' with {asked}' if asked else ''}"):
            if spec is not None:
                _import_robotics(spec.id)
                return gymnasium.make(spec, **asked | {"max_episode_steps": -1, "disable_env_checker": True})
            env: Any = self.source(**asked)  # type: ignore[operator] - without a spec it is a function
            if not isinstance(env, gymnasium.Env):
                raise ConfigError(f"its function must return a gymnasium.Env, got {env!r}.")
            return env

    def measured_bytes(self) -> int:
        """Return the bytes of memory that one more environment takes, where the system tells. One is made for it."""
        gc.collect()  # what is freed meanwhile would be subtracted
        before = resident_memory()
        with closing(self.make(1)) as task:
            task.reset(np.array([0]), [0])
            return max(0, resident_memory() - before)

    @contextmanager
    def explained(self, action: str) -> Iterator[None]:
        """Turn any error into a ConfigError or MissingExtraError: "<name> cannot <action>: <error> (<file>:<line>)"."""
        try:
            yield
        except (Exception, SystemExit) as error:
            kind = f"{type(error).__name__}: " * (not isinstance(error, ShesError | ModuleNotFoundError))
            told = f"{self.name} cannot {action}: {kind}{' '.join(str(error).split())}"
            if not isinstance(error, ImportError | gymnasium.error.DependencyNotInstalled):
                place = place_of(error, outside=("shes", "gymnasium"))
                raise ConfigError(told.rstrip(": ") + f" ({place})" * bool(place and kind)) from error
            entry = getattr(gymnasium.registry.get(str(getattr(self.source, "id", self.source))), "entry_point", "")
            # gymnasium.envs.box2d.lunar_lander:LunarLander is installed by the extra gymnasium[box2d].
            part = str(entry).partition("gymnasium.envs.")[2].partition(".")[0].replace("_", "-")
            extra = f"gymnasium[{part}]" if part else "shes[robotics]" if "gymnasium_robotics" in told else None
            if part and isinstance(error, gymnasium.error.DependencyNotInstalled):  # its advice names other packages
                told = f"{self.name} cannot {action}: {str(error).partition(',')[0]}"
            fix = f" (pip install '{extra}')" if extra and "pip install" not in told else ""
            raise MissingExtraError(told + fix) from error


def _truth(name: str, value: Any) -> bool:
    """Return a truth value that an environment reports as `name`; raise ConfigError if it is something else."""
    if np.ndim(value) or value not in (0, 1):  # as are False and True, also those of NumPy
        raise ConfigError(f"its {name} must be True, False, 1 or 0, got {value!r}.")
    return bool(value)


def _import_robotics(env_id: str) -> None:
    """Import Gymnasium-Robotics if `env_id` is one of its ids; no other package is imported automatically."""
    if env_id.startswith(_ROBOTICS):
        with redirect_stderr(io.StringIO()):  # it prints deprecation notices
            importlib.import_module("gymnasium_robotics")
