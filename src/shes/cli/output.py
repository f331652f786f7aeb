"""Output of the commands: tables and lines, JSON, the paths of files, and the progress of a drawing."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.table import Table as RichTable
from rich.text import Text

from shes.cli.program import TERMINATED, TO_ASCII
from shes.console import LineConsole
from shes.runs.progress_display import drawing_progress
from shes.types import Listing


def show(found: Any, kind: str = "", *, as_json: bool = False) -> int:
    """Print what a command returns; return the exit code.

    Args:
        found: An exit code, which is not printed; a listing, or an object that has one; or a path or several, or None.
        kind: What is at the paths.
        as_json: Whether to print the listing as JSON.
    """
    if isinstance(found, int):
        return found
    listing = found.listing() if hasattr(found, "listing") else found
    if not isinstance(listing, Listing):
        files = () if found is None else found if isinstance(found, tuple) else (found,)
        listing = Listing([], [f"{kind}: {file}" for file in files])
    console = LineConsole()
    if as_json:
        print(json.dumps(listing.facts, indent=2 if isinstance(listing.facts, list) else None))
        listing = listing._replace(parts=())
    for part in listing.parts:
        if isinstance(part, str):
            console.print_line(part)
            continue
        table = RichTable(show_header=bool(part.headings))
        for i, heading in enumerate(part.headings):  # a name is to be copied: whole, on one line if it is short
            is_short = max((len(row[i]) for row in part.rows), default=0) <= 24  # characters
            table.add_column(heading, overflow="fold", no_wrap=i == 0 and is_short)
        for row in part.rows:  # laid out as long as they are in the encoding
            table.add_row(*(Text(cell.encode(console.encoding, TO_ASCII).decode(console.encoding)) for cell in row))
        console.print(table)
    for error in listing.errors:
        LineConsole(stderr=True).print_error(error)
    return 1 if listing.errors else 0


@contextmanager
def show_steps() -> Iterator[dict[str, Callable[[int, int], None]]]:
    """Yield `on_step`, which shows the progress of a drawing in a terminal. SIGTERM lets it remove its files."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))
    with drawing_progress(LineConsole(stderr=True)) as on_step:
        yield {"on_step": on_step}
