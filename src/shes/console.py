"""Consoles on standard output and error: lines, errors and tables."""

from __future__ import annotations

from rich.cells import cell_len
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
        """Print `table` in the width of the console: lines are broken between words, except in the widest column."""
        made = RichTable(show_header=bool(table.headings))
        headings = table.headings or [""] * len(table.rows[0])
        columns = list(zip(headings, *table.rows, strict=True))
        widths = [max(map(cell_len, column)) for column in columns]
        excess = sum(widths) + 3 * len(widths) + 1 - self.width
        for i in reversed(range(len(widths))):
            longest_word = max((cell_len(word) for cell in columns[i] for word in cell.split()), default=0)
            cut = max(0, min(excess, widths[i] - longest_word))
            widths[i], excess = widths[i] - cut, excess - cut
        widest = widths.index(max(widths))
        widths[widest] = max(widths[widest] - max(excess, 0), 1)
        for heading, width in zip(headings, widths, strict=True):
            made.add_column(heading, overflow="fold", width=width)
        for row in table.rows:
            made.add_row(*map(Text, row))
        self.print(made)
