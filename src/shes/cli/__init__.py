"""The `shes` command: parsing, output, and exit codes."""

from shes.cli.program import main

__all__ = ["main"]
