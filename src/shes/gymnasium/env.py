"""The single Gymnasium environment: a task with one episode. `vector_env.py` has N."""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from numpy.typing import NDArray

from shes.drawing.renderer import Picture
from shes.gymnasium.adapter import TaskAdapter
from shes.types import F64Array


class TaskEnv(gymnasium.Env[F64Array, NDArray[Any]]):
    """One episode of a task at a time. Actions lie in [-1, 1]; a step takes 0.1 s of simulated time."""

    # RUF012: the type is Gymnasium's own.
    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 10}  # noqa: RUF012

    def __init__(self, name: str, render_mode: str | None = None, **options: Any) -> None:
        """Make environment `name` of the registry.

        Args:
            name: Name in the registry, e.g. `ant-gather`.
            render_mode: `rgb_array`, `human` or None.
            options: Options of the task, such as those of `MazeOptions`, and of its body; `width`, `height` and
                `camera` (`follow` or `top`) of pictures.
        """
        self._adapter = TaskAdapter(name, 1, render_mode, self.metadata["render_modes"], options)
        self.task = self._adapter.task
        """The task with its simulation, to look at."""
        self.render_mode = render_mode
        self.observation_space = self._adapter.observation_space
        self.action_space = self._adapter.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[F64Array, dict[str, Any]]:
        """Start an episode. It depends on `seed` only; None continues with the previous seeds. `options` is ignored."""
        super().reset(seed=seed)
        episode_seed = self._adapter.draw_seed(self.np_random) if seed is None else seed
        self._adapter.reset(np.array([0]), [episode_seed])
        return self._adapter.observation()[0], self._adapter.info_of(0)

    def step(self, action: NDArray[Any]) -> tuple[F64Array, SupportsFloat, bool, bool, dict[str, Any]]:
        """Advance by 0.1 s. A divergence terminates the episode; Gymnasium's wrapper applies the time limit."""
        adapter = self._adapter
        adapter.step(np.array([0]), [action])
        reward = float(adapter.task.reward[0])
        return adapter.observation()[0], reward, bool(adapter.ended[0]), False, adapter.info_of(0)

    def render(self) -> Picture | None:  # type: ignore[override] - never a list of pictures
        """Return a picture [H, W, 3]; None in mode `human`, in which every step and reset updates the window."""
        return self._adapter.render(0)

    def close(self) -> None:
        """Close the window and free the renderer."""
        self._adapter.close()
