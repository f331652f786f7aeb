"""The program: flags that every command takes, the command itself, and what its errors become."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence

import shes
from shes.cli.output import print_error, print_interrupted
from shes.errors import ConfigError, ShesError, UnknownNameError

__all__ = ["COMMANDS", "main"]

INTERRUPTED = 130
"""Exit code after Ctrl-C."""
BROKEN_PIPE = 141
"""Exit code when nobody reads the output, as that of programs which SIGPIPE ends."""

COMMANDS: dict[str, str] = {
    "envs": "list the environments",
    "list": "list the runs below runs/, and the shipped agents",
    "info": "show what a run is and how far it came",
    "train": "train on an environment",
    "resume": "go on with a run",
    "evaluate": "evaluate a checkpoint of a run on fresh episodes",
    "plot": "draw the learning curves of runs",
    "render": "make a video of a run's policy",
    "watch": "look at a run's policy in a window",
    "experiment": "run a study of many runs, with tables and figures",
    "bench": "measure how fast this machine is",
    "completion": "print a script that completes commands and flags by the tab key",
}
"""What the commands do: functions of these names, each in a module of `commands`. `list` is `list_`."""

_OVERVIEW = """\
usage: shes COMMAND ...

Scalable hierarchical evolution strategies: train, look, measure.

commands:
{commands}

everywhere:
  -h, --help       Show the help of a command.
  --import MODULE  Import a module first: what it registers (environments, ...) is known then. Repeatable.
  --debug          Show the traceback of an error.
  --version        Show the version.

First steps: shes train point-gather --generations 60, then shes plot RUN, then shes train ant-gather."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code: 0, 2 for what the user can mend, 1 for the rest, 130 after Ctrl-C."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    is_debug = "--debug" in words
    try:
        modules, words = _take_imports([word for word in words if word != "--debug"])
        for name in modules:
            _import(name)
        status = _dispatch(words)
        sys.stdout.flush()  # a broken pipe or a full disk shows here, not at Python's end
    except KeyboardInterrupt:
        print_interrupted()
        return INTERRUPTED
    except BrokenPipeError:  # whoever read the output has gone, as head does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # Python flushes at its end
        return BROKEN_PIPE
    except (ShesError, OSError) as error:  # OSError: standard output is a full disk, a path cannot be read, ...
        if is_debug:
            raise
        print_error(error)
        return error.exit_code if isinstance(error, ShesError) else ConfigError.exit_code
    return status


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help", "help"):
        width = max(map(len, COMMANDS))
        print(_OVERVIEW.format(commands="\n".join(f"  {name:<{width}}  {text}" for name, text in COMMANDS.items())))
        return 0
    if words[0] == "--version":
        print(f"shes {shes.__version__}")
        return 0
    name, *rest = words
    if name.startswith("-"):
        raise ConfigError(f"unknown flag {name} before the command. `shes --help` explains those that there are.")
    if name not in COMMANDS:
        raise UnknownNameError("command", name, COMMANDS, "`shes --help` explains them.")
    module = shes.import_module(f"shes.cli.commands.{name}")
    from shes.cli.parsing import call  # tyro takes its time: not for the overview

    return call(getattr(module, f"{name}_" if name == "list" else name), rest)


def _take_imports(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the modules that `--import MODULE` names, wherever it stands, and the other words.

    Raises:
        ConfigError: The flag has no value.
    """
    modules: list[str] = []
    rest: list[str] = []
    queue = list(words)
    while queue:
        name, equals, module = queue.pop(0).partition("=")
        if name != "--import":
            rest.append(name + equals + module)
            continue
        if not equals:
            module = queue.pop(0) if queue and not queue[0].startswith("-") else ""
        if not module:
            raise ConfigError("--import needs a value: --import MODULE. `shes --help` explains it.")
        modules.append(module)
    return modules, rest


def _import(name: str) -> None:
    """Import a module of the user.

    Raises:
        ConfigError: It is not found, or fails.
    """
    try:
        importlib.import_module(name)
    except (Exception, SystemExit) as error:
        parents = [".".join(name.split(".")[:depth]) for depth in range(1, name.count(".") + 2)]
        if isinstance(error, ModuleNotFoundError) and error.name in parents:
            file = f" Give a module's name, not a file: --import {name[:-3]}." if name.endswith(".py") else ""
            raise ConfigError(
                f"--import {name}: there is no module {error.name!r}. Is it installed or on PYTHONPATH?{file} "
                "For a module in this folder: PYTHONPATH=. shes ..."
            ) from error
        raise ConfigError(
            f"--import {name}: the module failed: {type(error).__name__}: {str(error).rstrip('.')}. "
            "Mend it; --debug shows where it failed."
        ) from error
