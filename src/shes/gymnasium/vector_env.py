"""The vector Gymnasium environment: a task with N episodes, stepped at once.

It implements the three autoreset modes of Gymnasium's `VectorEnv`. Its results are bit-identical to those of
`SyncVectorEnv` over N single environments.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import EzPickle
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from shes.drawing.renderer import Picture
from shes.errors import ConfigError
from shes.gymnasium.env import TaskAdapter
from shes.machine import num_cores
from shes.settings import Ge, checked, out_of_range
from shes.types import BoolArray, F64Array, IntArray, is_whole

_RENDER_MODES = ["rgb_array"]


class TaskVectorEnv(VectorEnv[F64Array, NDArray[Any], NDArray[Any]], EzPickle):
    """N episodes of a task at a time. Actions [N, A] lie in [-1, 1]; a step of the ant takes 0.1 s of simulated time.

    A copy, or one that was pickled, is a new environment with the same arguments: reset it first.
    """

    @checked
    def __init__(
        self,
        name: str,
        num_envs: Annotated[int, Ge(1)] = 1,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        num_threads: Annotated[int, Ge(0)] = 0,
        **options: Any,
    ) -> None:
        """Make `num_envs` copies of environment `name` of the registry.

        Args:
            name: Name in the registry, e.g. `ant-gather`.
            num_envs: Number of environments, N.
            max_episode_steps: Control steps after which an episode is truncated; None or -1 is no limit.
            render_mode: `rgb_array` or None.
            autoreset_mode: When an episode that has ended is reset: `NextStep`, `SameStep` or `Disabled`.
            num_threads: Threads of the simulation; 0 is one for each core. Results do not depend on it.
            options: Options of the task, such as those of `MazeOptions`, and of its body; `width`, `height` and
                `camera` (`follow` or `top`) of pictures.
        """
        EzPickle.__init__(self, name, num_envs, max_episode_steps, render_mode, autoreset_mode, num_threads, **options)
        self._adapter = TaskAdapter(name, num_envs, render_mode, _RENDER_MODES, options, num_threads or num_cores())
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError as error:
            allowed = ", ".join(mode.value for mode in AutoresetMode)
            raise ConfigError(f"autoreset_mode must be one of {allowed}; got {autoreset_mode!r}.") from error
        self.task = self._adapter.task
        """The task with its simulations, to look at."""
        modes, frames_per_s = _RENDER_MODES, round(1 / self.task.step_s)
        self.metadata = {"render_modes": modes, "render_fps": frames_per_s, "autoreset_mode": self.autoreset_mode}
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.single_observation_space = self._adapter.observation_space
        self.single_action_space = self._adapter.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        has_limit = max_episode_steps not in (None, -1)
        if has_limit and not (is_whole(max_episode_steps) and max_episode_steps > 0):
            raise out_of_range("max_episode_steps", max_episode_steps, "a whole number of at least 1")
        self._max_steps = max_episode_steps if has_limit else np.inf
        self._rngs = [np_random()[0] for _ in range(num_envs)]
        self._has_ended, self._is_ready = np.zeros((2, num_envs), np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[F64Array, dict[str, Any]]:
        """Start new episodes in all environments, or in those of `options["reset_mask"]` [N].

        Args:
            seed: Environment i takes `seed + i` or `seed[i]`; None continues with the previous seeds.
            options: `reset_mask`, a Boolean array [N] with at least one True.
        """
        ids = np.flatnonzero(self._mask(options))
        self._start(ids, self._seeds(seed))
        self._has_ended[ids] = False
        self._is_ready[ids] = True
        return self.task.observe().copy(), self._info(ids)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        """Return the seed of each environment [N]; None continues with the previous seeds."""
        if seed is None:
            return [None] * self.num_envs
        if is_whole(seed):
            return [int(seed) + i for i in range(self.num_envs)]
        given: Any = seed
        seeds = list(given) if np.ndim(given) == 1 else [given]
        if not all(each is None or is_whole(each) for each in seeds):
            raise ConfigError(f"seed must be a whole number or a list of them, got {seed!r}.")
        if len(seeds) != self.num_envs:
            raise ConfigError(f"a list of seeds must have one for each of {self.num_envs} environments; got {seed!r}.")
        return [None if each is None else int(each) for each in seeds]

    def _mask(self, options: dict[str, Any] | None) -> BoolArray:
        mask = None if options is None else options.get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,):
            raise ConfigError(f"reset_mask must be a Boolean array of shape ({self.num_envs},); got {mask!r}.")
        if not mask.any():
            raise ConfigError("reset_mask must have at least one True.")
        return mask

    def _start(self, ids: IntArray, seeds: Sequence[int | None]) -> None:
        """Start episodes `ids`, each from its seed [N] or, if that is None, from its environment's generator."""
        chosen: list[int | np.random.Generator] = []
        for i in ids.tolist():
            seed = seeds[i]
            if seed is not None:
                self._rngs[i] = np_random(seed)[0]
            chosen.append(self._rngs[i] if seed is None else seed)
        self._adapter.reset(ids, chosen)

    def step(self, actions: NDArray[Any]) -> tuple[F64Array, F64Array, BoolArray, BoolArray, dict[str, Any]]:
        """Advance by 0.1 s; episodes that have ended are reset according to `autoreset_mode`."""
        mode = self.autoreset_mode
        if not self._is_ready.all() or (mode == AutoresetMode.DISABLED and self._has_ended.any()):
            raise ResetNeeded("an episode has not been started, or has ended: call reset() before step().")
        self._adapter.step(np.flatnonzero(~self._has_ended), actions)
        if self._has_ended.any():  # in mode NextStep
            self._start(np.flatnonzero(self._has_ended), [None] * self.num_envs)
        reward = self.task.reward.copy()
        terminated = self._adapter.ended
        truncated: BoolArray = self.task.time >= self._max_steps
        self._has_ended = terminated | truncated
        final: dict[str, Any] = {}
        if mode == AutoresetMode.SAME_STEP and self._has_ended.any():
            final = self._restart()
        info = self._info(np.arange(self.num_envs)) | final
        return self.task.observe().copy(), reward, terminated, truncated, info

    def _restart(self) -> dict[str, Any]:
        """Reset the episodes that have ended; return their final observations and infos."""
        ids = np.flatnonzero(self._has_ended)
        observation = self.task.observe().copy()
        final_obs = np.full(self.num_envs, None, dtype=object)  # None where an episode has not ended, as in Gymnasium
        for i in ids:
            final_obs[i] = observation[i]
        final = {"final_obs": final_obs, "final_info": self._info(ids)}
        final |= {f"_{name}": self._has_ended.copy() for name in final}
        self._start(ids, [None] * self.num_envs)
        self._has_ended[:] = False
        return final

    def _info(self, ids: IntArray) -> dict[str, Any]:
        """Return the infos of `ids` in Gymnasium's vector format: an array and a mask for each entry."""
        mask = np.zeros(self.num_envs, dtype=np.bool_)
        mask[ids] = True
        found: dict[str, Any] = {}
        for name, values in self._adapter.info().items():
            values[~mask] = 0
            found[name], found[f"_{name}"] = values, mask.copy()
        return found

    def render(self) -> tuple[Picture, ...] | None:  # type: ignore[override] - Gymnasium's type is wider
        """Return a picture [H, W, 3] of each environment."""
        return tuple(map(self._adapter.render, range(self.num_envs)))  # type: ignore[return-value] - never None here

    def close_extras(self, **kwargs: Any) -> None:
        """Free the renderer."""
        self._adapter.close()
