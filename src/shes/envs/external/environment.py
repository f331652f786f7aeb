"""Finds a Gymnasium environment, looks at it once, and makes episodes of it anywhere: in a worker process, too."""

from __future__ import annotations

import importlib
import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass, fields
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

import numpy as np

from shes.envs.external.description import ExternalDescription
from shes.envs.external.reader import ExternalReader
from shes.envs.external.selection import Places
from shes.envs.external.success import check_last_info
from shes.envs.tasks.options import TaskOptions
from shes.envs.tasks.task import SimulatorFactory
from shes.errors import ConfigError, MissingExtraError, ShesError, UnknownNameError
from shes.sim.cpu import CpuSimulator, log_physics_warnings
from shes.types import IntArray

if TYPE_CHECKING:
    import gymnasium
    from gymnasium.envs.registration import EnvSpec

    from shes.envs.external.task import ExternalTask

__all__ = ["ExternalEnvironment", "explained"]

_PACKAGES = {
    "gymnasium_robotics": (
        "robotics",
        ("AntMaze", "PointMaze", "Fetch", "HandManipulate", "HandReach", "AdroitHand", "FrankaKitchen"),
    ),
}
"""Packages that are imported for ids of theirs: the extra that brings each, how its ids begin. A run has no say."""
_DEFAULT_STEP_S = 0.1
_TELLS_NOTHING = ("reset_noise", "evaluation")  # presets set these; an external environment has them its own way


@dataclass(frozen=True, kw_only=True)
class ExternalEnvironment:
    """A described environment that was found. Worker processes are sent this: they need no registration."""

    description: ExternalDescription
    spec: EnvSpec
    reader: ExternalReader
    proprioception: IntArray
    """The robot's own dimensions of the flat observation."""
    primitive_view: IntArray
    """What of the flat observation the primitive sees."""
    render_modes: tuple[str, ...]
    step_s: float
    """Time of a step by the environment's own word (`render_fps`), in seconds; 0.1 if it says nothing."""

    @property
    def options(self) -> type[TaskOptions]:
        """The class of its options: it has none of its own."""
        return TaskOptions

    @property
    def sets_goals(self) -> bool:
        """Return False: no primitive learns in it alone."""
        return False

    @classmethod
    def find(cls, description: ExternalDescription) -> ExternalEnvironment:
        """Return the environment of `description`.

        It is made, reset and stepped once: spaces, keys and indices that do not fit show here.

        Raises:
            UnknownNameError: Gymnasium knows no such id.
            MissingExtraError: It comes with a package that is not installed.
            ConfigError: It cannot be made, its spaces cannot be used, or something is not where `description` says.
        """
        spec = _find_spec(description.id)
        env = _make(spec, description, None)
        try:
            with explained(description.id, "reset or step"):
                _check_spaces(env, description.id)
                _, info = env.reset(seed=0)
                places = _places(env.observation_space, info)
                found = cls._read(description, spec, env, places)
                action = found.reader.to_action(np.zeros((1, int(np.prod(env.action_space.shape or ())))))
                _, _, terminated, truncated, info = env.step(action[0])
                if terminated or truncated:
                    check_last_info(description, info)
        finally:
            env.close()
        return found

    @classmethod
    def _read(
        cls, description: ExternalDescription, spec: EnvSpec, env: gymnasium.Env[Any, Any], places: Places
    ) -> ExternalEnvironment:
        """Return what is to be known of `env`."""
        info_keys: dict[str, int] = {}
        position = places.columns("position", description.position, info_keys)
        heading = places.columns("heading", description.heading, info_keys)
        if len(position) != 2:
            raise ConfigError(f"position must be 2 values, x and y; {description.position} are {len(position)}.")
        if len(heading) not in (0, 1, 4):
            raise ConfigError(
                f"heading must be 1 value, the yaw, or 4, a quaternion w x y z; {description.heading} are "
                f"{len(heading)}."
            )
        view = places.columns("primitive_view", description.primitive_view, None)
        view = view if len(view) else np.arange(places.observation_size)
        own = places.columns("proprioception", description.proprioception, None)
        from gymnasium.spaces import Box

        assert isinstance(env.action_space, Box)
        reader = ExternalReader(
            observation_space=env.observation_space,
            action_space=env.action_space,
            observation_size=places.observation_size,
            info_keys=info_keys,
            position=position,
            heading=heading,
        )
        frames_per_s = env.metadata.get("render_fps")
        return cls(
            description=description,
            spec=spec,
            reader=reader,
            proprioception=own if len(own) else view,
            primitive_view=view,
            render_modes=tuple(env.metadata.get("render_modes") or ()),
            step_s=1 / frames_per_s if frames_per_s else _DEFAULT_STEP_S,
        )

    def make(
        self, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
    ) -> ExternalTask:
        """Return `num_episodes` episodes of it.

        Raises:
            ConfigError: An option of our own environments is set, or its physics is to be computed elsewhere.
        """
        from shes.envs.external.task import ExternalTask

        if simulator is not CpuSimulator:
            raise ConfigError(
                f"{self.description.id} is Gymnasium's, with physics of its own: it runs on the CPU alone. "
                "Set --device cpu."
            )
        ours = TaskOptions()
        for each in fields(TaskOptions):
            value = getattr(ours if options is None else options, each.name)
            if each.name not in _TELLS_NOTHING and value != getattr(ours, each.name):
                raise ConfigError(
                    f"{self.description.id} has no {each.name}, got {value!r}. Leave "
                    f"--{each.name.replace('_', '-')} away; what it has itself is set by kwargs in its description."
                )
        return ExternalTask(self, num_episodes)

    def make_one(self, render_mode: str | None = None) -> gymnasium.Env[Any, Any]:
        """Return a single environment, without a time limit: whoever steps it counts.

        Raises:
            ConfigError: It cannot be made.
        """
        _import_package(self.spec.id)
        return _make(self.spec, self.description, render_mode)


def _import_package(env_id: str) -> None:
    """Import the package that `env_id` comes with, if it is one of `_PACKAGES`.

    Raises:
        MissingExtraError: It is not installed.
    """
    for package, (extra, beginnings) in _PACKAGES.items():
        if env_id.startswith(beginnings):
            try:
                with redirect_stderr(io.StringIO()):  # it tells everybody about environments of its past
                    importlib.import_module(package)
            except ModuleNotFoundError as error:
                raise MissingExtraError(
                    f"{env_id} needs {package}, which is not installed ({error}): pip install 'shes[{extra}]'."
                ) from error


def _find_spec(env_id: str) -> EnvSpec:
    """Return what Gymnasium knows by this id."""
    import gymnasium

    if env_id not in gymnasium.registry:
        _import_package(env_id)
    if env_id not in gymnasium.registry:
        close = get_close_matches(env_id, gymnasium.registry, n=5)
        fix = "Is the package that registers it imported? In your script, or by --import MODULE."
        known = close or [f"{len(gymnasium.registry)}, none of them like it"]
        raise UnknownNameError("Gymnasium environment", env_id, known, fix)
    return gymnasium.spec(env_id)


def _make(spec: EnvSpec, description: ExternalDescription, render_mode: str | None) -> gymnasium.Env[Any, Any]:
    import gymnasium

    # Not even its own time limit: episodes last as long as --horizon says, as those of every other environment.
    settings: dict[str, Any] = {**description.kwargs, "max_episode_steps": -1, "disable_env_checker": True}
    if render_mode is not None:
        settings["render_mode"] = render_mode
    log_physics_warnings()  # of its compiler, too
    with explained(spec.id, "be made"):
        return gymnasium.make(spec, **settings)


@contextmanager
def explained(env_id: str, what: str) -> Iterator[None]:
    """Make every error of an environment one of ours, of one line: its own code may raise anything.

    Raises:
        ConfigError: There was one.
    """
    try:
        yield
    except ConfigError as error:
        if str(error).startswith(env_id):
            raise
        raise ConfigError(f"{env_id}: {error}") from error
    except ShesError:
        raise
    except Exception as error:
        told = " ".join(str(error).split())
        raise ConfigError(f"{env_id} cannot {what}: {type(error).__name__}: {told}") from error


def _check_spaces(env: gymnasium.Env[Any, Any], env_id: str) -> None:
    from gymnasium.spaces import Box

    action = env.action_space
    if not isinstance(action, Box) or not action.is_bounded() or not np.issubdtype(action.dtype, np.floating):
        raise ConfigError(
            f"{env_id}: the action space must be a Box of floats with finite bounds, and is {action}. Wrap the "
            "environment, and register it under a name of your own."
        )
    if not env.observation_space.is_np_flattenable:
        raise ConfigError(f"{env_id}: the observation space must have a fixed size, and is {env.observation_space}.")


def _places(space: gymnasium.Space[Any], info: dict[str, Any]) -> Places:
    """Return where everything is in a row."""
    from gymnasium.spaces import Dict, flatdim

    keys: dict[str, tuple[int, int]] = {}
    if isinstance(space, Dict):
        start = 0
        for key, part in space.spaces.items():
            keys[str(key)] = (start, start + flatdim(part))
            start += flatdim(part)
    return Places(flatdim(space), keys, info)
