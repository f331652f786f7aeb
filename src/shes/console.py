"""Consoles on standard output and error."""

from __future__ import annotations

from rich.console import Console
from rich.text import Text


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
