"""The program: flags that every command takes, the command itself, and what its errors become."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from shes.cli.commands import SUMMARIES, load_command
from shes.cli.help_text import command_help, overview
from shes.cli.imports import import_modules
from shes.cli.options import options_in
from shes.cli.output import print_error, print_interrupted
from shes.errors import ConfigError, ShesError, UnknownNameError

__all__ = ["main"]

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

BROKEN_PIPE = 141
"""Exit code when nobody reads the output, as that of programs which SIGPIPE ends."""

_HELP = ("-h", "--help")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code: 0, 2 for what the user can mend, 1 for the rest, 130 after Ctrl-C."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    is_debug = "--debug" in words
    try:
        modules, words = _take_imports([word for word in words if word != "--debug"])
        import_modules(modules)
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


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in (*_HELP, "help"):
        print(overview(SUMMARIES))
        return 0
    if words[0] == "--version":
        from importlib.metadata import version

        print(f"shes {version('shes')}")
        return 0
    name, *rest = words
    if name.startswith("-"):
        alone = ", ".join((*_HELP, "--version", "--debug", "--import"))
        raise ConfigError(f"unknown flag {name} before the command: there are {alone}. `shes --help` explains them.")
    if name not in SUMMARIES:
        raise UnknownNameError("command", name, SUMMARIES, "`shes --help` explains them.")
    command = load_command(name)
    if set(_HELP) & set(rest) or (command.is_help_alone and not rest):
        rest = [word for word in rest if word not in _HELP]
        print(command_help(command, command.groups_for(rest), command.notes(rest) if command.notes else ""))
        return 0
    from shes.cli.parsing import parse  # tyro takes its time: not for help

    return command.run(parse(options_in(command.groups_for(rest)), rest, name, command.explain_unknown))
