"""Output of the commands: tables, JSON, and errors on one line."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shes.cli.streams import showable

if TYPE_CHECKING:  # rich is imported where it is used: `shes --help` has to be quick
    from rich.console import Console

__all__ = ["make_console", "print_error", "print_facts", "print_line", "print_table", "quote"]


def make_console(*, stderr: bool = False) -> Console:
    """Return a console that raises BrokenPipeError if nobody reads its output, where rich would exit with code 1."""
    from rich.console import Console

    class _Console(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

    return _Console(stderr=stderr)


def print_facts(facts: dict[str, Any], *, as_json: bool) -> None:
    """Print named values as a table, or as one JSON object."""
    if as_json:
        print(json.dumps(facts))
        return
    rows = [(name, f"{value:,.3f}" if isinstance(value, float) else str(value)) for name, value in facts.items()]
    print_table((), rows)


def print_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table, with a heading over each column if there are headings."""
    from rich.table import Table
    from rich.text import Text

    console = make_console()
    table = Table(*headings, show_header=bool(headings))
    for row in rows:
        table.add_row(*(Text(showable(cell, console.encoding)) for cell in row))
    console.print(table)


def print_line(text: str) -> None:
    """Print `text` without wrapping or markup."""
    make_console().print(text, highlight=False, markup=False, soft_wrap=True)


def print_error(text: str) -> None:
    """Print an error message on one line of standard error."""
    from rich.text import Text

    make_console(stderr=True).print(Text.assemble(("Error:", "bold red"), " ", text), highlight=False, soft_wrap=True)


def quote(path: Path | str) -> str:
    """Return `path` quoted for a shell."""
    return shlex.quote(str(path))
