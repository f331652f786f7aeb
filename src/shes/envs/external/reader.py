"""Reads what a Gymnasium environment shows: flat observations, position and heading, actions within its bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from shes.envs.episode_batch import Reader
from shes.envs.quaternions import yaw
from shes.errors import ConfigError, ShapeError
from shes.types import F64Array, FloatArray, IntArray

if TYPE_CHECKING:
    from gymnasium import Space
    from gymnasium.spaces import Box

__all__ = ["ExternalReader"]


@dataclass(frozen=True, kw_only=True)
class ExternalReader(Reader):
    """What is known of an environment without making it. A row is the flat observation, then values of `info`."""

    observation_space: Space[Any]
    action_space: Box
    observation_size: int
    info_keys: Mapping[str, int]
    """Keys of `info` that are read, with the number of their values."""
    position: IntArray
    """Columns of x and y in a row."""
    heading: IntArray
    """Columns of the yaw, or of the quaternion w x y z; none is a yaw of 0."""

    @property
    def row_size(self) -> int:
        """Values of a row."""
        return self.observation_size + sum(self.info_keys.values())

    def write(self, observation: Any, info: Mapping[str, Any], out: F64Array) -> None:
        """Write one environment's observation and values of `info` into the row `out`.

        Raises:
            ConfigError: They are not as large as at first, or `info` lacks a key.
        """
        flat = self._flattened(observation)
        if flat.shape != (self.observation_size,):
            raise ConfigError(
                f"the observation must have {self.observation_size} values, as its space has, and has {flat.size}."
            )
        out[: self.observation_size] = flat
        self._write_info(info, out)

    def _write_info(self, info: Mapping[str, Any], out: F64Array) -> None:
        start = self.observation_size
        for key, size in self.info_keys.items():
            if key not in info:
                raise ConfigError(f"info has no {key!r} at this step, from which position or heading are read.")
            values = np.ravel(info[key])
            if values.size != size:
                raise ConfigError(f"info[{key!r}] must have {size} values, as at first, and has {values.size}.")
            out[start : start + size] = values
            start += size

    def whereabouts(self, rows: F64Array) -> tuple[F64Array, F64Array]:
        """Return position [N, 2] in metres and heading [N] in radians from rows with the values of `info`."""
        turn = rows[:, self.heading]
        if not turn.shape[1]:
            return rows[:, self.position], np.zeros(len(rows))
        if turn.shape[1] == 1:
            return rows[:, self.position], np.arctan2(np.sin(turn[:, 0]), np.cos(turn[:, 0]))
        return rows[:, self.position], yaw(turn)

    def rows(self, observation: Any, num_envs: int) -> tuple[F64Array, bool]:
        """Return `observation`, flat or as the environment gives it, as rows [num_envs, O], and whether it is single.

        Raises:
            ShapeError: It is not an observation of `num_envs` environments.
        """
        try:
            flat = self._flat(observation)
            if flat is None:
                whole = np.array([self._flattened(each) for each in self._single_ones(observation, num_envs)])
            else:
                whole = np.atleast_2d(flat)
        except (KeyError, TypeError, ValueError, IndexError) as error:
            raise ShapeError(f"this is no observation of {self.observation_space}: {error!r}.") from error
        if whole.shape != (num_envs, self.observation_size):
            raise ShapeError(f"there must be observations of {num_envs} environments, got {len(whole)}.")
        return whole, num_envs == 1 if flat is None else flat.ndim == 1

    def _flat(self, observation: Any) -> F64Array | None:
        """Return a flat observation [O] or several [N, O]; None if it is neither."""
        if isinstance(observation, Mapping | tuple):
            return None
        seen = np.asarray(observation, dtype=np.float64)
        return seen if seen.ndim in (1, 2) and seen.shape[-1] == self.observation_size else None

    def _single_ones(self, observation: Any, num_envs: int) -> Sequence[Any]:
        """Return the observation of each environment: as it is, or out of those of a vector environment."""
        from gymnasium.vector.utils import batch_space, iterate

        if num_envs == 1:
            return [observation]
        return list(iterate(batch_space(self.observation_space, num_envs), observation))

    def _flattened(self, observation: Any) -> F64Array:
        from gymnasium.spaces import flatten

        flat: Any = flatten(self.observation_space, observation)  # an array: `find` has refused other spaces
        return np.asarray(flat, dtype=np.float64)

    def locate(self, rows: F64Array, info: Mapping[str, Any] | None) -> tuple[F64Array, F64Array]:
        """Return position [N, 2] in metres and heading [N] in radians.

        Raises:
            ConfigError: They are in `info`, which was not given.
        """
        if not self.info_keys:
            return self.whereabouts(rows)
        if info is None:
            keys = ", ".join(map(repr, self.info_keys))
            raise ConfigError(f"position or heading are in info ({keys}): agent.act(observation, info).")
        whole = np.zeros((len(rows), self.row_size))
        whole[:, : self.observation_size] = rows
        for number, row in enumerate(whole):
            # A vector environment has one value for each of its environments under every key.
            own = info if len(rows) == 1 else {key: info[key][number] for key in self.info_keys if key in info}
            self._write_info(own, row)
        return self.whereabouts(whole)

    def to_action(self, control: FloatArray) -> FloatArray:
        """Return `control` [N, A], cut to [-1, 1] and stretched to the action space's bounds, as actions [N, ...]."""
        low, high = (bound.ravel().astype(np.float64) for bound in (self.action_space.low, self.action_space.high))
        action: Any = (low + high) / 2 + np.clip(control, -1.0, 1.0) * ((high - low) / 2)
        return action.astype(np.dtype(self.action_space.dtype)).reshape(-1, *self.action_space.shape)
