"""Standard output and error as they are, errors on one line, and exit codes."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from contextlib import suppress

from shes.cli.output import TO_ASCII, print_error, print_line
from shes.errors import ConfigError, ShesError

__all__ = ["BROKEN_PIPE", "INTERRUPTED", "exit_code"]

INTERRUPTED = 130
"""Exit code after Ctrl-C."""
BROKEN_PIPE = 141
"""Exit code if the reader of the output has gone, as after SIGPIPE."""


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
                print_line(note)
            print("Interrupted.", file=sys.stderr)
        except (MemoryError, OSError, ShesError) as error:  # OSError: a full disk, a path that cannot be read, ...
            if is_debug or isinstance(error, BrokenPipeError):
                raise
            code = error.exit_code if isinstance(error, ShesError) else ConfigError.exit_code
            found = str(error) or "no more is free"
            is_full = isinstance(error, MemoryError)
            print_error(
                f"not enough memory ({found}). Lower what the command asks for; see its --help."
                if is_full
                else str(error)
            )
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
