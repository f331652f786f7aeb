"""Settings told once: a field of a frozen dataclass is a setting, and its annotation says what it may be.

```python
@dataclass(frozen=True, kw_only=True)
class SearchSettings(Settings):
    radius: Annotated[float, Gt(0)] = 1.0
    "Radius of the search, in metres."
```

Check, flag, help, record and documentation of `radius` are made from these two lines.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
import textwrap
from collections.abc import Collection, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Self, Union, get_args, get_origin, get_type_hints

import numpy as np

from shes.errors import ConfigError, UnknownNameError
from shes.registry import Registry

__all__ = [
    "Choices",
    "Example",
    "Execution",
    "Ge",
    "Gt",
    "Le",
    "Lt",
    "Needs",
    "Setting",
    "Settings",
    "Shown",
    "Unasked",
    "field_texts",
    "flag",
    "out_of_range",
    "registered",
    "setting_fields",
]


@dataclass(frozen=True)
class Gt:
    """The value, or each item of it, is greater than `bound`."""

    bound: float


@dataclass(frozen=True)
class Ge:
    """The value, or each item of it, is at least `bound`."""

    bound: float


@dataclass(frozen=True)
class Lt:
    """The value, or each item of it, is less than `bound`."""

    bound: float


@dataclass(frozen=True)
class Le:
    """The value, or each item of it, is at most `bound`."""

    bound: float


@dataclass(frozen=True, eq=False)
class Choices:
    """The value is one of these names. A registry may grow later: it is looked up at every check."""

    names: Collection[str]
    fix: str = ""
    """What the error says beside the flag: how a registry is added to."""
    is_described: bool = False
    """Whether the help says what each class of the registry is, by the first sentence of its docstring."""


@dataclass(frozen=True)
class Example:
    """An example of the value, as it is written after the flag."""

    text: str


@dataclass(frozen=True)
class Execution:
    """The setting says how, where and how long, and changes no number of a generation.

    A device rounds otherwise; the record of a run says where it changed.
    """


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
    """The setting does nothing unless another setting has one of these values: any value but none if there are none.

    Several of these annotations on one field stand for "any of them".
    """

    other: str
    values: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class Setting:
    """A field of a `Settings` class: what its annotation says."""

    name: str
    kind: Any
    """Type of the value without None: `float`, `tuple`, ..."""
    item: Any
    """Type of an item of a tuple; `kind` for everything else."""
    is_optional: bool
    """Whether the value may be None."""
    default: Any
    """Value if none is given; `dataclasses.MISSING` if there must be one."""
    notes: tuple[Any, ...]
    """The annotations."""
    owner: type
    """The class that it is a field of."""

    @property
    def text(self) -> str:
        """The docstring under the field, on one line, and what each of the choices is."""
        described = (note.names for note in self.notes if isinstance(note, Choices) and note.is_described)
        choices = "; ".join(
            f"{name}: {_summary(cls)}" for names in described for name, cls in registered(names).items()
        )
        return " ".join(filter(None, (field_texts(self.owner).get(self.name, ""), choices and choices + ".")))

    @property
    def flag(self) -> str:
        """The flag of the command line."""
        return next((note.flag for note in self.notes if isinstance(note, Shown) and note.flag), flag(self.name))

    @property
    def choices(self) -> tuple[str, ...]:
        """The names that are allowed; none where any value of the type may be."""
        return tuple(name for note in self.notes if isinstance(note, Choices) for name in note.names)

    @property
    def needs(self) -> tuple[Needs, ...]:
        """Other settings without which it does nothing."""
        return tuple(note for note in self.notes if isinstance(note, Needs))

    def has(self, note: type) -> bool:
        """Tell whether it is annotated with a `note`."""
        return any(isinstance(each, note) for each in self.notes)

    @property
    def is_everyday(self) -> bool:
        """Whether the short help shows it."""
        return any(isinstance(note, Shown) and note.everyday for note in self.notes)

    def checked(self, value: Any) -> Any:
        """Return `value` as Python's own type.

        Raises:
            ConfigError: It is not allowed.
            UnknownNameError: It is a name that is not known.
        """
        value = _plain(value)
        if value is None and self.is_optional:
            return None
        for note in self.notes:
            if isinstance(note, Choices):
                return self._checked_name(value, note)
        is_allowed = _is_tuple_of(value, self) if self.kind is tuple else _is_item(value, self.item, self.notes)
        if not is_allowed:
            raise out_of_range(self.name, value, self.allowed, self.flag)
        if self.item is float:
            return tuple(map(float, value)) if self.kind is tuple else float(value)  # type: ignore[arg-type] - checked
        return value

    def _checked_name(self, value: Any, known: Choices) -> str:
        if not isinstance(value, str):
            raise out_of_range(self.name, value, f"one of {', '.join(known.names)}", self.flag)
        if value not in known.names:
            fix = f"Set {self.flag}.{' ' * bool(known.fix)}{known.fix}"
            raise UnknownNameError(self.name.replace("_", " "), value, known.names, fix)
        return value

    @property
    def allowed(self) -> str:
        """What the value must be, in words."""
        example = next((f", e.g. {self.flag} {note.text}" for note in self.notes if isinstance(note, Example)), "")
        if self.kind is tuple:
            return f"{_range_in_words(self.item, self.notes, is_many=True)}{example}"
        words = {bool: "true or false", str: "a name"}
        if self.item in (int, float):
            return _range_in_words(self.item, self.notes) + example
        return words.get(self.item, f"a {getattr(self.item, '__name__', self.item)}") + example


def flag(name: str) -> str:
    """Return the flag of a setting that is called so."""
    return "--" + name.replace("_", "-")


def out_of_range(name: str, value: Any, allowed: str, its_flag: str = "") -> ConfigError:
    """Return the error of a setting whose value is not `allowed`."""
    return ConfigError(f"{name} must be {allowed}, got {value!r}. Set {its_flag or flag(name)}.")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Base of every class of settings: a frozen dataclass whose values are checked when it is made."""

    def __post_init__(self) -> None:
        """Check every value; NumPy's numbers become Python's, lists tuples.

        Raises:
            ConfigError: A value is not allowed.
            UnknownNameError: A name is not known.
        """
        for setting in setting_fields(type(self)).values():
            object.__setattr__(self, setting.name, setting.checked(getattr(self, setting.name)))
        self.check()

    def check(self) -> None:
        """Refuse values that do not go together; does nothing unless a subclass says otherwise.

        Raises:
            ConfigError: There are such values.
        """

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """Return the settings with those of `values` that are theirs."""
        return cls(**{name: values[name] for name in setting_fields(cls) if name in values})

    def to_dict(self) -> dict[str, Any]:
        """Return the values as JSON holds them."""
        return {
            name: _as_json(getattr(self, name))
            for name, setting in setting_fields(type(self)).items()
            if not setting.has(Unasked)
        }


@cache
def setting_fields(cls: type) -> dict[str, Setting]:
    """Return the settings of a class, by name, those of its ancestors first."""
    hints = get_type_hints(cls, include_extras=True)
    found = {}
    for field in fields(cls):
        kind, notes = _unwrapped(hints[field.name])
        is_optional = get_origin(kind) in (Union, UnionType) and NoneType in get_args(kind)
        if is_optional:
            (kind,) = (each for each in get_args(kind) if each is not NoneType)
            kind, inner = _unwrapped(kind)
            notes += inner
        item = kind
        if get_origin(kind) is tuple:
            item, inner = _unwrapped(get_args(kind)[0])
            kind, notes = tuple, notes + inner
        if get_origin(kind) is Literal:
            kind, item, notes = str, str, (*notes, Choices(get_args(kind)))
        found[field.name] = Setting(
            name=field.name,
            kind=kind,
            item=item,
            is_optional=is_optional,
            default=field.default_factory() if field.default_factory is not MISSING else field.default,
            notes=notes,
            owner=cls,
        )
    return found


def registered(names: Collection[str]) -> Mapping[str, Any]:
    """Return the registered classes by name, or nothing if `names` is not a registry."""
    return names if isinstance(names, Registry) else {}


def _summary(cls: type) -> str:
    """Return the first sentence of a class's docstring, without its period."""
    return re.split(r"\.(?:\s|$)", inspect.getdoc(cls) or "", maxsplit=1)[0]


def _unwrapped(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    """Return a type without its annotations, and these."""
    if get_origin(kind) is Annotated:
        inner, notes = _unwrapped(get_args(kind)[0])
        return inner, (*notes, *kind.__metadata__)
    return kind, ()


@cache
def field_texts(cls: type) -> dict[str, str]:
    """Return the docstrings under the fields of a dataclass and its ancestors, on one line each."""
    texts: dict[str, str] = {}
    for ancestor in (*getattr(cls, "_option_classes", ()), *reversed(cls.__mro__[:-1])):
        try:
            (tree,) = ast.parse(textwrap.dedent(inspect.getsource(ancestor))).body
        except (OSError, TypeError, SyntaxError):
            continue  # a class made in a console has no source
        assert isinstance(tree, ast.ClassDef)
        for statement, follower in zip(tree.body, tree.body[1:], strict=False):
            if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
                text = follower.value if isinstance(follower, ast.Expr) else None
                if isinstance(text, ast.Constant):
                    texts[statement.target.id] = " ".join(str(text.value).split())
    return texts


def _plain(value: Any) -> Any:
    """Return a NumPy number as Python's own, and a list or an array as a tuple: JSON gives back what it was given."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return _plain(value.tolist()) if value.ndim else value
    return tuple(_plain(item) for item in value) if isinstance(value, list | tuple) else value


def _as_json(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_as_json(item) for item in value]
    return value.to_dict() if hasattr(value, "to_dict") else value


def _is_tuple_of(value: Any, setting: Setting) -> bool:
    return (
        isinstance(value, tuple)
        and (bool(value) or setting.item is int)  # no layer is a choice, no coordinate is a mistake
        and all(_is_item(each, setting.item, setting.notes) for each in value)
    )


def _is_item(value: Any, kind: Any, notes: Iterable[Any]) -> bool:
    """Tell whether `value` is of type `kind` and within the bounds among `notes`; a bool is no number."""
    if kind not in (int, float):
        return isinstance(value, kind) and (kind is not str or bool(value))
    if isinstance(value, bool) or not isinstance(value, int if kind is int else int | float):
        return False
    return math.isfinite(value) and all(_is_within(value, note) for note in notes)


def _is_within(value: float, note: Any) -> bool:
    return not (
        (isinstance(note, Gt) and not value > note.bound)
        or (isinstance(note, Ge) and not value >= note.bound)
        or (isinstance(note, Lt) and not value < note.bound)
        or (isinstance(note, Le) and not value <= note.bound)
    )


def _range_in_words(kind: Any, notes: tuple[Any, ...], *, is_many: bool = False) -> str:
    """Return which numbers are allowed: `a whole number of at least 1`, `more than 0 and less than 1`."""
    noun = {(int, False): "a whole number", (int, True): "whole numbers", (float, True): "numbers"}.get(
        (kind, is_many), "a number"
    )
    low = next((note for note in notes if isinstance(note, Gt | Ge)), None)
    high = next((note for note in notes if isinstance(note, Lt | Le)), None)
    if low is None or (high is None and is_many):
        words = noun if low is None else f"positive {noun}"
    elif high is not None:
        words = _between(noun if kind is int or is_many else "", low, high)
    elif kind is float and low.bound == 0:
        words = "a positive number" if isinstance(low, Gt) else "zero or a positive number"
    else:
        words = f"{noun} {'greater than' if isinstance(low, Gt) else 'of at least'} {low.bound:g}"
    return words


def _between(noun: str, low: Gt | Ge, high: Lt | Le) -> str:
    """Return how numbers between two bounds are called."""
    if isinstance(low, Ge) and isinstance(high, Le):
        return f"{noun} between {low.bound:g} and {high.bound:g}".strip()
    last = f"2**{math.log2(high.bound):g}" if high.bound >= 2**53 else f"{high.bound:g}"
    first = "more than" if isinstance(low, Gt) else "of at least" if noun else "at least"
    return f"{noun} {first} {low.bound:g} and {'less than' if isinstance(high, Lt) else 'at most'} {last}".strip()
