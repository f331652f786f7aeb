"""`shes completion`: shells ask `shes --complete` for the words that may stand at the cursor."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Literal, get_args, get_origin

import tyro

from shes.cli.parsing import asked_config, offered_settings, parameters_of
from shes.cli.program import COMMANDS, find_command
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS
from shes.errors import ShesError
from shes.runs.shipped import shipped_names
from shes.settings import Setting, flag
from shes.training.presets import PRESETS

__all__ = ["completion", "print_completions"]

_BASH = "complete -o default -C 'shes --complete' shes"
_SCRIPTS = {
    "bash": _BASH,
    "zsh": f"autoload -Uz compinit bashcompinit && compinit && bashcompinit\n{_BASH}",
    "fish": "complete --command shes --arguments '(COMP_LINE=(commandline --cut-at-cursor) shes --complete)'",
    "tcsh": "complete shes 'p@*@`shes --complete`@'",
}
"""Script of each shell. It puts the line into COMP_LINE; tcsh, into COMMAND_LINE."""
_EVERYWHERE = ("--help", "--help-all", "--import", "--debug")
_RUNS = ("run", "runs", "first", "second", "primitive", "controller")
"""Parameters and settings whose values are runs."""


def completion(shell: Literal["bash", "zsh", "fish", "tcsh"]) -> int:
    """Print a script by which a shell completes commands, flags, environments, runs and other names.

    For bash: shes completion bash >> ~/.bashrc

    Args:
        shell: The shell.
    """
    print(_SCRIPTS[shell])
    return 0


def print_completions() -> None:
    """Print what may stand at the cursor of the line that a shell completes. If nothing, the shell completes files."""
    line = os.environ.get("COMP_LINE") or os.environ.get("COMMAND_LINE") or "shes "
    line = line[: int(os.environ.get("COMP_POINT", len(line)))]
    *before, typed = (f"{line}|").split()[1:]
    typed = typed.removesuffix("|")
    if typed.startswith("-") and "=" in typed:  # bash replaces what follows =
        name, _, typed = typed.partition("=")
        before.append(name)
    for word in _possible(before, typed):
        if word.startswith(typed):
            print(word)


def _possible(before: list[str], typed: str) -> Iterable[str]:
    """Return the words that may follow `before`; the last one begins with `typed`."""
    if not before:
        return [*COMMANDS, *_EVERYWHERE, "--version"]
    if before[0] not in COMMANDS:
        return []
    function = find_command(before[0])
    places: list[str] = []
    flags: dict[str, list[str]] = {name: [] for name in _EVERYWHERE}
    for name, each in parameters_of(function).items():
        kind, *notes = get_args(each.annotation) if get_origin(each.annotation) is Annotated else (each.annotation,)
        names = _names(name, get_args(kind) if get_origin(kind) is Literal else (), typed)
        if each.default is each.empty or tyro.conf.Positional in notes:
            places += names
        else:
            flags[flag(name)] = names
    for setting in _settings(function, before[1:]):
        flags[setting.flag] = _names(setting.name, setting.choices, typed)
        if setting.kind is bool and not setting.is_optional:
            flags[flag(f"no_{setting.name}")] = []
    return list(flags) if typed.startswith("-") else flags.get(before[-1]) or places


def _settings(function: Callable[..., int], words: list[str]) -> Iterable[Setting]:
    """Return the settings that are flags of a command."""
    try:
        return offered_settings(function, asked_config(words)).values()
    except ShesError:  # an unknown preset, for example
        return ()


def _names(name: str, choices: Iterable[str], typed: str) -> list[str]:
    """Return the values that parameter or setting `name` may have, as far as they have names."""
    if name == "env":
        return [*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS]
    if name not in _RUNS:
        return list(PRESETS if name == "preset" else choices)
    start = glob.escape(typed if "/" in typed else "runs/")
    found = (glob.iglob(f"{start}*/{end}config.json") for end in ("", "*/"))  # noqa: PTH207 - `typed` may be absolute
    return [*shipped_names(), *sorted(str(Path(file).parent) for files in found for file in files)]
