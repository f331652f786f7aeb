"""What the name of a Gymnasium environment stands for, and how one is made, in a worker process too."""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from shes.envs.tasks.options import TaskOptions
from shes.envs.tasks.task import SimulatorFactory
from shes.errors import ConfigError, MissingExtraError, ShesError, UnknownNameError
from shes.sim.cpu import CpuSimulator, log_physics_warnings

if TYPE_CHECKING:
    import gymnasium
    from gymnasium.envs.registration import EnvSpec

    from shes.envs.external.reader import Locate
    from shes.envs.external.task import ExternalTask

__all__ = ["ExternalEnvironment"]

_ROBOTICS = ("AntMaze", "PointMaze", "Fetch", "HandManipulate", "HandReach", "AdroitHand", "FrankaKitchen")


@dataclass(frozen=True, kw_only=True)
class ExternalEnvironment:
    """A Gymnasium environment and what SHES was told of it. Nothing is imported or made before it is needed."""

    name: str
    source: str | EnvSpec | Callable[..., gymnasium.Env[Any, Any]]
    """Its id, its entry in Gymnasium's registry, or a function that makes it (given `render_mode` for pictures)."""
    locate: Locate | None = None
    """Says where the robot is; if none, its joints do."""
    primitive_view: tuple[int, ...] | None = None
    """Indices in the flat observation that the primitive sees; if none, everything but `desired_goal`."""
    is_scored_by_success: bool = False
    """Whether the score is 1 for the `success` (or `is_success`) that `info` reports at the end, not the return."""
    sets_goals: bool = field(default=False, init=False)
    has_own_physics: bool = field(default=True, init=False)

    @property
    def options(self) -> type[TaskOptions]:
        """The class of its options: it has none of its own."""
        return TaskOptions

    def __getstate__(self) -> dict[str, Any]:
        """Return what worker processes are sent: they do not know what a script registered in Gymnasium."""
        return {**vars(self), "source": self.spec or self.source}

    @property
    def spec(self) -> EnvSpec | None:
        """Its entry in Gymnasium's registry, which must have one for an id; None if a function makes it."""
        import gymnasium

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
        """Time limit of its registration; None if it has none. A function is called to find out."""
        spec = self.spec
        if spec is None:
            env = self.make_one()
            spec = env.spec
            env.close()
        return None if spec is None else spec.max_episode_steps

    def make(
        self, num_episodes: int, options: TaskOptions | None = None, simulator: SimulatorFactory = CpuSimulator
    ) -> ExternalTask:
        """Return `num_episodes` episodes; a ConfigError refuses options of ours, but for those that presets set."""
        from shes.envs.external.task import ExternalTask

        if simulator is not CpuSimulator:
            raise ConfigError(f"{self.name} has physics of its own: it runs on the CPU alone. Set --device cpu.")
        for name, value in vars(TaskOptions()).items():
            if getattr(options or TaskOptions(), name) != value and name not in ("reset_noise", "evaluation"):
                raise ConfigError(f"{self.name} has no {name}. Leave --{name.replace('_', '-')} away.")
        return ExternalTask(self, num_episodes)

    def make_one(self, render_mode: str | None = None) -> gymnasium.Env[Any, Any]:
        """Return a single environment, without the time limit of its registration: whoever steps it counts."""
        import gymnasium

        spec, asked = self.spec, {} if render_mode is None else {"render_mode": render_mode}
        log_physics_warnings()  # of its compiler, too
        with self.explained(f"be made{f' with {asked}' if asked else ''}"):
            if spec is not None:
                _import_robotics(spec.id)
                return gymnasium.make(spec, max_episode_steps=-1, disable_env_checker=True, **asked)
            env: Any = self.source(**asked)  # type: ignore[operator] - without a spec it is a function
            if not isinstance(env, gymnasium.Env):
                raise ConfigError(f"its function must return a gymnasium.Env, got {env!r}.")
            return env

    @contextmanager
    def explained(self, what: str) -> Iterator[None]:
        """Make every error of its own code a ConfigError, or a MissingExtraError, of one line that names it."""
        import gymnasium

        try:
            yield
        except Exception as error:
            kind = "" if isinstance(error, ShesError) else f"{type(error).__name__}: "
            told = f"{self.name} cannot {what}: {kind}{' '.join(str(error).split())}"
            if not isinstance(error, ImportError | gymnasium.error.DependencyNotInstalled):
                raise ConfigError(told) from error
            entry = getattr(gymnasium.registry.get(str(getattr(self.source, "id", self.source))), "entry_point", "")
            room = str(entry).partition("gymnasium.envs.")[2].partition(".")[0].replace("_", "-")  # its extra's name
            extra = f"gymnasium[{room}]" if room else "shes[robotics]" if "gymnasium_robotics" in told else None
            is_told = extra is None or "pip install" in told
            raise MissingExtraError(told if is_told else f"{told} (pip install '{extra}')") from error


def _import_robotics(env_id: str) -> None:
    """Import Gymnasium-Robotics if `env_id` is one of its ids: nothing else is imported for the sake of a name."""
    if env_id.startswith(_ROBOTICS):
        with redirect_stderr(io.StringIO()):  # it tells everybody about environments of its past
            importlib.import_module("gymnasium_robotics")
