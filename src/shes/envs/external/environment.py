"""An external environment, one that Gymnasium or a user's function makes: an `EnvironmentMaker`."""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, redirect_stderr
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium
from gymnasium.envs.registration import EnvSpec

from shes.envs.tasks.options import TaskOptions
from shes.envs.tasks.task import SimulatorFactory
from shes.errors import ConfigError, MissingExtraError, ShesError, UnknownNameError
from shes.settings import flag
from shes.sim.cpu import CpuSimulator, log_physics_warnings

if TYPE_CHECKING:
    from shes.envs.external.reader import Locate
    from shes.envs.external.task import ExternalTask

__all__ = ["ExternalEnvironment"]

_ROBOTICS = ("AntMaze", "PointMaze", "Fetch", "HandManipulate", "HandReach", "AdroitHand", "FrankaKitchen")


@dataclass(frozen=True, kw_only=True)
class ExternalEnvironment:
    """Makes episodes of a Gymnasium environment. Nothing is imported or made before it is needed."""

    sets_goals: ClassVar[bool] = False
    has_own_physics: ClassVar[bool] = True
    options: ClassVar[type[TaskOptions]] = TaskOptions

    name: str
    source: str | EnvSpec | Callable[..., gymnasium.Env[Any, Any]]
    """Gymnasium id, registration, or a function that makes it. For the others see `shes.register_external`."""
    locate: Locate | None = None
    primitive_view: tuple[int, ...] | None = None
    is_scored_by_success: bool = False

    def __getstate__(self) -> dict[str, Any]:
        """Replace the id by its registration, which a worker process lacks if a script made it."""
        return {**vars(self), "source": self.spec or self.source}

    @property
    def spec(self) -> EnvSpec | None:
        """Registration in Gymnasium; None if a function makes the environment. An unknown id raises."""
        if not isinstance(self.source, str):
            return None if callable(self.source) else self.source
        if self.source not in gymnasium.registry:
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
        return spec and spec.max_episode_steps

    def make(
        self, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
    ) -> ExternalTask:
        """Return `num_episodes` episodes; see `EnvironmentMaker.make`.

        Raises:
            ConfigError: The device is not the CPU, the environment cannot be made or used, or an option that no preset
                sets is not the default.
        """
        from shes.envs.external.task import ExternalTask  # it imports this module

        if simulator is not CpuSimulator:
            raise ConfigError(f"{self.name} has its own physics, which runs on the CPU only. Set --device cpu.")
        for name, value in vars(options or TaskOptions()).items():
            if value != getattr(TaskOptions(), name) and name not in ("reset_noise", "evaluation"):
                raise ConfigError(f"{self.name} has no {name}. Omit {flag(name)}.")
        return ExternalTask(self, num_episodes)

    def make_one(self, render_mode: str | None = None) -> gymnasium.Env[Any, Any]:
        """Return a single environment without the time limit of its registration: the caller counts the steps."""
        spec, asked = self.spec, {} if render_mode is None else {"render_mode": render_mode}
        log_physics_warnings()  # MuJoCo's compiler warns too
        with self.explained(f"be made{f' with {asked}' if asked else ''}"):
            if spec is not None:
                _import_robotics(spec.id)
                return gymnasium.make(spec, max_episode_steps=-1, disable_env_checker=True, **asked)
            env: Any = self.source(**asked)  # type: ignore[operator] - without a spec it is a function
            if not isinstance(env, gymnasium.Env):
                raise ConfigError(f"its function must return a gymnasium.Env, got {env!r}.")
            return env

    @contextmanager
    def explained(self, action: str) -> Iterator[None]:
        """Turn any error into a ConfigError or MissingExtraError: "<name> cannot <action>: <error>"."""
        try:
            yield
        except Exception as error:
            kind = "" if isinstance(error, ShesError) else f"{type(error).__name__}: "
            told = f"{self.name} cannot {action}: {kind}{' '.join(str(error).split())}"
            if not isinstance(error, ImportError | gymnasium.error.DependencyNotInstalled):
                raise ConfigError(told) from error
            entry = getattr(gymnasium.registry.get(str(getattr(self.source, "id", self.source))), "entry_point", "")
            # gymnasium.envs.box2d.lunar_lander:LunarLander is installed by the extra gymnasium[box2d].
            room = str(entry).partition("gymnasium.envs.")[2].partition(".")[0].replace("_", "-")
            extra = f"gymnasium[{room}]" if room else "shes[robotics]" if "gymnasium_robotics" in told else None
            is_told = extra is None or "pip install" in told
            raise MissingExtraError(told if is_told else f"{told} (pip install '{extra}')") from error


def _import_robotics(env_id: str) -> None:
    """Import Gymnasium-Robotics if `env_id` is one of its ids; no other package is imported automatically."""
    if env_id.startswith(_ROBOTICS):
        with redirect_stderr(io.StringIO()):  # it prints deprecation notices
            importlib.import_module("gymnasium_robotics")
