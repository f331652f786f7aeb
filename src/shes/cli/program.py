"""The program: the overview of the commands, and the call of one of them."""

from __future__ import annotations

import codecs
import io
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress

import shes
from shes.cli.command_table import COMMANDS, find_command, split_everywhere
from shes.errors import ConfigError, ShesError
from shes.registry import import_registering

INTERRUPTED, BROKEN_PIPE, TERMINATED = 130, 141, 143
"""Exit codes after Ctrl-C, if the reader of the output has gone, and after SIGTERM."""

TO_ASCII = "shes.to_ascii"
"""Name of the error handler that writes ASCII for the characters that an encoding lacks."""
_IN_ASCII = {"±": "+/-", "×": "x", "·": ",", "…": "...", "—": "-", "≥": ">=", "≤": "<=", "→": "->", "°": " deg"}


def _to_ascii(error: UnicodeError) -> tuple[str, int]:
    """Return the ASCII text for the characters that an encoding lacks, and the position after them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_IN_ASCII.get(each, "?") for each in error.object[error.start : error.end]), error.end


codecs.register_error(TO_ASCII, _to_ascii)


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
        except (MemoryError, OSError, ShesError) as error:  # OSError: a full disk, a path that cannot be read, ...
            if is_debug or isinstance(error, BrokenPipeError):
                raise
            code = error.exit_code if isinstance(error, ShesError) else ConfigError.exit_code
            text = str(error)
            if isinstance(error, MemoryError):
                text = f"not enough memory ({text or 'no more is free'}). Reduce the size of the run; see --help."
            from shes.console import LineConsole  # rich is slow to import

            LineConsole(stderr=True).print_error(text)
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


def _mend_streams() -> None:
    """Replace closed streams by the null device; let the others show in ASCII what their encoding lacks."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:  # else the next file that is opened gets its descriptor
            descriptor = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(descriptor, True)  # or the workers have the same gap
            setattr(sys, name, os.fdopen(descriptor, mode, encoding="utf-8"))
        elif mode == "w" and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=TO_ASCII)


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
