"""Describes an external environment, one that Gymnasium or a user's function makes, and makes it in any process."""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from shes.errors import ConfigError, MissingExtraError, ShesError, UnknownNameError
from shes.sim.cpu import log_physics_warnings

if TYPE_CHECKING:
    import gymnasium
    from gymnasium.envs.registration import EnvSpec

    from shes.envs.external.reader import Locate

__all__ = ["ExternalDescription"]

_ROBOTICS = ("AntMaze", "PointMaze", "Fetch", "HandManipulate", "HandReach", "AdroitHand", "FrankaKitchen")


@dataclass(frozen=True, kw_only=True)
class ExternalDescription:
    """A Gymnasium environment and how to read it. Nothing is imported or made before it is needed."""

    name: str
    source: str | EnvSpec | Callable[..., gymnasium.Env[Any, Any]]
    """Gymnasium id, registration, or a function that makes it (called with `render_mode` to draw pictures)."""
    locate: Locate | None = None
    """Returns the robot's pose; None reads it from the MuJoCo joints."""
    primitive_view: tuple[int, ...] | None = None
    """Indices in the flat observation that the primitive sees; None is all but `desired_goal`."""
    is_scored_by_success: bool = False
    """Whether the score is the `success` (or `is_success`) that `info` reports at the end, instead of the return."""

    def __getstate__(self) -> dict[str, Any]:
        """Replace the id by its registration, which a worker process lacks if a script made it."""
        return {**vars(self), "source": self.spec or self.source}

    @property
    def spec(self) -> EnvSpec | None:
        """Registration in Gymnasium; None if a function makes the environment.

        Raises:
            UnknownNameError: The id is not registered.
        """
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
        """Time limit of the registration, or None. An environment made by a function is made once to find out."""
        spec = self.spec
        if spec is None:
            env = self.make_one()
            spec = env.spec
            env.close()
        return None if spec is None else spec.max_episode_steps

    def make_one(self, render_mode: str | None = None) -> gymnasium.Env[Any, Any]:
        """Return a single environment without the time limit of its registration: the caller counts the steps."""
        import gymnasium

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
        """Turn any error into a one-line ConfigError or MissingExtraError: "<name> cannot <action>: <error>"."""
        import gymnasium

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
