"""What the commands print: facts as a table or JSON, errors on one line."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

__all__ = ["print_error", "print_facts", "print_interrupted", "print_line", "print_table", "quote"]

# rich is imported where it is used: `shes --help` is to be quick.


def print_facts(facts: dict[str, Any], *, as_json: bool) -> None:
    """Print named values as a table, or as one JSON object."""
    if as_json:
        print(json.dumps(facts))
        return
    rows = [(name, f"{value:,.3f}" if isinstance(value, float) else str(value)) for name, value in facts.items()]
    print_table((), rows)


def print_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; without headings if there are none."""
    from rich.console import Console
    from rich.table import Table

    table = Table(*headings, show_header=bool(headings))
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def print_line(text: str) -> None:
    """Print a line as it is, however long."""
    from rich.console import Console

    Console().print(text, highlight=False, markup=False, soft_wrap=True)


def print_error(error: Exception) -> None:
    """Print an error's message on one line of standard error."""
    from rich.console import Console
    from rich.text import Text

    line = Text.assemble(("Error:", "bold red"), " ", str(error))
    Console(stderr=True).print(line, highlight=False, soft_wrap=True)


def print_interrupted() -> None:
    """Say that Ctrl-C ended the command."""
    from rich.console import Console

    Console(stderr=True).print("Interrupted.", style="yellow")


def quote(path: Path | str) -> str:
    """Return `path` as a word of a command that can be copied into a shell."""
    return shlex.quote(str(path))
