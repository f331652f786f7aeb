"""Completion for bash: the words that can follow an unfinished command line."""

from __future__ import annotations

import glob
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import tyro

from shes.cli.parsing import ExecutionFlags, asked_config
from shes.cli.program import COMMANDS, find_command
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS
from shes.errors import ShesError
from shes.runs.shipped import shipped_names
from shes.settings import Setting, flag
from shes.training.presets import PRESETS
from shes.training.train import resumable_settings

__all__ = ["completions"]

_EVERYWHERE = ("--help", "--import", "--debug")
_RUNS = ("run", "runs", "first", "second", "--primitive", "--controller")
"""Parameters and flags whose values are runs."""


def completions(words: Sequence[str]) -> list[str]:
    """Return what may replace the last of `words`, which follow `shes`. If nothing, bash completes files."""
    typed = "" if words[-1] == "=" else words[-1]
    before = [word for word in words[:-1] if word != "="]  # bash separates --flag=value
    if not before:
        return _beginning([*COMMANDS, *_EVERYWHERE, "--version"], typed)
    if before[0] not in COMMANDS:
        return []
    function = find_command(before[0])
    hints = _parameters(function)
    flags = {flag(name): _choices(kind) for name, kind in hints.items() if not _is_positional(kind)}
    flags |= {text: names for each in _settings(function, before[1:]) for text, names in _of_setting(each).items()}
    if get_type_hints(function).get("settings", ExecutionFlags) is not ExecutionFlags:
        flags["--help-all"] = ()
    if typed.startswith("-"):
        return _beginning([*flags, *_EVERYWHERE], typed)
    if before[-1] in _RUNS:
        return _beginning([*shipped_names(), *_runs(typed)], typed)
    if before[-1].startswith("-") and flags.get(before[-1]):
        return _beginning(flags[before[-1]], typed)
    names = [*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS] if "env" in hints else []
    if not hints.keys().isdisjoint(_RUNS):
        names += [*shipped_names(), *_runs(typed)]
    names += [choice for kind in hints.values() if _is_positional(kind) for choice in _choices(kind)]
    return _beginning(names, typed)


def _parameters(function: Callable[..., int]) -> dict[str, Any]:
    """Return the types of a command's own parameters by name, and of those of the function behind `**options`."""
    hints = get_type_hints(function, include_extras=True)
    if "options" in hints:
        _, behind = get_args(hints.pop("options"))
        hints = {**get_type_hints(behind, include_extras=True), **hints}
    return {name: kind for name, kind in hints.items() if name not in ("return", "settings")}


def _is_positional(kind: Any) -> bool:
    """Return whether a parameter of type `kind` has no flag."""
    return tyro.conf.Positional in getattr(kind, "__metadata__", ())


def _beginning(words: Sequence[str], typed: str) -> list[str]:
    """Return those of `words` that begin with `typed`."""
    return [word for word in words if word.startswith(typed)]


def _settings(function: Callable[..., int], words: Sequence[str]) -> list[Setting]:
    """Return the settings that are flags of a command."""
    kind = get_type_hints(function).get("settings")
    if kind is None:
        return []
    if kind is ExecutionFlags:
        return list(resumable_settings().values())
    try:
        config = asked_config(function, words)
    except ShesError:  # an unknown preset, for example
        return []
    return [config.setting(name) for name in config.settings if name != "env"]


def _of_setting(setting: Setting) -> dict[str, tuple[str, ...]]:
    """Return the flags of a setting, each with the names that may follow it."""
    names = tuple(PRESETS) if setting.name == "preset" else setting.choices
    found = {setting.flag: names}
    if setting.kind is bool and not setting.is_optional:
        found[flag(f"no_{setting.name}")] = ()
    return found


def _choices(kind: Any) -> tuple[str, ...]:
    """Return the names that a parameter of type `kind` may have."""
    if get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    return get_args(kind) if get_origin(kind) is Literal else ()


def _runs(typed: str) -> list[str]:
    """Return the runs whose path begins with `typed`, or those below `runs/`."""
    start = glob.escape(typed if "/" in typed else "runs/")
    found = (glob.iglob(f"{start}*/{end}config.json") for end in ("", "*/"))  # noqa: PTH207 - `typed` may be absolute
    return sorted(str(Path(file).parent) for files in found for file in files)
