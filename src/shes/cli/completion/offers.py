"""What there is to complete: the commands with their options."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from shes.cli.commands import SUMMARIES, load_command
from shes.cli.options import Option, options_in
from shes.runs.shipped import shipped_names

__all__ = ["ALONE", "EVERYWHERE", "Offer", "agents_for", "brief", "gather_offers", "is_path"]

EVERYWHERE: dict[str, str] = {
    "--help": "Show the help.",
    "--debug": "Show the traceback of an error.",
    "--import": "Import a module first.",
}
"""Flags of every command; --import alone takes a value."""

ALONE: dict[str, str] = {**EVERYWHERE, "--version": "Show the version."}
"""Flags before any command."""


@dataclass(frozen=True, kw_only=True)
class Offer:
    """A command and what can follow it."""

    name: str
    summary: str
    options: tuple[Option, ...]

    @property
    def flagged(self) -> tuple[Option, ...]:
        """Options that have a flag."""
        return tuple(option for option in self.options if option.flags)

    @property
    def positionals(self) -> tuple[Option, ...]:
        """Options that have none."""
        return tuple(option for option in self.options if not option.flags)

    @property
    def flags(self) -> tuple[str, ...]:
        """Every flag in the form that is shown, and those of every command."""
        shown = [flag for option in self.flagged for flag in option.shown_flags]
        return (*shown, *EVERYWHERE)


def gather_offers() -> tuple[Offer, ...]:
    """Return every command with its options."""
    return tuple(
        Offer(name=name, summary=summary, options=options_in(load_command(name).groups_for([])))
        for name, summary in SUMMARIES.items()
    )


def agents_for(option: Option) -> tuple[str, ...]:
    """Return the names of shipped agents that may stand in the place of a path."""
    return shipped_names() if option.is_run else ()


def is_path(option: Option) -> bool:
    """Tell whether the value is a path, or several."""
    return option.is_run or any(Path in (kind, *get_args(kind)) for kind in option.kinds)


def brief(text: str) -> str:
    """Return the beginning of a text: what is shown beside a word."""
    return text.partition(". ")[0].partition(";")[0].rstrip(".")
