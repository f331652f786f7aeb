"""How the value of an option is written: what stands for it in the help, and what it is called in an error."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_origin

from shes.cli.options import Option

__all__ = ["described", "metavar", "usage", "written"]

_METAVARS: dict[Any, str] = {
    bool: "true|false",
    int: "INT",
    float: "FLOAT",
    str: "TEXT",
    Path: "PATH",
    NoneType: "none",
}
_ONE: dict[Any, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a word",
    Path: "a path",
    NoneType: "none",
}
_MANY: dict[Any, str] = {int: "whole numbers", float: "numbers", str: "words", Path: "paths"}


def metavar(option: Option) -> str:
    """Return what stands for the value of `option`; nothing for a switch."""
    if option.is_switch:
        return ""
    if option.metavar:
        return f"[{option.metavar} ...]" if option.takes_many and option.flags else option.metavar
    if option.choices:
        names = "{" + ",".join(option.choices) + "}"
        return f"{names}|none" if NoneType in option.kinds else names
    return "|".join(_type_metavar(kind) for kind in option.kinds)


def _type_metavar(kind: Any) -> str:
    items: tuple[Any, ...] = get_args(kind) if get_origin(kind) is tuple else ()
    if items[-1:] == (...,):
        return f"[{_type_metavar(items[0])} ...]"
    return " ".join(_type_metavar(item) for item in items) if items else _METAVARS.get(kind, "VALUE")


def described(option: Option) -> str:
    """Return what the value of `option` must be, in words."""
    return " or ".join(_type_described(kind) for kind in option.kinds)


def _type_described(kind: Any) -> str:
    items = get_args(kind) if get_origin(kind) is tuple else ()
    if items:
        many = _MANY.get(items[0], "values")
        return many if items[-1] is ... else f"{len(items)} {many}"
    return _ONE.get(kind, "a value")


def written(option: Option) -> str:
    """Return an option as the help shows it: `--sigma FLOAT`, `--json`, `ENV`."""
    return " ".join(part for part in (", ".join(option.shown_flags), metavar(option)) if part)


def usage(options: Sequence[Option], command: str) -> str:
    """Return the usage of a command on one line."""
    places = [metavar(option) if option.is_required else f"[{metavar(option)}]" for option in options if option.noun]
    is_open = any(option.flags for option in options)
    return " ".join(["shes", command, *places, *(["[--FLAG VALUE ...]"] if is_open else [])])
