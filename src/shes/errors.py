"""Every error that SHES raises on purpose, and the helper that names what does exist.

A message says what is wrong, the value received, what is allowed (nearest name first) and what fixes it.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = [
    "CheckpointError",
    "ConfigError",
    "MissingExtraError",
    "PolicyError",
    "RunFolderError",
    "ShapeError",
    "ShesError",
    "StorageError",
    "UnknownNameError",
    "WorkerError",
    "nearest_first",
]


class ShesError(Exception):
    """Base of every error raised on purpose. `exit_code` is what the command line returns for it."""

    exit_code = 2


class ConfigError(ShesError, ValueError):
    """A setting has a value that is not allowed."""


class UnknownNameError(ShesError, LookupError):
    """A name (environment, preset, reward, ...) is not in its registry."""

    def __init__(self, kind: str, name: str, known: Iterable[str], fix: str = "") -> None:
        """Name the `kind` of thing asked for, the `name` received, the `known` names and the `fix` (a flag)."""
        names = nearest_first(name, known)
        close = difflib.get_close_matches(name, names, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        super().__init__(f"unknown {kind} {name!r}.{hint} Known: {', '.join(names)}.{' ' + fix if fix else ''}")
        self.arguments = (kind, name, tuple(names), fix)

    def __reduce__(self) -> tuple[type[UnknownNameError], tuple[str, str, tuple[str, ...], str]]:
        """Pickle by the constructor's arguments: the error may travel from a worker process."""
        return (type(self), self.arguments)


class MissingExtraError(ShesError, ImportError):
    """Something needs an optional package that is not installed; the message names the extra that brings it."""


class ShapeError(ShesError, ValueError):
    """An array does not have the shape that the call needs."""


class CheckpointError(ShesError):
    """A checkpoint is missing, truncated, not a checkpoint, or belongs to another configuration."""


class RunFolderError(ShesError):
    """A path is not a run folder, or already holds a run."""


class StorageError(ShesError, OSError):
    """The disk is full, the folder is read-only, or a file could not be written; what was there is untouched."""


class PolicyError(ShesError):
    """A policy returned NaN or infinity."""

    exit_code = 1


class WorkerError(ShesError, RuntimeError):
    """A worker raised, or workers keep dying on the same work."""

    exit_code = 1


def nearest_first(name: str, known: Iterable[str]) -> list[str]:
    """Return the `known` names, those most like `name` first, the rest in alphabetical order."""
    ordered = sorted(known)
    close = difflib.get_close_matches(name, ordered, n=3)
    return close + [other for other in ordered if other not in close]
