"""Output of the commands: tables, JSON, and errors on one line, in ASCII where the encoding lacks a character."""

from __future__ import annotations

import codecs
import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # rich is imported where it is used: `shes --help` has to be quick
    from rich.console import Console

    from shes.listing import Listing, Table

__all__ = ["TO_ASCII", "make_console", "print_error", "print_line", "show"]

TO_ASCII = "shes.to_ascii"
"""Name of the error handler that writes ASCII for the characters that an encoding lacks."""
_IN_ASCII = {"±": "+/-", "×": "x", "·": ",", "…": "...", "—": "-", "≥": ">=", "≤": "<=", "→": "->", "°": " deg"}


def _to_ascii(error: UnicodeError) -> tuple[str, int]:
    """Return the ASCII text for the characters that an encoding lacks, and the position after them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_IN_ASCII.get(each, "?") for each in error.object[error.start : error.end]), error.end


codecs.register_error(TO_ASCII, _to_ascii)


def make_console(*, stderr: bool = False) -> Console:
    """Return a console that raises BrokenPipeError if nobody reads its output, where rich would exit with code 1."""
    from rich.console import Console

    class _Console(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return _Console(stderr=stderr)


def show(listing: Listing, as_json: bool = False) -> int:
    """Print a listing as JSON, or as tables and lines, and its errors; return the exit code."""
    if as_json:
        print(json.dumps(listing.facts, indent=2 if isinstance(listing.facts, list) else None))
    else:
        for part in listing.parts:
            print_line(part) if isinstance(part, str) else _print_table(part)
    for error in listing.errors:
        print_error(error)
    return 1 if listing.errors else 0


def _print_table(table: Table) -> None:
    from rich.table import Table as RichTable
    from rich.text import Text

    console = make_console()
    shown = RichTable(*table.headings, show_header=bool(table.headings))
    for row in table.rows:  # laid out as long as they are in the encoding
        shown.add_row(*(Text(cell.encode(console.encoding, TO_ASCII).decode(console.encoding)) for cell in row))
    console.print(shown)


def print_line(text: str) -> None:
    """Print `text` without wrapping or markup."""
    make_console().print(text, highlight=False, markup=False, soft_wrap=True)


def print_error(text: str) -> None:
    """Print an error message on one line of standard error."""
    from rich.text import Text

    make_console(stderr=True).print(Text.assemble(("Error:", "bold red"), " ", text), highlight=False, soft_wrap=True)
