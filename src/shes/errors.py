"""Exceptions of SHES.

A message says what is wrong, the value received, what is allowed (the nearest name first), and how to fix it.
"""

from __future__ import annotations

import difflib
import importlib
import sysconfig
import traceback
from collections.abc import Iterable
from types import ModuleType


class ShesError(Exception):
    """Base of all exceptions of SHES. `exit_code` is the exit code of the command line."""

    exit_code = 2


class ConfigError(ShesError, ValueError):
    """A setting has a value that is not allowed."""


class UnknownNameError(ShesError, LookupError):
    """A name (of an environment, a preset, a reward, ...) is not known."""

    def __init__(self, kind: str, name: str, known: Iterable[str], fix: str = "") -> None:
        """Create the message from the `kind` of name, the `name` received, the `known` names and the `fix` (a flag)."""
        super().__init__(kind, name, nearest_first(name, known), fix)  # by which the error is pickled

    def __str__(self) -> str:
        kind, name, names, fix = self.args
        close = difflib.get_close_matches(name, names, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        return f"unknown {kind} {name!r}.{hint} Known: {', '.join(names)}.{' ' + fix if fix else ''}"


class MissingExtraError(ShesError, ImportError):
    """An optional package is not installed. The message names the extra that installs it."""


class ShapeError(ShesError, ValueError):
    """An array has a wrong shape."""


class CheckpointError(ShesError):
    """A checkpoint is missing or damaged, or belongs to another configuration."""


class RunFolderError(ShesError):
    """A path is not a run folder, or already holds a run."""


class StorageError(ShesError, OSError):
    """A file cannot be written, for example because the disk is full. Existing files are unchanged."""


class PolicyError(ShesError):
    """A policy returned NaN or infinity."""

    exit_code = 1


class DivergenceError(ShesError):
    """Every episode of several generations diverged, for example because an environment returns NaN."""

    exit_code = 1


class WorkerError(ShesError, RuntimeError):
    """A worker raised an exception, or workers keep dying."""

    exit_code = 1


def import_extra(module: str, need: str, fix: str) -> ModuleType:
    """Import `module`; raise MissingExtraError, with what needs it and the fix, if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(f"{need} ({error}). {fix}") from error


def place_of(error: BaseException, *, outside: Iterable[str]) -> str:
    """Return file and line of the user's code in the traceback of `error`: `/home/me/robot.py:12`.

    It is the last frame whose module is in none of the packages `outside`, nor in one that is installed if another one
    is not; empty if there is none.
    """
    packages = set(outside)
    frames = [
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if str(frame.f_globals.get("__name__", "")).partition(".")[0] not in packages
    ]
    library = tuple(sysconfig.get_paths()[name] for name in ("stdlib", "purelib", "platlib"))
    own = [each for each in frames if not each[0].startswith((*library, "<"))]
    return "{}:{}".format(*(own or frames)[-1]) if frames else ""


def nearest_first(name: str, known: Iterable[str]) -> list[str]:
    """Return the `known` names: those most similar to `name` first, then the others in alphabetical order."""
    ordered = sorted(known)
    close = difflib.get_close_matches(name, ordered, n=3)
    return close + [other for other in ordered if other not in close]
