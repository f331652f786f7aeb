"""Reads observations of a Gymnasium environment, locates its robot, and converts controls to its actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete, Tuple, flatdim, flatten, unflatten
from gymnasium.vector.utils import batch_space, iterate

from shes.envs.bodies.body import yaw
from shes.envs.episode_batch import Reader
from shes.errors import ConfigError, ShapeError
from shes.types import F64Array, FloatArray

LARGEST = 1e100
"""Values beyond this are no numbers to calculate with: the square of a larger one may be infinite."""

PlanarPose: TypeAlias = tuple[float, float, float]
"""x and y in metres, heading in radians."""
Locate: TypeAlias = Callable[[Any, Mapping[str, Any]], PlanarPose]
"""Returns (x, y, heading) of the robot, in metres and radians, from an observation and its `info`."""


class ExternalReader(Reader):
    """The spaces of an environment and the pose of its robot. Rows are observations flattened by Gymnasium."""

    def __init__(self, env: gymnasium.Env[Any, Any], locate: Locate | None, view: Sequence[int] | None) -> None:
        """Inspect `env`; for `locate` and `view` see `shes.register_external`."""
        self._space, physics, actions = env.observation_space, find_physics(env), env.action_space
        if not self._space.is_np_flattenable or not flatdim(self._space):
            raise ConfigError(f"its observation space must have a fixed size of at least 1, got {self._space}.")
        is_box = isinstance(actions, Box) and np.issubdtype(actions.dtype, np.floating) and flatdim(actions) > 0
        if not isinstance(actions, Discrete) and not (is_box and np.abs(_bounds(actions)).max() <= LARGEST):
            raise ConfigError(
                f"its action space must be Discrete or a Box of floats within {LARGEST:g}, not empty; got {actions}."
            )
        self._actions: Any = actions
        self.observation_size, self.action_size = flatdim(self._space), flatdim(actions)
        parts = self._space.spaces if isinstance(self._space, Dict) else {"": self._space}
        is_seen = np.repeat([key != "desired_goal" for key in parts], [flatdim(part) for part in parts.values()])
        self.primitive_view = np.flatnonzero(is_seen) if view is None else np.array(view, np.int64)
        if len({*self.primitive_view} & {*range(self.observation_size)}) < len(self.primitive_view):
            raise ConfigError(
                f"primitive_view must be distinct indices from 0 to {self.observation_size - 1}, got {view}."
            )
        self._locate, self._root = locate, None if physics is None else _find_root(physics.model)
        self.can_locate = locate is not None or self._root is not None

    def flat(self, observation: Any) -> F64Array:
        """Return one observation of the environment as a row [O]."""
        try:
            return np.asarray(flatten(self._space, observation), np.float64).reshape(self.observation_size)
        except Exception as error:
            raise ShapeError(f"its observation must be one of {self._space}, got {observation!r}.") from error

    def rows(self, observation: Any, num_envs: int) -> tuple[F64Array, bool]:
        """Return the observation of `num_envs` environments as rows [num_envs, O]; see `Reader.rows`."""
        is_single = num_envs == 1 and not _is_batch(self._space, observation)
        try:
            each = [observation] if is_single else iterate(batch_space(self._space, num_envs), observation)
            return np.array([self.flat(one) for one in each]).reshape(num_envs, self.observation_size), is_single
        except Exception as error:
            raise ShapeError(f"not an observation of {num_envs} times {self._space}: {error}") from error

    def planar_pose(self, row: F64Array, info: Mapping[str, Any], env: gymnasium.Env[Any, Any] | None) -> PlanarPose:
        """Return the robot's planar pose for observation `row` [O]: by `locate`, else from the joints of `env`."""
        if self._locate is not None:
            found: Any = self._locate(unflatten(self._space, row), info)
        else:
            physics = None if env is None else find_physics(env)
            if physics is None or self._root is None:
                raise ConfigError("the robot's pose is read from the environment: agent.act(observation, env=env).")
            found = self._root(physics.qpos)
        if np.shape(found) != (3,):
            raise ConfigError(f"locate must return (x, y, heading), got {found!r}.")
        return found

    def locate(self, rows: F64Array, info: Mapping[str, Any] | None, env: Any = None) -> tuple[F64Array, F64Array]:
        """Return position [N, 2] in metres and heading [N] in radians; see `Reader.locate`."""
        envs = getattr(env, "envs", [env] * len(rows))  # a vector environment has `envs`
        poses = np.empty((len(rows), 3))
        for i, row in enumerate(rows):
            told = info or {}  # a vector environment also says of each entry which environments gave it
            own = {k: v[i] if np.ndim(v) and (len(rows) > 1 or f"_{k}" in told) else v for k, v in told.items()}
            try:
                poses[i] = self.planar_pose(row, own, envs[i])
            except LookupError as error:
                raise ConfigError(f"locate failed ({error!r}). Pass info: agent.act(observation, info).") from error
        return poses[:, :2], poses[:, 2]

    def to_action(self, control: FloatArray) -> Any:
        """Return actions [N, ...] for `control` [N, A].

        A Box is filled by scaling [-1, 1] to its bounds; a Discrete action is the index of the largest control.
        """
        if isinstance(self._actions, Discrete):
            return self._actions.start + np.argmax(control, axis=1)
        low, high = _bounds(self._actions)
        action: Any = (low + high) / 2 + np.clip(control, -1.0, 1.0) * ((high - low) / 2)
        return action.astype(np.dtype(self._actions.dtype)).reshape(-1, *self._actions.shape)


def _bounds(space: Any) -> F64Array:
    return np.array([space.low.ravel(), space.high.ravel()], np.float64)


def _is_batch(space: Any, observation: Any) -> bool:
    """Return whether an observation of one environment has a batch axis, as in a vector environment of one."""
    try:
        while isinstance(space, Dict | Tuple):
            first: Any = next(iter(space)) if isinstance(space, Dict) else 0
            space, observation = space[first], observation[first]
    except (LookupError, TypeError):  # not an observation of this space
        return False
    return np.shape(observation) == (1, *(space.shape or ()))


def find_physics(env: gymnasium.Env[Any, Any]) -> mujoco.MjData | None:
    """Return the MuJoCo simulation of `env` or of an environment that it holds; None if there is none."""
    inner = env.unwrapped
    for holder in (inner, *(each.unwrapped for each in vars(inner).values() if isinstance(each, gymnasium.Env))):
        data = vars(holder).get("data")
        if isinstance(data, mujoco.MjData):
            return data
    return None


def _find_root(model: mujoco.MjModel) -> Callable[[F64Array], PlanarPose] | None:
    """Return a function that reads the robot's planar pose from qpos, or None if the joints do not determine it.

    The robot is the body of the first joint. It needs a free joint, or slide joints along x and y; a hinge about z is
    its heading, which is 0 without one.
    """
    kinds = mujoco.mjtJoint
    if model.njnt and model.jnt_type[0] == kinds.mjJNT_FREE:
        return lambda qpos: (float(qpos[0]), float(qpos[1]), float(yaw(qpos[3:7])))
    addresses: dict[tuple[int, tuple[float, ...]], int] = {}  # (joint type, axis) -> index in qpos
    for joint in np.flatnonzero(model.jnt_bodyid == model.jnt_bodyid[:1]):
        addresses[int(model.jnt_type[joint]), tuple(model.jnt_axis[joint].tolist())] = int(model.jnt_qposadr[joint])
    x, y = (addresses.get((int(kinds.mjJNT_SLIDE), axis)) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)))
    turn = addresses.get((int(kinds.mjJNT_HINGE), (0.0, 0.0, 1.0)))
    if x is None or y is None:
        return None
    return lambda qpos: (float(qpos[x]), float(qpos[y]), 0.0 if turn is None else float(qpos[turn]))
