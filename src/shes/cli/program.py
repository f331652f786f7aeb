"""The program: the overview of the commands, and the call of one of them."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence

import shes
from shes.cli.command_table import COMMANDS, find_command, split_everywhere
from shes.cli.exit_code import exit_code
from shes.errors import ConfigError
from shes.registry import import_registering

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
    given = list(sys.argv[1:] if arguments is None else arguments)
    asked, words = split_everywhere(given)
    return exit_code(lambda: _run(asked.modules, words or ["--help"]), is_debug=asked.debug)


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
