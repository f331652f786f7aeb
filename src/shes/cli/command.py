"""What a subcommand is: its words for people, its options, and what it does. One file each in `commands`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from shes.cli.options import Group

__all__ = ["Command"]


@dataclass(frozen=True, kw_only=True)
class Command:
    """A subcommand of `shes`."""

    name: str
    description: str
    """What it does, in a sentence."""
    examples: tuple[str, ...] = ()
    """Command lines to copy."""
    groups: tuple[Group, ...] | Callable[[Sequence[str]], tuple[Group, ...]]
    """Its options by heading; or what returns them, with the defaults for the words of a command line."""
    run: Callable[[dict[str, Any]], int]
    """Does the work with the values that were given, by name; returns the exit code."""
    notes: Callable[[Sequence[str]], str] | None = None
    """Returns what else the help says, for these words."""
    explain_unknown: Callable[[str], str | None] | None = None
    """Returns a better message for a flag that it does not take."""
    is_help_alone: bool = False
    """Whether the command without a word shows its help."""

    def groups_for(self, words: Sequence[str]) -> tuple[Group, ...]:
        """Return its options by heading, for these words of a command line."""
        return self.groups(words) if callable(self.groups) else self.groups
