"""Consoles on standard output and error: lines, errors and tables."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from shes.types import Table


class LineConsole(Console):
    """A console that raises BrokenPipeError if nobody reads its output, where rich would exit with code 1."""

    def on_broken_pipe(self) -> None:
        """Raise BrokenPipeError."""
        raise BrokenPipeError

    def print_line(self, text: str | Text) -> None:
        """Print `text` without wrapping or markup."""
        self.print(text, highlight=False, markup=False, soft_wrap=True)

    def print_error(self, text: str) -> None:
        """Print an error message on one line."""
        self.print_line(Text.assemble(("Error:", "bold red"), " ", text))

    def print_table(self, table: Table) -> None:
        """Print `table` in the width of the console. A word that is too long for its column is broken."""
        made = RichTable(show_header=bool(table.headings))
        for heading in table.headings or [""] * len(table.rows[0]):
            made.add_column(heading, overflow="fold")
        for row in table.rows:
            made.add_row(*map(Text, row))
        self.print(made)
