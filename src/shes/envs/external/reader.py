"""Reads what a Gymnasium environment shows, finds its robot, and writes actions of its own action space."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, flatdim, flatten, unflatten
from gymnasium.vector.utils import batch_space, iterate

from shes.envs.episode_batch import Reader
from shes.envs.root import Place, find_root
from shes.errors import ConfigError, ShapeError
from shes.types import F64Array, FloatArray

__all__ = ["ExternalReader", "Locate", "find_physics"]

Locate: TypeAlias = Callable[[Any, Mapping[str, Any]], Place]
"""Returns (x, y, heading) of the robot, in metres and radians, from an observation and its `info`."""


class ExternalReader(Reader):
    """The spaces of an environment, and where its robot is. Rows are observations, by `gymnasium.spaces.flatten`."""

    def __init__(self, env: gymnasium.Env[Any, Any], locate: Locate | None, view: Sequence[int] | None) -> None:
        """Look at `env`; a ConfigError says why it cannot be used, or that `view` is no part of its observation."""
        self._seen, physics, actions = env.observation_space, find_physics(env), env.action_space
        if not self._seen.is_np_flattenable:
            raise ConfigError(f"its observation space must have a fixed size, and is {self._seen}.")
        is_box = isinstance(actions, Box) and actions.is_bounded() and np.issubdtype(actions.dtype, np.floating)
        if not is_box and not isinstance(actions, Discrete):
            raise ConfigError(f"its actions must be Discrete or a bounded Box of floats, and are {actions}.")
        self._actions: Any = actions
        self.observation_size, self.action_size = flatdim(self._seen), flatdim(actions)
        parts = self._seen.spaces if isinstance(self._seen, Dict) else {"": self._seen}
        shown = np.repeat([key != "desired_goal" for key in parts], [flatdim(part) for part in parts.values()])
        self.primitive_view = np.flatnonzero(shown) if view is None else np.array(view, np.int64)
        if len({*self.primitive_view} & {*range(len(shown))}) < len(self.primitive_view):
            raise ConfigError(f"primitive_view must be indices below {len(shown)}, each once, got {view}.")
        self._locate, self._root = locate, None if physics is None else find_root(physics.model)
        self.can_locate = locate is not None or self._root is not None

    def flat(self, observation: Any) -> F64Array:
        """Return one observation of the environment as a row [O]; a ValueError says that its size is wrong."""
        return np.asarray(flatten(self._seen, observation), np.float64).reshape(self.observation_size)

    def rows(self, observation: Any, num_envs: int) -> tuple[F64Array, bool]:
        """Return the observation of `num_envs` environments as rows [num_envs, O]; see `Reader.rows`."""
        is_single = num_envs == 1 and np.shape(observation) != (1, *(self._seen.shape or ()))
        try:
            each = [observation] if is_single else iterate(batch_space(self._seen, num_envs), observation)
            return np.array([self.flat(one) for one in each]).reshape(num_envs, self.observation_size), is_single
        except Exception as error:
            raise ShapeError(f"this is no observation of {self._seen}, times {num_envs}: {error!r}.") from error

    def place(self, row: F64Array, info: Mapping[str, Any], env: gymnasium.Env[Any, Any] | None) -> Place:
        """Return where the robot is: by the function that was registered, or else by the joints of `env`."""
        physics = None if env is None else find_physics(env)
        if self._locate is not None:
            found: Any = self._locate(unflatten(self._seen, row), info)
        elif physics is None or self._root is None:
            raise ConfigError("the robot is found in the environment itself: agent.act(observation, env=env).")
        else:
            found = self._root(physics.qpos)
        if np.shape(found) != (3,):
            raise ConfigError(f"locate must return (x, y, heading), got {found!r}.")
        return found

    def locate(self, rows: F64Array, info: Mapping[str, Any] | None, env: Any = None) -> tuple[F64Array, F64Array]:
        """Return position [N, 2] in metres and heading [N] in radians; see `Reader.locate`."""
        envs, places = getattr(env, "envs", [env] * len(rows)), np.empty((len(rows), 3))  # of a vector environment
        for i, row in enumerate(rows):
            own = {k: v[i] if len(rows) > 1 and np.ndim(v) else v for k, v in (info or {}).items()}
            try:
                places[i] = self.place(row, own, envs[i])
            except LookupError as error:
                raise ConfigError(f"locate failed ({error!r}). Give it info: agent.act(observation, info).") from error
        return places[:, :2], places[:, 2]

    def to_action(self, control: FloatArray) -> Any:
        """Return actions [N, ...]: `control` [N, A] stretched from [-1, 1] to the bounds, or its largest's index."""
        if isinstance(self._actions, Discrete):
            return self._actions.start + np.argmax(control, axis=1)
        low, high = (bound.ravel().astype(np.float64) for bound in (self._actions.low, self._actions.high))
        action: Any = (low + high) / 2 + np.clip(control, -1.0, 1.0) * ((high - low) / 2)
        return action.astype(np.dtype(self._actions.dtype)).reshape(-1, *self._actions.shape)


def find_physics(env: gymnasium.Env[Any, Any]) -> mujoco.MjData | None:
    """Return the MuJoCo simulation of an environment, or of one that it holds; None if there is none."""
    inner = env.unwrapped
    for holder in (inner, *(each.unwrapped for each in vars(inner).values() if isinstance(each, gymnasium.Env))):
        data = vars(holder).get("data")
        if isinstance(data, mujoco.MjData):
            return data
    return None
