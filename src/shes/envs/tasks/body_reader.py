"""Reads a task's observations for an agent: the body's own coordinates tell where the robot is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shes.envs.bodies.body import Body
from shes.envs.episode_batch import Reader
from shes.errors import ShapeError
from shes.types import F64Array, IntArray


class BodyReader(Reader):
    """Observations are arrays [O] or [N, O]; actions lie in [-1, 1]."""

    def __init__(self, body: Body, observation_size: int, proprioception: IntArray) -> None:
        """Read observations of `observation_size` values; `proprioception` are the indices of qpos and qvel."""
        self.observation_size = observation_size
        self._body = body
        self._qpos = proprioception[: body.num_qpos]

    def rows(self, observation: Any, num_envs: int) -> tuple[F64Array, bool]:
        """Return `observation` as rows [num_envs, O], and whether it is a single [O]; see `Reader.rows`."""
        seen = np.asarray(observation, dtype=np.float64)
        rows = seen[None] if seen.ndim == 1 else seen
        if rows.shape != (num_envs, self.observation_size):
            size = self.observation_size
            raise ShapeError(f"observation must have shape ({size},) or ({num_envs}, {size}), got {seen.shape}.")
        return rows, seen.ndim == 1

    def locate(self, rows: F64Array, info: Mapping[str, Any] | None, env: Any = None) -> tuple[F64Array, F64Array]:
        """Return position [N, 2] in metres and heading [N] in radians, from the observation alone."""
        qpos = rows[:, self._qpos]
        return self._body.position(qpos), self._body.heading(qpos)

    def to_action(self, control: F64Array) -> F64Array:
        """Return `control` [N, A] scaled and clipped to [-1, 1]."""
        return np.clip(control / self._body.control_limit, -1, 1)
