"""A registry: entries of one kind by name, to which users can add their own."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from types import FunctionType
from typing import TypeVar

from shes.errors import ConfigError, UnknownNameError

T = TypeVar("T")

_NAME = re.compile(r"[a-z][a-z0-9]*([-_][a-z0-9]+)*")


class Registry(dict[str, T]):
    """Entries of one kind by name. `registry[name] = entry` is `registry.register(name, entry)`."""

    def __init__(self, kind: str, entries: Mapping[str, T], *, fix: str, check: Callable[[str, T], None]) -> None:
        """Create a registry with `entries`.

        Args:
            kind: Kind of the entries in messages, e.g. `goal encoding`.
            entries: Initial entries by name.
            fix: Advice for an unknown name.
            check: Raises ConfigError for an invalid entry, given `kind` and the entry.
        """
        super().__init__()
        self.kind, self._fix, self._check = kind, fix, check
        for name, entry in entries.items():
            self.register(name, entry)

    def register(self, name: str, entry: T) -> None:
        """Add `entry` as `name`; raise ConfigError if it is invalid, or the name is malformed or already taken.

        A class or function with the full name of the existing entry replaces it.
        """
        self._check(self.kind, entry)
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise ConfigError(
                f"{self.kind} name must be lower-case words of letters and digits, joined by - or _, got {name!r}. "
                "For example: 'my-own-2'."
            )
        # Compared by full name, because running a notebook cell again, or a reload, redefines the same class.
        if name in self and full_name(self[name]) != full_name(entry):
            raise ConfigError(f"{self.kind} {name!r} is {full_name(self[name])} already. Choose another name.")
        super().__setitem__(name, entry)

    __setitem__ = register

    def find(self, name: str) -> T:
        """Return the entry called `name`, or raise UnknownNameError, which lists the known names, the nearest first."""
        if name not in self:
            raise UnknownNameError(self.kind, str(name), self, self._fix)
        return self[name]


def check_class(kind: str, cls: object, contract: type, num_arguments: int = 0, keywords: tuple[str, ...] = ()) -> None:
    """Raise ConfigError unless `cls` is a complete subclass of `contract`, made with `num_arguments` and `keywords`."""
    if not (isinstance(cls, type) and issubclass(cls, contract)):
        article = "an" if kind[0] in "aeiou" else "a"
        raise ConfigError(
            f"{article} {kind} must be a subclass of {full_name(contract)}, got {cls!r}. "
            f"Write class YourOwn({contract.__name__}), and give the class, not an object of it."
        )
    # Annotations without a value in a contract are class attributes that every subclass must set.
    set_by_init = getattr(contract, "__dataclass_fields__", {})
    stated = [name for name in inspect.get_annotations(contract) if name not in set_by_init]
    attributes = [name for name in stated if not hasattr(cls, name)]
    missing = [*sorted(getattr(cls, "__abstractmethods__", ())), *attributes]
    if missing:
        raise ConfigError(
            f"{kind} {full_name(cls)} lacks {', '.join(missing)}. "
            f"{full_name(contract)} says what each of them is: add them to your class."
        )
    try:
        inspect.signature(cls).bind(*[None] * num_arguments, **dict.fromkeys(keywords))
    except TypeError as error:
        given = [f"{num_arguments or 'no'} argument{'s' * (num_arguments != 1)}", *keywords]
        raise ConfigError(
            f"{kind} {full_name(cls)} cannot be constructed with {' and '.join(given)}: {error}. Change its __init__."
        ) from error


def check_function(kind: str, function: object) -> None:
    """Raise ConfigError unless `function` is one."""
    if isinstance(function, type) or not callable(function):
        raise ConfigError(f"a {kind} must be a function, got {function!r}. `docs/extending.md` says of what.")


def full_name(entry: object) -> str:
    """Return the module and the name of a class or function, or of those in a tuple; otherwise the `repr`."""
    if isinstance(entry, tuple):
        return " with ".join(full_name(part) for part in entry)
    return f"{entry.__module__}.{entry.__qualname__}" if isinstance(entry, type | FunctionType) else repr(entry)
