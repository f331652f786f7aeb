"""The `shes` command: parses, prints, and turns errors into one line and an exit code; the work is done elsewhere."""

from shes.cli.program import main

__all__ = ["main"]
