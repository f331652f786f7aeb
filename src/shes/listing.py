"""Listings: facts as JSON types, with the tables and lines in which people read them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

__all__ = ["Listing", "Table", "facts_listing"]


class Table(NamedTuple):
    """A table of texts."""

    headings: Sequence[str]
    """Headings of the columns; empty for a table of names and values."""
    rows: Sequence[Sequence[str]]


class Listing(NamedTuple):
    """Output of a command."""

    facts: Any
    """All of it as JSON types."""
    parts: Sequence[Table | str]
    """Tables and lines, in order."""
    errors: Sequence[str] = ()
    """Messages about parts that failed."""


def facts_listing(facts: Mapping[str, Any]) -> Listing:
    """Return the listing of named values."""
    rows = [(name, f"{it:,.3f}" if isinstance(it, float) else str(it)) for name, it in facts.items()]
    return Listing(facts, [Table((), rows)])
