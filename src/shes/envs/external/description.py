"""What has to be said of a Gymnasium environment to train on it: plain data, kept in the run folder."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any

from shes.envs.external.selection import check_selection
from shes.errors import ConfigError, UnknownNameError

__all__ = ["FILE_KINDS", "SCORES", "ExternalDescription", "is_description_file", "read_description"]

SCORES = ("return", "success")
FILE_KINDS = (".toml", ".json")
"""Kinds of files that describe an environment."""

_SELECTIONS = ("position", "heading", "proprioception", "primitive_view")
_OURS = ("additional_wrappers", "disable_env_checker", "id", "max_episode_steps", "render_mode", "vector_entry_point")
_MAKERS = ("GymV21Environment", "GymV26Environment")  # they import and make what their arguments name


@dataclass(frozen=True, kw_only=True)
class ExternalDescription:
    """Where things are in a Gymnasium environment. `shes.envs.external.selection` says how a place is written."""

    id: str
    """Its id in Gymnasium, e.g. `AntMaze_UMaze-v5`."""
    position: tuple[int | str, ...]
    """Where x and y of the robot are, in metres."""
    heading: tuple[int | str, ...] = ()
    """Where its yaw in radians is, or its quaternion w x y z; none is 0."""
    proprioception: tuple[int | str, ...] = ()
    """The robot's own part of the observation, which a primitive sees with `--primitive-view proprioception`, and one
    that `--primitive` brings if it was trained so; that of `primitive_view` if none."""
    primitive_view: tuple[int | str, ...] = ()
    """What of the observation the primitive sees; all of it if none."""
    score: str = "return"
    """Test score of an episode: its return, or 1 for the `success` (or `is_success`) that `info` reports at its end.

    An environment may report it at every step or only where it ends an episode itself; an episode that `--horizon` cuts
    off without a word of it has not succeeded.
    """
    kwargs: dict[str, Any] = field(default_factory=dict)
    """Arguments of `gymnasium.make`, as JSON holds them."""

    def __post_init__(self) -> None:
        """Check everything that shows without the environment.

        Raises:
            ConfigError: A value is not allowed.
            UnknownNameError: `score` is not known.
        """
        if not isinstance(self.id, str) or not self.id or ":" in self.id or self.id.startswith(_MAKERS):
            raise ConfigError(
                f"id must be that of an environment in Gymnasium, without a module before it, got {self.id!r}. Import "
                "the package that registers it yourself: in your script, or by --import MODULE."
            )
        for name in _SELECTIONS:
            object.__setattr__(self, name, check_selection(name, getattr(self, name)))
        if not self.position:
            raise ConfigError('position must say where x and y of the robot are: [0, 1] or "achieved_goal".')
        if self.score not in SCORES:
            raise UnknownNameError("score", str(self.score), SCORES)
        object.__setattr__(self, "kwargs", self._plain_kwargs())

    def _plain_kwargs(self) -> dict[str, Any]:
        if not isinstance(self.kwargs, Mapping):
            raise ConfigError(f"kwargs must be arguments by name, got {self.kwargs!r}.")
        for name in self.kwargs:
            if name in _OURS:
                raise ConfigError(f"kwargs must not have {name!r}: SHES sets it. The time limit is --horizon.")
        try:
            return json.loads(json.dumps(dict(self.kwargs), allow_nan=False))
        except (TypeError, ValueError) as error:
            raise ConfigError(
                f"kwargs must be what JSON holds, because the run folder keeps them: {error}. Register an environment "
                "of your own that fills in the rest."
            ) from error

    def to_dict(self) -> dict[str, Any]:
        """Return the description as JSON holds it."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ExternalDescription:
        """Return the description that `to_dict` or a file holds.

        Raises:
            ConfigError: A key is unknown or missing, or a value is not allowed.
            UnknownNameError: `score` is not known.
        """
        if not isinstance(values, Mapping):
            raise ConfigError(f"the description of an environment must be values by name, got {values!r}.")
        known = [each.name for each in fields(cls)]
        for name in values:
            if name not in known:
                raise ConfigError(f"a description of an environment has no {name!r}. It has {', '.join(known)}.")
        for each in fields(cls):
            if each.default is MISSING and each.default_factory is MISSING and each.name not in values:
                raise ConfigError(f"the description of an environment lacks {each.name!r}.")
        return cls(**values)


def is_description_file(env: str) -> bool:
    """Tell whether `env` is the path of a description, not a name."""
    return isinstance(env, str) and env.endswith(FILE_KINDS)


def read_description(path: Path) -> ExternalDescription:
    """Return the description in a file, whose stem is the environment's name.

    Raises:
        ConfigError: It cannot be read, or holds no description, or its stem is no name, or that of another environment.
        UnknownNameError: A name in it is not known.
    """
    from shes.envs.registry import check_description_name

    try:
        text = path.read_text(encoding="utf-8")
        values = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}, which is to describe an environment, cannot be read: {error}.") from error
    try:
        description = ExternalDescription.from_dict(values)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    except UnknownNameError as error:
        kind, name, known, fix = error.arguments
        raise UnknownNameError(f"{kind} in {path}", name, known, fix) from error
    try:
        check_description_name(path.stem, description)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error} The file's stem is the name: rename the file.") from error
    return description
