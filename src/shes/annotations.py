"""Annotations of settings: bounds, choices, and what a setting depends on."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar


@dataclass(frozen=True)
class Bound:
    """A bound of the value, or of each item of a tuple."""

    bound: float
    words: ClassVar[str]
    allows: ClassVar[Callable[[Any, Any], bool]]
    """Whether a value, given first, keeps within the bound."""


class Gt(Bound):
    """The value is greater than `bound`."""

    words, allows = "greater than", operator.gt


class Ge(Bound):
    """The value is at least `bound`."""

    words, allows = "of at least", operator.ge


class Lt(Bound):
    """The value is less than `bound`."""

    words, allows = "less than", operator.lt


class Le(Bound):
    """The value is at most `bound`."""

    words, allows = "at most", operator.le


@dataclass(frozen=True, eq=False)
class Choices:
    """The value is one of these names. They are looked up at every check, because a registry may grow."""

    names: Iterable[str]
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
