"""The program: flags that every command takes, the choice of the command, and exit codes."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable, Sequence

import shes
from shes.cli.output import print_error
from shes.cli.streams import INTERRUPTED, with_streams
from shes.errors import ConfigError, ShesError, UnknownNameError

__all__ = ["COMMANDS", "find_command", "main"]

COMMANDS: dict[str, tuple[str, str]] = {
    "envs": ("envs", "list the environments"),
    "list": ("runs", "list the runs below runs/, and the shipped agents"),
    "info": ("runs", "show the settings and the state of a run"),
    "train": ("training", "train on an environment"),
    "resume": ("training", "continue a run"),
    "evaluate": ("training", "evaluate a checkpoint of a run on fresh episodes"),
    "plot": ("viewing", "plot the learning curves of runs"),
    "report": ("report", "make one HTML page of runs: curves, results, maps, videos, settings"),
    "compare": ("comparison", "compare two runs, or groups of runs, with an interval and a p value"),
    "render": ("viewing", "make a video of a run's policy"),
    "watch": ("viewing", "watch a run's policy in a window"),
    "export": ("viewing", "write a run's policy to a file that needs no SHES"),
    "experiment": ("experiment", "run a study of many runs, with tables and figures"),
    "bench": ("training", "measure the speed of this machine"),
    "completion": ("completion", "print a script that completes commands and flags with the Tab key"),
}
"""Module below `shes.cli.commands` and one line of help of every command: a function of its name; `list` is `list_`."""

_OVERVIEW = """\
usage: shes COMMAND ...

Scalable hierarchical evolution strategies: train, evaluate, render, measure.

commands:
{commands}

everywhere:
  -h, --help       Show the help of a command.
  --import MODULE  Import a module that registers environments or other classes. Repeatable.
  --debug          Show the traceback of an error.
  --version        Show the version.

First steps: shes train point-gather --generations 60, then shes plot RUN, then shes train ant-gather."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return its exit code.

    0: success; 1: the run failed; 2: the command line, a file or a package has to be corrected; 130: Ctrl-C; 141: the
    reader of the output has gone, as head does.
    """
    return with_streams(lambda: _run(list(sys.argv[1:] if arguments is None else arguments)))


def _run(given: list[str]) -> int:
    """Run a command and print its error, if any; return the exit code."""
    if given[:1] == ["--complete"]:  # asked by a shell
        shes.import_module("shes.cli.commands.completion").print_completions()
        return 0
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--debug", action="store_true")
    parser.add_argument("--import", action="append", nargs="?", default=[], dest="modules")
    asked, words = parser.parse_known_args(given)
    try:
        for name in asked.modules:
            _import(name)
        code = _dispatch(words)
        sys.stdout.flush()  # a full disk shows here, not when Python exits
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        raise
    except MemoryError as error:
        if asked.debug:
            raise
        found = str(error) or "no more is free"
        print_error(f"not enough memory ({found}). Lower what the command asks for; see its --help.")
        return ConfigError.exit_code
    except (ShesError, OSError) as error:  # OSError: standard output is on a full disk, a path cannot be read, ...
        if asked.debug:
            raise
        print_error(str(error))
        return error.exit_code if isinstance(error, ShesError) else ConfigError.exit_code
    return code


def _dispatch(words: Sequence[str]) -> int:
    """Run the command that `words` begin with."""
    name, *rest = words or ["--help"]
    if name in ("-h", "--help", "--help-all", "help"):
        width = max(map(len, COMMANDS))
        lines = (f"  {command:<{width}}  {text}" for command, (_, text) in COMMANDS.items())
        print(_OVERVIEW.format(commands="\n".join(lines)))
        return 0
    if name == "--version":
        print(f"shes {shes.__version__}")
        return 0
    if name.startswith("-"):
        raise ConfigError(f"unknown flag {name} before the command. See `shes --help`.")
    command = find_command(name)
    return shes.import_module("shes.cli.parsing").call(command, rest)  # tyro is slow to import


def find_command(name: str) -> Callable[..., int]:
    """Return the function of command `name`.

    Raises:
        UnknownNameError: There is no such command.
    """
    if name not in COMMANDS:
        raise UnknownNameError("command", name, COMMANDS, "See `shes --help`.")
    module = shes.import_module(f"shes.cli.commands.{COMMANDS[name][0]}")
    return getattr(module, "list_" if name == "list" else name)


def _import(name: str | None) -> None:
    """Import a module of the user.

    Raises:
        ConfigError: It has no name, is not found, or fails.
    """
    if not name:
        raise ConfigError("--import needs a value: --import MODULE. See `shes --help`.")
    try:
        importlib.import_module(name)
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and error.name and f"{name}.".startswith(f"{error.name}."):
            file = f" Give a module's name, not a file: --import {name[:-3]}." if name.endswith(".py") else ""
            raise ConfigError(
                f"--import {name}: there is no module {error.name!r}. Is it installed or on PYTHONPATH?{file} "
                "For a module in this folder: PYTHONPATH=. shes ..."
            ) from error
        raise ConfigError(
            f"--import {name}: the module failed: {type(error).__name__}: {str(error).rstrip('.')}. "
            "Correct it; --debug shows where it failed."
        ) from error
