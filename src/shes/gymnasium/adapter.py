"""The common part of the single and the vector Gymnasium environment: spaces, actions, info and pictures of a task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from shes.drawing.make_drawer import make_drawer
from shes.drawing.renderer import Drawer, Picture, check_camera
from shes.drawing.window import Window, open_window
from shes.envs.named_environments import ENVIRONMENTS, Environment
from shes.envs.observation_spec import bounds
from shes.envs.tasks.task_options import TaskOptions
from shes.errors import ConfigError, PolicyError, ShapeError, UnknownNameError, nearest_first
from shes.settings import Settings, setting_fields
from shes.sim.cpu import CpuSimulator
from shes.types import BoolArray, F64Array, IntArray

_PICTURE_DEFAULTS: dict[str, Any] = {"width": 480, "height": 480, "camera": "follow"}


class TaskAdapter:
    """A task of N episodes with Gymnasium's spaces, actions, infos and pictures."""

    def __init__(
        self,
        name: str,
        num_envs: int,
        render_mode: str | None,
        render_modes: Sequence[str],
        options: Mapping[str, Any],
        num_threads: int = 1,
    ) -> None:
        """Make `num_envs` episodes of environment `name`, simulated by `num_threads` threads; check the names."""
        if render_mode is not None and render_mode not in render_modes:
            raise UnknownNameError("render_mode", str(render_mode), render_modes)
        self._render_mode = render_mode
        environment = ENVIRONMENTS.find(name)
        of_task, of_body, self._picture = _split_options(environment, options)
        if of_body is not None:
            environment = environment.with_body_options(of_body)
        simulator = partial(CpuSimulator, num_threads=min(num_threads, num_envs))
        self.task = environment.make(num_envs, of_task, simulator)
        low, high = bounds(self.task.observation_spec)
        self.observation_space = Box(low, high, dtype=np.float64)
        self.action_space = Box(-1.0, 1.0, (self.task.action_size,), dtype=np.float32)
        self._drawer: Drawer | None = None
        self._window: Window | None = None
        self._is_new_episode = True

    @staticmethod
    def draw_seed(rng: np.random.Generator) -> int:
        """Return a seed for the next episode of an environment with generator `rng`."""
        return int(rng.integers(0, 2**63))

    @property
    def ended(self) -> BoolArray:
        """Whether each episode has terminated [N]; a divergence terminates it."""
        return self.task.terminated | self.task.diverged

    def reset(self, ids: IntArray, seeds: Sequence[int]) -> None:
        """Start new episodes in rows `ids`."""
        self.task.reset(ids, seeds)
        self._is_new_episode = True
        self._show()

    def step(self, ids: IntArray, actions: ArrayLike) -> None:
        """Advance episodes `ids` by one control step with `actions` [N, A], clipped to [-1, 1].

        Raise ShapeError for another shape, and PolicyError for values that are no numbers or, in the rows of `ids`,
        NaN or infinite.
        """
        asked = _as_numbers(actions)
        expected = (self.task.num_episodes, self.task.action_size)
        if asked.shape != expected:
            each = f" in each of {expected[0]} environments" if expected[0] > 1 else ""
            raise ShapeError(
                f"an action of {self.task.body.name}-{self.task.name} has shape ({expected[1]},){each}; "
                f"got {asked.shape if expected[0] > 1 else asked.shape[1:]}."
            )
        if not np.isfinite(asked[ids]).all():
            raise PolicyError("the action contains NaN or infinity; actions lie in [-1, 1]. Check the policy's output.")
        self.task.step(ids, np.clip(asked, -1.0, 1.0) * self.task.control_limit)
        self._show()

    def observation(self) -> F64Array:
        """Return a copy of the observations [N, O]."""
        return self.task.observe().copy()

    def info(self) -> dict[str, Any]:
        """Return the entries of `info`, as arrays [N] or [N, 2]."""
        task = self.task
        return {
            "success": task.success.copy(),
            "score": task.score.astype(np.float64),
            "distance": task.distance.copy(),
            "position": task.position.copy(),
            "heading": task.heading.copy(),
            "diverged": task.diverged.copy(),
            **{name: np.array(count) for name, count in task.counts.items()},
        }

    def info_of(self, episode: int) -> dict[str, Any]:
        """Return the `info` of one episode."""
        of_one = {name: values[episode] for name, values in self.info().items()}
        return {name: value if isinstance(value, np.ndarray) else value.item() for name, value in of_one.items()}

    def render(self, episode: int) -> Picture | None:
        """Return a picture [H, W, 3] of episode `episode` in mode `rgb_array`; None in mode `human`."""
        if self._render_mode is None:
            raise ConfigError('render_mode is not set: make the environment with render_mode="rgb_array" or "human".')
        if self._render_mode == "human":
            return None
        if self._drawer is None:
            self._drawer = make_drawer(self.task, self._picture["width"], self._picture["height"])
        return self._drawer.draw(self.task.pose(episode), self.task.markers(episode), self._picture["camera"])

    def _show(self) -> None:
        """Show the first episode in the window, in mode `human`."""
        if self._render_mode != "human":
            return
        if self._window is None:
            self._window = open_window(self.task)
        self._window.show(self.task.pose(0), self.task.markers(0), is_new_episode=self._is_new_episode)
        self._is_new_episode = False

    def close(self) -> None:
        """Close the window and free the renderer."""
        for holder in (self._drawer, self._window):
            if holder is not None:
                holder.close()
        self._drawer = self._window = None


def _as_numbers(actions: ArrayLike) -> F64Array:
    """Return `actions` as float64; raise a PolicyError if they are not numbers, or lists of different lengths."""
    try:
        given = np.asarray(actions)
    except ValueError:
        given = np.array(None)
    if given.dtype.kind not in "biuf":
        raise PolicyError(f"an action must be an array of numbers in [-1, 1], got {actions!r}.")
    return given.astype(np.float64)


def _split_options(
    environment: Environment, options: Mapping[str, Any]
) -> tuple[TaskOptions, Settings | None, dict[str, Any]]:
    """Return the options of the task, those of the body, if it has any, and those of pictures; check them."""
    task, body = environment.options, environment.body.Options
    names = {*setting_fields(task), *setting_fields(body), *_PICTURE_DEFAULTS}
    for name in options:
        if name not in names:
            known = nearest_first(name, names)
            raise ConfigError(f"the environment has no option {name!r}. Options: {', '.join(known)}.")
    picture = {name: options.get(name, default) for name, default in _PICTURE_DEFAULTS.items()}
    check_camera(picture["camera"])
    return task.of(options), body.of(options) if setting_fields(body) else None, picture
