"""Standard output and error as they are: closed, read by nobody, or of an encoding without ± and ×."""

from __future__ import annotations

import codecs
import io
import os
import sys
import unicodedata
from collections.abc import Callable
from contextlib import suppress

from shes.errors import ShesError

__all__ = ["BROKEN_PIPE", "INTERRUPTED", "showable", "with_streams"]

INTERRUPTED = 130
"""Exit code after Ctrl-C."""
BROKEN_PIPE = 141
"""Exit code if the reader of the output has gone, as after SIGPIPE."""

_TO_ASCII = "shes.to_ascii"
_REPLACEMENTS = {"±": "+/-", "×": "x", "·": ",", "…": "...", "—": "-", "≥": ">=", "≤": "<=", "→": "->", "°": " deg"}
_REPLACEMENTS |= dict.fromkeys("┌┐└┘├┤┬┴┼", "+") | dict(zip("▁▂▃▄▅▆▇█─━═╌│┃║", "_.-:=+*#----|||", strict=True))


def _to_ascii(error: UnicodeError) -> tuple[str, int]:
    """Return the ASCII text for the characters that an encoding lacks, and the position after them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = error.object[error.start : error.end]
    plain = (unicodedata.normalize("NFKD", each).encode("ascii", "ignore").decode() or "?" for each in found)
    return "".join(_REPLACEMENTS.get(each, other) for each, other in zip(found, plain, strict=True)), error.end


codecs.register_error(_TO_ASCII, _to_ascii)


def showable(text: str, encoding: str) -> str:
    """Return `text` with ASCII for the characters that `encoding` lacks. Tables are laid out by its length."""
    try:
        return text.encode(encoding, _TO_ASCII).decode(encoding)
    except LookupError:  # an unknown encoding
        return text.encode("ascii", _TO_ASCII).decode()


def with_streams(work: Callable[[], int]) -> int:
    """Return the exit code of `work`, whatever standard output and error are.

    If nobody reads them any more, the exit code is the one of what ended the work before, else `BROKEN_PIPE`.
    A closed stream is replaced by the null device.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # else the next file that is opened gets its descriptor
            descriptor = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(descriptor, True)  # or the workers have the same gap
            setattr(sys, name, os.fdopen(descriptor, mode, encoding="utf-8"))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_TO_ASCII)
    code = 0
    try:
        code = work()
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
    except BrokenPipeError as error:
        _discard_output()
        return code or _code_before(error)
    return code


def _code_before(error: BaseException) -> int:
    """Return the exit code of the error that was being printed when `error` was raised."""
    while error.__context__ is not None:
        error = error.__context__
        if isinstance(error, KeyboardInterrupt | ShesError):
            return error.exit_code if isinstance(error, ShesError) else INTERRUPTED
    return BROKEN_PIPE


def _discard_output() -> None:
    """Let the null device take what broken streams still hold: Python flushes them when it exits."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except BrokenPipeError:
            with suppress(OSError):  # a stream without descriptor
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
