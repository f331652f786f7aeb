"""The program: the commands, their overview, and the call of one of them."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import re
import shutil
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import shes
from shes.errors import ConfigError, ShesError, UnknownNameError
from shes.machine import free_memory

COMMANDS: dict[str, tuple[str, str]] = {
    "envs": ("envs.named_environments.list_environments", "list the environments"),
    "list": ("runs.listings.list_runs", "list the runs below runs/, and the shipped agents"),
    "info": ("runs.listings.describe_run", "show the settings and the state of a run"),
    "train": ("cli.commands.train", "train on an environment"),
    "resume": ("cli.commands.resume", "continue a run"),
    "evaluate": ("runs.evaluate.evaluate", "evaluate a checkpoint of a run on fresh episodes"),
    "plot": ("viewing.plot.plot", "plot the learning curves of runs"),
    "report": ("viewing.report.report", "make one HTML page of runs: curves, results, maps, videos, settings"),
    "compare": ("runs.comparison.compare", "compare two runs, or groups of runs: interval and p value"),
    "render": ("viewing.render.render", "make a video of a run's policy"),
    "watch": ("viewing.playback.watch", "watch a run's policy in a window"),
    "export": ("runs.export.export", "write a run's policy to a file that needs no SHES"),
    "demo": ("cli.demo.demo", "train a robot that collects food, in four minutes, and draw it"),
    "bench": ("cli.bench.bench", "measure the speed of this machine"),
    "completion": ("cli.parsing.completion", "print a script that completes commands and flags with the Tab key"),
}
"""Function of every command, below `shes`, and its line in the overview."""
INTERRUPTED, BROKEN_PIPE = 130, 141
"""Exit codes after Ctrl-C or SIGTERM, and if the reader of the output has gone."""
_LEAST_COLUMNS = 20  # tables and help need some width
_END_S = 60.0  # which threads, child processes and exit handlers of a user's module have to end after the command

_OVERVIEW = """\
usage: shes COMMAND ...

Scalable hierarchical evolution strategies: train, evaluate, render, measure.

commands:
{commands}

everywhere:
  -h, --help       Show the help of a command.
  --help-all       Show it with all settings of a run.
  --import MODULE  Import a module that registers environments or other classes. Repeatable.
  --debug          Show the traceback of an error.
  --version        Show the version.

First steps: shes train point-gather --generations 60, then shes plot RUN, then shes train ant-gather."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return its exit code.

    0: success; 1: the run failed; 2: the command line, a file or a package has to be corrected; 130: Ctrl-C; 141: the
    reader of the output has closed it, as `head` does.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)  # these flags may stand anywhere
    parser.add_argument("--debug", action="store_true")
    parser.add_argument("--import", action="append", nargs="?", default=[], dest="modules")
    asked, words = parser.parse_known_args(sys.argv[1:] if arguments is None else arguments)

    def run() -> int:
        for module in asked.modules:
            _import_registering(module)
        return _run(words or ["--help"])

    code = 1
    try:
        return (code := exit_code(run, is_debug=asked.debug))
    finally:
        if arguments is None:  # the process is this command's alone
            ending = threading.Timer(_END_S, _end, (code,))
            ending.daemon = True
            with suppress(RuntimeError):  # no memory for a thread
                ending.start()


def _end(code: int) -> None:
    with suppress(OSError, ValueError):  # a closed stream
        print(f"Ended, although a thread or exit handler has not, {_END_S:.0f} s after the command.", file=sys.stderr)
    os._exit(code)


def _run(words: Sequence[str]) -> int:
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
    return importlib.import_module("shes.cli.parsing").call(name, function, rest)  # tyro is slow to import


def find_command(name: str) -> Callable[..., Any]:
    """Return the function of command `name`; raise UnknownNameError if there is none."""
    if name not in COMMANDS:
        raise UnknownNameError("command", name, COMMANDS, "See `shes --help`.")
    module, _, function = COMMANDS[name][0].rpartition(".")
    return getattr(importlib.import_module(f"shes.{module}"), function)


def _import_registering(name: str | None) -> None:
    """Import a module of the user; raise ConfigError if it has no name, is not found, or fails."""
    if not name:
        raise ConfigError("--import needs a value: --import MODULE. See `shes --help`.")
    try:
        importlib.import_module(name)
    except (Exception, SystemExit) as error:
        fault = f"{type(error).__name__}: {str(error).rstrip('.')}"
        problem = f"the module failed: {fault}. Correct it; --debug shows where it failed."
        if isinstance(error, ModuleNotFoundError) and error.name and f"{name}.".startswith(f"{error.name}."):
            file = f" Give a module's name, not a file: --import {name[:-3]}." if name.endswith(".py") else ""
            problem = (
                f"there is no module {error.name!r}. Is it installed or on PYTHONPATH?{file} "
                "For a module in this folder: PYTHONPATH=. shes ..."
            )
        raise ConfigError(f"--import {name}: {problem}") from error


def exit_code(work: Callable[[], int], *, is_debug: bool = False) -> int:
    """Return the exit code of `work`, or of the error that ends it, which is printed.

    The streams may be closed, read by nobody, or of an encoding without ± and ×. With `is_debug`, errors are raised.
    """
    _mend_streams()
    code = 0
    try:
        try:
            code = work()
            sys.stdout.flush()  # a full disk shows here, not when Python exits
        except KeyboardInterrupt as stop:
            code = INTERRUPTED
            for note in getattr(stop, "__notes__", ())[-1:]:  # the last one knows most
                print(note)
            print("Interrupted.", file=sys.stderr)
        except Exception as error:
            if is_debug or isinstance(error, BrokenPipeError):
                raise
            code = getattr(error, "exit_code", ConfigError.exit_code)
            _tell(error)
        sys.stdout.flush()
    except BrokenPipeError:
        for stream in (sys.stdout, sys.stderr):  # the null device takes what Python flushes when it exits
            with suppress(OSError):  # broken, or without descriptor
                stream.flush()
                continue
            with suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        return code or BROKEN_PIPE
    return code


def _tell(error: Exception) -> None:
    """Print `error`; raise it if it is none that a person can do something about."""
    text = (str(error).strip().splitlines() or ["no more is free"])[-1]  # of a worker's traceback the last line
    is_small = isinstance(error, ImportError) and free_memory() < 500e6  # a library that could not be mapped
    if isinstance(error, MemoryError) or is_small or re.search("allocate memory|start new thread", text):
        print(f"Error: not enough memory ({text}). Raise its limit, or reduce the size of the run.", file=sys.stderr)
    elif isinstance(error, OSError | ShesError):  # OSError: a full disk, a path that cannot be read, ...
        from shes.console import LineConsole  # rich is slow to import

        LineConsole(stderr=True).print_error(str(error))
    else:
        raise error


def _mend_streams() -> None:
    """Replace closed streams by the null device, characters that an encoding lacks by ?, and a width of nothing."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:  # else the next file that is opened gets its descriptor
            descriptor = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(descriptor, True)  # or the workers have the same gap
            setattr(sys, name, os.fdopen(descriptor, mode, encoding="utf-8"))
        elif mode == "w" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    columns = shutil.get_terminal_size().columns
    if columns < _LEAST_COLUMNS or os.environ.get("COLUMNS") == "0":
        os.environ["COLUMNS"] = str(max(columns, _LEAST_COLUMNS))
