"""Words of a command line become values: tyro reads them, every error is ours."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, make_dataclass, replace
from types import NoneType
from typing import Annotated, Any

import tyro
from tyro.constructors import (
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    UnsupportedTypeAnnotationError,
)

from shes.cli.options import Option
from shes.cli.values import described, metavar, usage
from shes.errors import ConfigError

__all__ = ["flag_of", "parse"]

_NOT_GIVEN = object()


@dataclass(frozen=True)
class _Wrong:
    """Words that are no value of their option."""

    words: list[str]


def parse(
    options: Sequence[Option],
    words: Sequence[str],
    command: str,
    explain_unknown: Callable[[str], str | None] | None = None,
) -> dict[str, Any]:
    """Return the values that `words` give to `options`, by name; what is not given is left out.

    Args:
        options: What there is.
        words: The command line after the command.
        command: The command's name.
        explain_unknown: Returns a better message for a flag that there is not.

    Raises:
        ConfigError: A flag is unknown or has no value, a value has the wrong type, or a word is missing or too many.
    """
    prepared = _prepare(options, words, command, explain_unknown)
    shape = make_dataclass("Words", [_field(option) for option in options], kw_only=True)
    try:
        found, rest = tyro.cli(
            shape, prog="shes", args=prepared, return_unknown_args=True, add_help=False, console_outputs=False
        )
    except SystemExit as error:  # flags and their values are in order: what remains is a positional that is missing
        raise _missing(options, command) from error
    if rest:
        raise ConfigError(f"{rest[0]!r} is one word too many. Usage: {usage(options, command)}. {_next(command)}")
    values = {name: value for name, value in vars(found).items() if value is not _NOT_GIVEN}
    for option in options:
        value = values.get(option.name)
        if isinstance(value, _Wrong):
            name, got = (option.flags or (metavar(option),))[0], " ".join(value.words)
            raise ConfigError(f"{name} takes {described(option)}, got {got!r}. {_next(command)}")
    return values


def flag_of(word: str) -> str | None:
    """Return the flag that `word` is or begins with, with hyphens; None if it is none, as -0.1 is not."""
    name = word.partition("=")[0]
    is_flag = name.startswith("-") and name.lstrip("-")[:1].isalpha() and name.lower() not in ("-inf", "-nan")
    return name.replace("_", "-") if is_flag else None


def _next(command: str) -> str:
    return f"`shes {command} --help` explains it."


def _prepare(
    options: Sequence[Option], words: Sequence[str], command: str, explain_unknown: Callable[[str], str | None] | None
) -> list[str]:
    """Return `words` with every flag in its first form and a value for every switch; refuse what is no flag."""
    by_flag = {spelling: option for option in options for spelling in option.spellings}
    prepared: list[str] = []
    for index, word in enumerate(words):
        if word == "--":  # what follows are no flags
            return [*prepared, *words[index:]]
        flag = flag_of(word)
        if flag is None:
            prepared.append(word)
            continue
        if flag not in by_flag:
            explained = explain_unknown(flag) if explain_unknown else None
            raise ConfigError(explained or _unknown(flag, by_flag, command))
        option, follower = by_flag[flag], words[index + 1 : index + 2]
        name, equals, value = option.flags[0], *word.partition("=")[1:]
        if option.is_switch and equals:
            raise ConfigError(f"{flag} takes no value, got {word}. Write {name} or --no-{name[2:]}. {_next(command)}")
        if option.is_switch:
            prepared.append(f"{name}={not flag.startswith('--no-')}")
        elif not equals and not option.takes_many and (not follower or flag_of(follower[0]) or follower[0] == "--"):
            raise ConfigError(f"{flag} needs a value: {flag} {metavar(option)}. {_next(command)}")
        else:
            prepared.append(name + equals + value)
    return prepared


def _unknown(flag: str, by_flag: Mapping[str, Option], command: str) -> str:
    """Return what to say of a flag that there is not, with the one that was meant."""
    longer = [known for known in by_flag if known.startswith(flag)]
    close = longer[:1] or difflib.get_close_matches(flag, by_flag, n=1)
    hint = f" Did you mean {close[0]}?" if close else ""
    return f"unknown flag {flag}.{hint} `shes {command} --help` lists the flags."


def _missing(options: Sequence[Option], command: str) -> ConfigError:
    """Return the error for a positional that is not there."""
    option = next(option for option in options if option.is_required)
    known = f" {metavar(option)}: {', '.join(option.choices)}." if option.choices else ""
    example = option.choices[0] if option.choices else metavar(option)
    return ConfigError(f"shes {command} needs {option.noun} first: shes {command} {example}.{known} {_next(command)}")


def _field(option: Option) -> tuple[str, Any, Any] | tuple[str, Any]:
    """Return the field that tyro reads `option` into."""
    kind: Any = Annotated[Any, _constructor(option)]
    kind = tyro.conf.Positional[kind] if option.noun else Annotated[kind, tyro.conf.arg(name=option.flags[0][2:])]
    return (option.name, kind) if option.is_required else (option.name, kind, _NOT_GIVEN)


def _constructor(option: Option) -> PrimitiveConstructorSpec[Any]:
    """Return tyro's way to read the option's type, but for its errors: they become a `_Wrong`."""
    spec = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(option.kind, set()))
    assert not isinstance(spec, UnsupportedTypeAnnotationError), f"tyro cannot read {option.name}: {option.kind}"

    def read(words: list[str]) -> Any:
        if NoneType in option.kinds and [word.lower() for word in words] == ["none"]:
            return None
        try:
            # Python's True and False are people's true and false.
            return spec.instance_from_str([word.capitalize() for word in words] if bool in option.kinds else words)
        except ValueError:
            return _Wrong(words)

    return replace(spec, choices=None, instance_from_str=read)
