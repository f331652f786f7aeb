"""What a command takes: options, read from the fields and docstrings of a frozen dataclass.

Help, parser and shell completion all work from these, so that they cannot disagree.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, get_args, get_origin, get_type_hints

from shes.settings import field_texts

__all__ = ["Group", "Option", "Shown", "options_in", "options_of", "shown_value"]


@dataclass(frozen=True, kw_only=True)
class Shown:
    """How a field appears on the command line, as its annotation says: `Annotated[Path, Shown(...)]`."""

    metavar: str = ""
    """What stands for the value; the choices or the type if empty."""
    choices: tuple[str, ...] = ()
    """Words that are offered; the command itself refuses others, with its own message."""
    flags: tuple[str, ...] = ()
    """How it is written, the form that is shown first; the field's name if empty."""
    noun: str = ""
    """What is needed, with its article; makes the field a positional."""
    is_run: bool = False
    """Whether it names a run: a folder, or a shipped agent. Text, because `./name` is a path and `name` may be none."""


@dataclass(frozen=True, kw_only=True)
class Option:
    """A flag with its value, or a positional."""

    name: str
    """The field that it sets."""
    kind: Any
    """Type of the value."""
    text: str
    """What it is for."""
    flags: tuple[str, ...] = ()
    """How it is written, the form that is shown first; none is a positional."""
    metavar: str = ""
    """What stands for the value; the choices or the type if empty."""
    choices: tuple[str, ...] = ()
    """Words that are offered."""
    default: str = ""
    """What holds if it is not given; empty shows nothing."""
    noun: str = ""
    """What a positional is, with its article."""
    is_run: bool = False
    """Whether it names a run: a folder, or a shipped agent."""
    is_required: bool = False

    @property
    def is_switch(self) -> bool:
        """Whether it takes no value: `--json`, `--no-json`."""
        return self.kind is bool

    @property
    def takes_many(self) -> bool:
        """Whether it takes any number of values."""
        return any(get_args(kind)[-1:] == (...,) for kind in self.kinds)

    @property
    def kinds(self) -> tuple[Any, ...]:
        """The types that its value may have: two for `float | None`."""
        return (self.kind,) if get_origin(self.kind) is tuple else get_args(self.kind) or (self.kind,)

    @property
    def spellings(self) -> tuple[str, ...]:
        """Every way to write its flag."""
        return (*self.flags, *(f"--no-{flag[2:]}" for flag in self.flags if self.is_switch))

    @property
    def shown_flags(self) -> tuple[str, ...]:
        """The flags to show: one, or both of a switch; one that is off by itself needs no way to turn it off."""
        return self.spellings if self.is_switch and self.default else self.flags[:1]


@dataclass(frozen=True, kw_only=True)
class Group:
    """Options under one heading of the help."""

    heading: str
    options: tuple[Option, ...]


def options_in(groups: Iterable[Group]) -> tuple[Option, ...]:
    """Return the options of all groups."""
    return tuple(option for group in groups for option in group.options)


def options_of(arguments: type) -> tuple[Option, ...]:
    """Return an option for every field of the dataclass `arguments`."""
    hints, texts = get_type_hints(arguments, include_extras=True), field_texts(arguments)
    found: list[Option] = []
    for field in fields(arguments):
        kind, *notes = (hints[field.name], *getattr(hints[field.name], "__metadata__", ()))
        shown = next((note for note in notes if isinstance(note, Shown)), Shown())
        found.append(
            Option(
                name=field.name,
                kind=get_args(kind)[0] if notes else kind,
                text=texts[field.name],
                flags=() if shown.noun else shown.flags or ("--" + field.name.replace("_", "-"),),
                metavar=shown.metavar,
                choices=shown.choices,
                default="" if field.default is MISSING or field.default is False else shown_value(field.default),
                noun=shown.noun,
                is_run=shown.is_run,
                is_required=field.default is MISSING,
            )
        )
    return tuple(found)


def shown_value(value: Any) -> str:
    """Return a value as it is written on a command line."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return " ".join(str(item) for item in value) or "no number"
    return str(value)
