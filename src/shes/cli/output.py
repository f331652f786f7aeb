"""What the commands print: tables, JSON, and errors on one line."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

__all__ = ["print_error", "print_facts", "print_line", "print_table", "quote"]

# rich is imported where it is used: `shes --help` has to be quick.


def print_facts(facts: dict[str, Any], *, as_json: bool) -> None:
    """Print named values as a table, or as one JSON object."""
    if as_json:
        print(json.dumps(facts))
        return
    rows = [(name, f"{value:,.3f}" if isinstance(value, float) else str(value)) for name, value in facts.items()]
    print_table((), rows)


def print_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table, with a heading over each column if there are headings."""
    from rich.console import Console
    from rich.table import Table

    table = Table(*headings, show_header=bool(headings))
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def print_line(text: str) -> None:
    """Print `text` without wrapping or markup."""
    from rich.console import Console

    Console().print(text, highlight=False, markup=False, soft_wrap=True)


def print_error(text: str) -> None:
    """Print an error message on one line of standard error."""
    from rich.console import Console
    from rich.text import Text

    Console(stderr=True).print(Text.assemble(("Error:", "bold red"), " ", text), highlight=False, soft_wrap=True)


def quote(path: Path | str) -> str:
    """Return `path` quoted for a shell."""
    return shlex.quote(str(path))
