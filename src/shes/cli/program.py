"""The program: flags that every command takes, and the choice of the command."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import shes
from shes.cli.streams import exit_code
from shes.errors import ConfigError, UnknownNameError

__all__ = ["COMMANDS", "find_command", "import_registering", "main", "split_everywhere"]

COMMANDS: dict[str, tuple[str, str]] = {
    "envs": ("envs.catalogue.list_environments", "list the environments"),
    "list": ("runs.listings.list_runs", "list the runs below runs/, and the shipped agents"),
    "info": ("runs.listings.describe_run", "show the settings and the state of a run"),
    "train": ("cli.commands.train", "train on an environment"),
    "resume": ("cli.commands.resume", "continue a run"),
    "evaluate": ("training.evaluate.evaluate", "evaluate a checkpoint of a run on fresh episodes"),
    "plot": ("viewing.plot.plot", "plot the learning curves of runs"),
    "report": ("viewing.report.report.report", "make one HTML page of runs: curves, results, maps, videos, settings"),
    "compare": ("studies.run_comparison.compare_runs", "compare two runs, or groups of runs: interval and p value"),
    "render": ("viewing.render.render", "make a video of a run's policy"),
    "watch": ("viewing.watch.watch", "watch a run's policy in a window"),
    "export": ("training.export.export", "write a run's policy to a file that needs no SHES"),
    "experiment": ("studies.command.experiment", "run a study of many runs, with tables and figures"),
    "bench": ("bench.bench.bench", "measure the speed of this machine"),
    "completion": ("cli.completion.completion", "print a script that completes commands and flags with the Tab key"),
}
"""Function of every command, below `shes`, and its line in the overview."""

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
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] == ["--complete"]:  # asked by a shell
        return exit_code(lambda: shes.import_module("shes.cli.completion").print_completions())
    asked, words = split_everywhere(given)
    return exit_code(lambda: _run(asked.modules, words or ["--help"]), is_debug=asked.debug)


def split_everywhere(words: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """Return `modules` to import and `debug`, which may stand anywhere in `words`, and the other words."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--debug", action="store_true")
    parser.add_argument("--import", action="append", nargs="?", default=[], dest="modules")
    return parser.parse_known_args(words)


def _run(modules: Iterable[str | None], words: Sequence[str]) -> int:
    """Import `modules` and run the command that `words` begin with."""
    for module in modules:
        import_registering(module)
    name, *rest = words
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
    function = find_command(name)
    return shes.import_module("shes.cli.parsing").call(name, function, rest)  # tyro is slow to import


def find_command(name: str) -> Callable[..., Any]:
    """Return the function of command `name`; raise UnknownNameError if there is none."""
    if name not in COMMANDS:
        raise UnknownNameError("command", name, COMMANDS, "See `shes --help`.")
    module, _, function = COMMANDS[name][0].rpartition(".")
    return getattr(shes.import_module(f"shes.{module}"), function)


def import_registering(name: str | None) -> None:
    """Import a module of the user; raise ConfigError if it has no name, is not found, or fails."""
    if not name:
        raise ConfigError("--import needs a value: --import MODULE. See `shes --help`.")
    try:
        importlib.import_module(name)
    except (Exception, SystemExit) as error:
        problem = (
            f"the module failed: {type(error).__name__}: {str(error).rstrip('.')}. "
            "Correct it; --debug shows where it failed."
        )
        if isinstance(error, ModuleNotFoundError) and error.name and f"{name}.".startswith(f"{error.name}."):
            file = f" Give a module's name, not a file: --import {name[:-3]}." if name.endswith(".py") else ""
            problem = (
                f"there is no module {error.name!r}. Is it installed or on PYTHONPATH?{file} "
                "For a module in this folder: PYTHONPATH=. shes ..."
            )
        raise ConfigError(f"--import {name}: {problem}") from error
