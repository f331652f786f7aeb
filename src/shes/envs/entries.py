"""What a registry takes in: the checks behind `register_environment` and its like in `hierarchy`."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping

from shes.errors import ConfigError

__all__ = ["check_class", "check_name_form", "check_name_is_free"]

_NAME = re.compile(r"[a-z][a-z0-9]*([-_][a-z0-9]+)*")


def check_class(kind: str, cls: object, contract: type, num_arguments: int = 0) -> None:
    """Refuse what is not a complete class that fulfils `contract` and is made from `num_arguments` arguments.

    Raises:
        ConfigError: It is no subclass, lacks a method or a class attribute, or needs other arguments.
    """
    if not (isinstance(cls, type) and issubclass(cls, contract)):
        raise ConfigError(
            f"a {kind} must be a subclass of {_full_name(contract)}, got {cls!r}. "
            f"Write class YourOwn({contract.__name__}), and give the class, not an object of it."
        )
    # A contract states the class attributes that every subclass must set as annotations without a value.
    attributes = [name for name in inspect.get_annotations(contract) if not hasattr(cls, name)]
    missing = [*sorted(getattr(cls, "__abstractmethods__", ())), *attributes]
    if missing:
        raise ConfigError(
            f"{kind} {_full_name(cls)} lacks {', '.join(missing)}. "
            f"{_full_name(contract)} says what each of them is: add them to your class."
        )
    try:
        inspect.signature(cls).bind(*[None] * num_arguments)
    except TypeError as error:
        needed = f"{num_arguments or 'no'} arguments"
        raise ConfigError(
            f"{kind} {_full_name(cls)} must be made from {needed}, and is not: {error}. Change its __init__."
        ) from error


def check_name_form(kind: str, name: object) -> None:
    """Refuse a name that is none.

    Raises:
        ConfigError: It is malformed.
    """
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise ConfigError(
            f"{kind} name must be lower-case words of letters and digits, joined by - or _, got {name!r}. "
            "For example: 'my-own-2'."
        )


def check_name_is_free(
    kind: str, name: object, entry: type | tuple[type, ...], registry: Mapping[str, type | tuple[type, ...]]
) -> None:
    """Refuse a name that is none, or that stands for another class (or several) than `entry` in `registry`.

    Raises:
        ConfigError: It is malformed or taken.
    """
    check_name_form(kind, name)
    assert isinstance(name, str)
    # By full name, not by identity: a notebook's cell that is run again, or a reload, makes the same class anew.
    if name in registry and _full_name(registry[name]) != _full_name(entry):
        raise ConfigError(f"{kind} {name!r} is {_full_name(registry[name])} already. Choose another name.")


def _full_name(entry: type | tuple[type, ...]) -> str:
    classes = entry if isinstance(entry, tuple) else (entry,)
    return " with ".join(f"{cls.__module__}.{cls.__qualname__}" for cls in classes)
