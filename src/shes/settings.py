"""Settings: fields of frozen dataclasses, whose annotations say which values are allowed.

```python
@dataclass(frozen=True, kw_only=True)
class SearchSettings(Settings):
    radius: Annotated[float, Gt(0)] = 1.0
    "Radius of the search, in metres."
```

The check, the flag, the help, the record and the documentation of `radius` are derived from these two lines. The
arguments of a function are checked alike if it is decorated with `checked`.
"""

from __future__ import annotations

import ast
import inspect
import json
import linecache
import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cache, partial, wraps
from itertools import pairwise
from operator import methodcaller
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Self, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from shes.errors import ConfigError, UnknownNameError
from shes.registry import Registry, full_name

NoteT = TypeVar("NoteT")
F = TypeVar("F", bound=Callable[..., Any])
_SENTENCE_END = r"\.(?:\s|$)"


@dataclass(frozen=True)
class Bound:
    """A bound of the value, or of each item of a tuple."""

    words: str
    allows: Callable[[Any, Any], bool]
    """Whether a value, given first, keeps within the bound."""
    bound: float


Gt, Ge = partial(Bound, "greater than", operator.gt), partial(Bound, "of at least", operator.ge)
Lt, Le = partial(Bound, "less than", operator.lt), partial(Bound, "at most", operator.le)


@dataclass(frozen=True, eq=False)
class Choices:
    """The value is one of these names. They are looked up at every check, because a registry may grow.

    The help describes each entry of a registry by the first sentence of its docstring.
    """

    names: Iterable[str]


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Setting:
    """The description of a field of a `Settings` class, or of a parameter."""

    name: str
    hint: Any
    """Its annotation."""
    kind: Any
    """Type of a value other than None: `float`, `tuple`, ..."""
    item: Any
    """Type of an item of a tuple; otherwise `kind`."""
    length: int | None
    """Number of items of a tuple of fixed length."""
    is_optional: bool
    """Whether the value may be None."""
    default: Any
    """`dataclasses.MISSING` if the setting is required."""
    notes: tuple[Any, ...]
    """The annotations inside `hint`."""
    owner: Any
    """The class of the field, or the function of the parameter."""

    @property
    def text(self) -> str:
        """The docstring under the field, on one line, and what each of the choices is."""
        choices = "; ".join(
            f"{name}: {re.split(_SENTENCE_END, inspect.getdoc(cls) or '', maxsplit=1)[0]}"
            for note in self.all_of(Choices)
            for name, cls in registered(note.names).items()
        )
        return " ".join(filter(None, (field_texts(self.owner).get(self.name, ""), choices and choices + ".")))

    @property
    def flag(self) -> str:
        """The flag on the command line."""
        return next((note.flag for note in self.all_of(Shown) if note.flag), flag(self.name))

    @property
    def choices(self) -> tuple[str, ...]:
        """Allowed names; empty if any value of the type is allowed."""
        return tuple(name for note in self.all_of(Choices) for name in note.names)

    @property
    def can_be_empty(self) -> bool:
        """Whether its value may be an empty tuple: no hidden layers."""
        return self.kind is tuple and self.length is None and self.item is int

    def all_of(self, note: type[NoteT]) -> Iterator[NoteT]:
        """Yield its annotations of type `note`."""
        return (each for each in self.notes if isinstance(each, note))

    def has(self, note: type) -> bool:
        """Return whether it has an annotation of type `note`."""
        return any(self.all_of(note))

    def checked(self, value: Any) -> Any:
        """Return `value`, with NumPy types and lists converted to built-in types and tuples.

        For a tuple of any length, a single number stands for a tuple of one. Raise ConfigError if the value is not
        allowed, and UnknownNameError if it is an unknown name.
        """
        if value is None and self.is_optional:
            return None
        if self.kind is dict:
            return self._checked_object(value)
        plain = _plain(value)
        if known := next(self.all_of(Choices), None):
            return self._checked_name(plain, known)
        if self.kind is not tuple:
            if self.item is int and isinstance(plain, float) and plain.is_integer() and abs(plain) < 2**63:
                plain = int(plain)
            if not self._is_item(plain):
                raise out_of_range(self.name, plain, self.allowed, self.flag)
            return float(plain) if self.item is float else plain
        items = (plain,) if self.length is None and isinstance(plain, int | float) else plain
        has_length = isinstance(items, tuple) and self.length in (None, len(items))
        if not has_length or not (items or self.can_be_empty) or not all(map(self._is_item, items)):
            raise out_of_range(self.name, items, self.allowed, self.flag)
        return tuple(map(float, items)) if self.item is float else items

    def _checked_name(self, value: Any, known: Choices) -> str:
        if not isinstance(value, str):
            raise out_of_range(self.name, value, f"one of {', '.join(known.names)}", self.flag)
        if isinstance(known.names, Registry):
            known.names.find(value)
        elif value not in known.names:
            raise UnknownNameError(self.name.replace("_", " "), value, known.names, f"Set {self.flag}.")
        return value

    def _checked_object(self, value: Any) -> dict[str, Any]:
        """Return a copy of a JSON object, which may be given as its text."""
        try:
            found = json.loads(value) if isinstance(value, str) else value
            if isinstance(found, Mapping) and all(isinstance(name, str) and name.isidentifier() for name in found):
                return json.loads(json.dumps(dict(found), allow_nan=False, default=methodcaller("tolist")))
        except (AttributeError, RecursionError, TypeError, ValueError):  # no JSON
            pass
        raise out_of_range(self.name, value, self.allowed, self.flag)

    def _is_item(self, value: Any) -> bool:
        """Return whether `value` has the type of an item and is within the bounds; a bool is not a number."""
        if self.item not in (int, float):
            return isinstance(value, self.item) and (self.item is not str or bool(value))
        if isinstance(value, bool) or not isinstance(value, int if self.item is int else int | float):
            return False
        if not all(note.allows(value, note.bound) for note in self.all_of(Bound)):
            return False
        if isinstance(value, int) and abs(value) >= 2**63:  # NumPy has no such integers
            raise out_of_range(self.name, value, "less than 2**63", self.flag)
        return math.isfinite(value)

    @property
    def allowed(self) -> str:
        """The allowed values in words, for error messages."""
        count = f"{self.length} " if self.length else ""
        named = {bool: "true or false", str: "a name", int: "a whole number", float: "a number"}
        named[dict] = "a JSON object of names and values"
        words = named.get(self.item) or f"a {getattr(self.item, '__name__', '')}"
        if self.kind is tuple:
            words = words.removeprefix("a ") + "s"
        words += " and".join(f" {note.words} {note.bound:g}" for note in self.all_of(Bound))
        return count + words + "".join(f", e.g. {self.flag} {note.text}" for note in self.all_of(Example))


def flag(name: str) -> str:
    """Return the flag of the setting called `name`."""
    return "--" + name.replace("_", "-")


def out_of_range(name: str, value: Any, allowed: str, its_flag: str = "") -> ConfigError:
    """Return the error for setting `name` with a `value` that is not `allowed`."""
    return ConfigError(f"{name} must be {allowed}, got {value!r}. Set {its_flag or flag(name)}.")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Base class of settings: a frozen dataclass that checks its values on construction."""

    def __post_init__(self) -> None:
        for setting in setting_fields(type(self)).values():
            object.__setattr__(self, setting.name, setting.checked(getattr(self, setting.name)))
        self.check()

    def check(self) -> None:
        """Raise ConfigError if values do not go together; a subclass may override it."""

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Self:
        """Return the settings of this class among `values`, by name; other names are ignored."""
        return cls(**{name: values[name] for name in setting_fields(cls) if name in values})


@cache
def setting_fields(cls: type) -> dict[str, Setting]:
    """Return the settings of a class by name, those of its base classes first; raise ConfigError for an odd type."""
    hints = get_type_hints(cls, include_extras=True)
    found = {}
    for field in fields(cls):
        default = field.default_factory() if field.default_factory is not MISSING else field.default
        setting = found[field.name] = described(field.name, hints[field.name], cls, default)
        if setting.item not in ((int, float) if setting.kind is tuple else (bool, int, float, str, dict)):
            raise ConfigError(
                f"{full_name(cls)}.{field.name} has the type {hints[field.name]}, which a setting "
                "cannot have. Use bool, int, float, str, a Literal of names, a tuple of int or float, a dict, or "
                "one of these or None."
            )
    return found


def described(name: str, hint: Any, owner: Any, default: Any = MISSING) -> Setting:
    """Return the description of the field or parameter of `owner` that is annotated by `hint`."""
    kind, notes = _unwrapped(hint)
    is_optional = get_origin(kind) in (Union, UnionType) and NoneType in get_args(kind)
    if is_optional:
        kind, inner = _unwrapped(Union[tuple(each for each in get_args(kind) if each is not NoneType)])  # noqa: UP007
        notes += inner
    item, length = kind, None
    if get_origin(kind) is dict:
        kind = item = dict
    if get_origin(kind) is tuple:
        first, *others = get_args(kind) or (None,)
        item, inner = _unwrapped(first)
        if others != [...]:
            length = 1 + len(others)
            item = item if set(others) <= {first} else None  # several types
        kind, notes = tuple, notes + inner
    if get_origin(kind) is Literal and all(isinstance(name, str) for name in get_args(kind)):
        kind, item, notes = str, str, (*notes, Choices(get_args(kind)))
    types = {"hint": hint, "kind": kind, "item": item, "length": length, "is_optional": is_optional}
    return Setting(name=name, default=default, notes=notes, owner=owner, **types)


def registered(names: Iterable[str]) -> Mapping[str, Any]:
    """Return the registered classes by name, or nothing if `names` is not a registry."""
    return names if isinstance(names, Registry) else {}


def _unwrapped(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    if get_origin(kind) is Annotated:
        inner, notes = _unwrapped(get_args(kind)[0])
        return inner, (*notes, *kind.__metadata__)
    return kind, ()


def _plain(value: Any) -> Any:
    """Return NumPy's numbers and arrays, and lists, as built-in numbers and tuples."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    return tuple(map(_plain, value)) if isinstance(value, list | tuple) else value


@cache
def field_texts(cls: type) -> dict[str, str]:
    """Return the docstrings under the fields of a dataclass and its base classes, which Python discards."""
    texts: dict[str, str] = {}
    for ancestor in reversed(cls.__mro__[:-1]):
        try:
            file = _syntax_tree(inspect.getsourcefile(ancestor) or "")
        except (OSError, TypeError, SyntaxError):  # a class defined in a console has no source
            continue
        own = (each for each in ast.walk(file) if isinstance(each, ast.ClassDef) and each.name == ancestor.__name__)
        for field, below in (pair for each in own for pair in pairwise(each.body)):
            text = below.value if isinstance(below, ast.Expr) else None
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Constant):
                texts[ast.unparse(field.target)] = " ".join(str(text.value).split())
    return texts


@cache
def _syntax_tree(file: str) -> ast.Module:
    return ast.parse("".join(linecache.getlines(file)))


def checked(function: F) -> F:
    """Return `function`, which now checks the arguments whose annotations say what is allowed.

    A call raises as `Setting.checked` does, which also converts the values.
    """
    signature = inspect.signature(function)

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        given = signature.bind(*args, **kwargs)
        for parameter in _parameters(function):
            if parameter.name in given.arguments:
                given.arguments[parameter.name] = parameter.checked(given.arguments[parameter.name])
        return function(*given.args, **given.kwargs)

    return call  # type: ignore[return-value] - of the same signature


@cache
def _parameters(function: Callable[..., Any]) -> list[Setting]:
    every = (described(name, hint, function) for name, hint in get_type_hints(function, include_extras=True).items())
    return [parameter for parameter in every if parameter.notes]
