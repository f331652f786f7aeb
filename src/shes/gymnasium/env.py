"""The single Gymnasium environment, and what it shares with the vector environment, a task of N episodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import EzPickle
from numpy.typing import ArrayLike, NDArray

from shes.drawing.make_drawer import Drawer, make_drawer
from shes.drawing.renderer import CAMERAS, Picture
from shes.drawing.window import Window, open_window
from shes.envs.named_environments import ENVIRONMENTS, ROBOT_ENVIRONMENTS, with_robot
from shes.envs.tasks.task import Task
from shes.errors import ConfigError, PolicyError, ShapeError, UnknownNameError, nearest_first
from shes.settings import setting_fields
from shes.sim.simulator import CpuSimulator
from shes.types import BoolArray, F64Array, IntArray

_PICTURE_DEFAULTS: dict[str, Any] = {"width": 480, "height": 480, "camera": "follow"}
_INFO = ("success", "score", "distance", "position", "heading", "diverged")


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
        named = with_robot(name, options.get("robot"))
        environment = ENVIRONMENTS.find(named) if named not in ROBOT_ENVIRONMENTS else ROBOT_ENVIRONMENTS[named]
        options = {key: value for key, value in options.items() if key != "robot" or named == name}
        own = environment.task.Options
        names = {*setting_fields(own), *setting_fields(environment.body.Options), *_PICTURE_DEFAULTS}
        for option in options:
            if option not in names:
                known = ", ".join(nearest_first(option, names))
                raise ConfigError(f"the environment has no option {option!r}. Options: {known}.")
        simulator = partial(CpuSimulator, num_threads=min(num_threads, num_envs))
        self.task: Task = environment.with_options(options).make(num_envs, own.of(options), simulator)
        self._picture = {**_PICTURE_DEFAULTS, **options}
        if self._picture["camera"] not in CAMERAS:
            raise UnknownNameError("camera", self._picture["camera"], CAMERAS)
        low, high = np.array([(element.low, element.high) for element in self.task.observation_spec]).T
        self.observation_space = Box(low, high, dtype=np.float64)
        self.action_space = Box(-1.0, 1.0, (self.task.action_size,), dtype=np.float32)
        self._drawer: Drawer | None = None
        self._window: Window | None = None

    @property
    def ended(self) -> BoolArray:
        """Whether each episode has terminated [N]; a divergence terminates it."""
        return self.task.terminated | self.task.diverged

    def reset(self, ids: IntArray, seeds: Sequence[int | np.random.Generator]) -> None:
        """Start new episodes in rows `ids`, each from its seed or from one that a generator draws."""
        self.task.reset(ids, [int(it.integers(2**63)) if isinstance(it, np.random.Generator) else it for it in seeds])
        self._show(is_new_episode=True)

    def step(self, ids: IntArray, actions: ArrayLike) -> None:
        """Advance episodes `ids` by one control step with `actions` [N, A], clipped to [-1, 1].

        Raise ShapeError for another shape, and PolicyError for values that are no numbers or, in the rows of `ids`,
        NaN or infinite.
        """
        task = self.task
        expected = (task.num_episodes, task.action_size)
        try:
            asked = np.asarray(actions).astype(np.float64, casting="same_kind")
        except (TypeError, ValueError) as error:  # the latter: lists of different lengths
            raise PolicyError(f"an action must be an array of numbers in [-1, 1], got {actions!r}.") from error
        if asked.shape != expected:
            each = f" in each of {expected[0]} environments" if expected[0] > 1 else ""
            raise ShapeError(
                f"an action of {task.body.name}-{task.name} has shape ({expected[1]},){each}; "
                f"got {asked.shape if expected[0] > 1 else asked.shape[1:]}."
            )
        if not np.isfinite(asked[ids]).all():
            raise PolicyError("the action contains NaN or infinity; actions lie in [-1, 1]. Check the policy's output.")
        task.step(ids, np.clip(asked, -1.0, 1.0) * task.control_limit)
        self._show(is_new_episode=False)

    def info(self) -> dict[str, Any]:
        """Return the entries of `info`, as arrays [N] or [N, 2]."""
        values = {name: getattr(self.task, name) for name in _INFO} | self.task.counts
        return {name: np.array(value) for name, value in values.items()}

    def render(self, episode: int) -> Picture | None:
        """Return a picture [H, W, 3] of episode `episode` in mode `rgb_array`; None in mode `human`."""
        if self._render_mode is None:
            raise ConfigError('render_mode is not set: make the environment with render_mode="rgb_array" or "human".')
        if self._render_mode == "human":
            return None
        if self._drawer is None:
            self._drawer = make_drawer(self.task, self._picture["width"], self._picture["height"])
        return self._drawer.draw(self.task.pose(episode), self.task.markers(episode), self._picture["camera"])

    def _show(self, *, is_new_episode: bool) -> None:
        """Show the first episode in the window, in mode `human`."""
        if self._render_mode != "human":
            return
        if self._window is None:
            self._window = open_window(self.task)
        self._window.show(self.task.pose(0), self.task.markers(0), is_new_episode=is_new_episode)

    def close(self) -> None:
        """Close the window and free the renderer."""
        for holder in (self._drawer, self._window):
            if holder is not None:
                holder.close()
        self._drawer = self._window = None


class TaskEnv(gymnasium.Env[F64Array, NDArray[Any]], EzPickle):
    """One episode of a task at a time. Actions lie in [-1, 1]; a step of the ant takes 0.1 s of simulated time.

    A copy, or one that was pickled, is a new environment with the same arguments: reset it first.
    """

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
        EzPickle.__init__(self, name, render_mode, **options)
        self._adapter = TaskAdapter(name, 1, render_mode, self.metadata["render_modes"], options)
        self.task = self._adapter.task
        """The task with its simulation, to look at."""
        self.metadata = {**self.metadata, "render_fps": round(1 / self.task.step_s)}
        self.render_mode = render_mode
        self.observation_space = self._adapter.observation_space
        self.action_space = self._adapter.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[F64Array, dict[str, Any]]:
        """Start an episode. It depends on `seed` only; None continues with the previous seeds. `options` is ignored."""
        super().reset(seed=seed)
        self._adapter.reset(np.array([0]), [self.np_random if seed is None else seed])
        return self.task.observe()[0].copy(), self._info()

    def step(self, action: NDArray[Any]) -> tuple[F64Array, SupportsFloat, bool, bool, dict[str, Any]]:
        """Advance by a control step. A divergence terminates; the time limit is that of Gymnasium's wrapper."""
        self._adapter.step(np.array([0]), [action])
        reward = float(self.task.reward[0])
        return self.task.observe()[0].copy(), reward, bool(self._adapter.ended[0]), False, self._info()

    def _info(self) -> dict[str, Any]:
        found = {name: values[0] for name, values in self._adapter.info().items()}
        return {name: value if isinstance(value, np.ndarray) else value.item() for name, value in found.items()}

    def render(self) -> Picture | None:  # type: ignore[override] - never a list of pictures
        """Return a picture [H, W, 3]; None in mode `human`, in which every step and reset updates the window."""
        return self._adapter.render(0)

    def close(self) -> None:
        """Close the window and free the renderer."""
        self._adapter.close()
