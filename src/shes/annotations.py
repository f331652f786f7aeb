"""Annotations of settings: bounds, choices, and what a setting depends on."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Bound:
    """A bound of the value, or of each item of a tuple."""

    bound: float


class Gt(Bound):
    """The value is greater than `bound`."""


class Ge(Bound):
    """The value is at least `bound`."""


class Lt(Bound):
    """The value is less than `bound`."""


class Le(Bound):
    """The value is at most `bound`."""


@dataclass(frozen=True, eq=False)
class Choices:
    """The value is one of these names. They are looked up at every check, because a registry may grow."""

    names: Collection[str]
    fix: str = ""
    """How to add a name, for the error message."""
    is_described: bool = False
    """Whether the help describes each class of the registry by the first sentence of its docstring."""


@dataclass(frozen=True)
class Example:
    """An example of the value, as written after the flag."""

    text: str


@dataclass(frozen=True)
class Execution:
    """The setting decides how, where or for how long a run computes, and does not change its numbers.

    Devices round differently; the record of a run says where its device changed.
    """


@dataclass(frozen=True)
class Shared:
    """The setting may have the name of a setting of an earlier section. It is then one setting, with one value."""


@dataclass(frozen=True)
class Shown:
    """How the command line shows the setting."""

    flag: str = ""
    """Its flag, if that is not its name."""
    everyday: bool = False
    """Whether the short help of `shes train` shows it."""


@dataclass(frozen=True)
class Unasked:
    """The program sets this field; it has no flag and is not recorded."""


@dataclass(frozen=True)
class Needs:
    """The setting has no effect unless setting `other` has one of `values`, or is not None if there are no `values`.

    Several of these annotations on one field are alternatives.
    """

    other: str
    values: tuple[str, ...] = ()


def range_in_words(kind: Any, notes: tuple[Any, ...], *, is_many: bool = False) -> str:
    """Return the allowed numbers in words: `a whole number of at least 1`, `more than 0 and less than 1`."""
    noun = ("whole numbers" if is_many else "a whole number") if kind is int else ("numbers" if is_many else "a number")
    low = next((note for note in notes if isinstance(note, Gt | Ge)), None)
    high = next((note for note in notes if isinstance(note, Lt | Le)), None)
    if low is None:
        return noun
    if high is None:
        if is_many:
            return f"positive {noun}"
        if kind is float and low.bound == 0:
            return "a positive number" if isinstance(low, Gt) else "zero or a positive number"
        return f"{noun} {'greater than' if isinstance(low, Gt) else 'of at least'} {low.bound:g}"
    noun = noun if kind is int or is_many else ""
    if isinstance(low, Ge) and isinstance(high, Le):
        return f"{noun} between {low.bound:g} and {high.bound:g}".strip()
    last = f"2**{math.log2(high.bound):g}" if high.bound >= 2**53 else f"{high.bound:g}"
    first = "more than" if isinstance(low, Gt) else "of at least" if noun else "at least"
    return f"{noun} {first} {low.bound:g} and {'less than' if isinstance(high, Lt) else 'at most'} {last}".strip()
