"""Commands are plain functions: tyro makes their flags from signature and docstring, parses, and calls them.

Parameters without a default are positional, the others are flags. A parameter `settings` stands for the settings of a
run, which become flags unless the command names them itself: in a command that takes an environment all of them, in
another those with which a run can be resumed.
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable, Mapping, Sequence
from types import NoneType
from typing import Annotated, Any, Literal, TypedDict, get_args, get_origin, get_type_hints

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS, GYMNASIUM
from shes.errors import UnknownNameError
from shes.runs.config import TrainConfig
from shes.runs.rooms import known_settings, settings_in
from shes.settings import Setting, flag
from shes.training.presets import PRESETS, make_config
from shes.training.train import resumable_settings

__all__ = ["DEFAULT_ENV", "HELP_ALL", "Checkpoint", "Env", "Json", "Run", "Workers", "call", "offered_settings"]

DEFAULT_ENV = "ant-gather"
"""Environment whose settings the help shows if none is named."""
HELP_ALL = "--help-all"
"""Flag that shows every setting of a run."""

Run = Annotated[str, tyro.conf.arg(metavar="RUN", help="The run folder, or the name of a shipped agent.")]
Env = Annotated[
    str, tyro.conf.arg(metavar="ENV", help="Environment, see shes envs; or gymnasium:ID for one of Gymnasium.")
]
Checkpoint = Annotated[str, tyro.conf.arg(help="Checkpoint: best, last or the number of a generation.")]
Workers = Annotated[
    int,
    tyro.conf.arg(
        name="workers",
        aliases=("--num-workers",),
        help="Worker processes; 0 is one for every core. Does not change results.",
    ),
]
Json = Annotated[bool, tyro.conf.arg(help="Print JSON.")]


def call(function: Callable[..., int], words: Sequence[str]) -> int:
    """Call a command with the values in `words`; return its exit code.

    Raises:
        UnknownNameError: A value is none of the names that it can be.
    """
    program: Any = function
    if "settings" in function.__annotations__:

        def program(**values: Any) -> int:
            return function(**values)

        program.__annotations__ = get_type_hints(function, include_extras=True)
        program.__annotations__["settings"] = Annotated[_settings_type(function, words), tyro.conf.arg(name="")]
        program.__signature__, program.__doc__ = inspect.signature(function), function.__doc__
    try:
        return tyro.cli(
            program,
            prog=f"shes {function.__name__.rstrip('_')}",
            args=["--help"] if _asks_for_help(words) else _with_environment_first(words),
            config=(tyro.conf.OmitArgPrefixes, tyro.conf.PositionalRequiredArgs),
            registry=_VALUES,
        )
    except SystemExit as end:  # help was shown, or an error was printed
        return end.code if isinstance(end.code, int) else 2


def _asks_for_help(words: Sequence[str]) -> bool:
    return not {"-h", "--help", HELP_ALL}.isdisjoint(words)


def offered_settings(function: Callable[..., int], words: Sequence[str]) -> dict[str, Setting]:
    """Return the settings by name that are flags of a command.

    Raises:
        UnknownNameError: There is no such preset or algorithm, or another name is unknown.
    """
    named = function.__annotations__
    if "settings" not in named:
        return {}
    found = settings_in(map(type, _asked_config(words).rooms.values())) if "env" in named else resumable_settings()
    return {name: each for name, each in found.items() if name not in named}


def _settings_type(function: Callable[..., int], words: Sequence[str]) -> Any:
    """Return the type of the parameter `settings`; for the help it has a group for each room, or the everyday one."""
    config = _asked_config(words)
    offered = offered_settings(function, words)
    if not _asks_for_help(words):  # the run says which of the others it does not have
        others = {name: each for name, each in known_settings().items() if name not in function.__annotations__}
        return _group("", {**others, **offered}, config.settings)
    if "env" not in function.__annotations__:
        group = _group("A setting that is not given keeps its value.", offered, {})
        return TypedDict("Settings", {"settings": group})  # type: ignore[misc] - the keys are known at run time only
    if HELP_ALL not in words:
        title = f"Values of preset {config.run.preset} for {config.run.env}. {HELP_ALL} shows all {len(offered)}."
        everyday = {name: each for name, each in offered.items() if each.is_everyday}
        return TypedDict("Settings", {"everyday": _group(title, everyday, config.settings)})
    rooms: dict[str, Any] = {}
    for name, room in config.rooms.items():
        title = (type(room).__doc__ or "").partition("\n")[0]
        own = {each: offered.pop(each) for each in settings_in([type(room)]) if each in offered}  # one may be shared
        rooms[name] = _group("" if title.rstrip(".").lower() == name else title, own, config.settings)
    return TypedDict("Settings", rooms)  # type: ignore[misc] - the keys are known at run time only


def _group(title: str, settings: Mapping[str, Setting], values: Mapping[str, Any]) -> Any:
    """Return a `TypedDict` whose keys tyro makes flags of. Keys that are not given are left out; help has `values`."""
    keys = {
        name: _annotated(each, _shown(values[name]) if name in values else "as before")
        for name, each in settings.items()
        if name != "env"
    }
    group = TypedDict("Settings", keys, total=False)  # type: ignore[misc] - as above
    group.__doc__ = title
    return group


def _annotated(setting: Setting, default: str) -> Any:
    """Return the type of a setting as tyro shows and reads it."""
    choices = tuple(PRESETS) if setting.name == "preset" else setting.choices
    kind: Any = Literal[choices] if choices else tuple[setting.item, ...] if setting.kind is tuple else setting.kind
    aliases = (flag(setting.name),) if setting.flag != flag(setting.name) else None
    shown = tyro.conf.arg(
        name=setting.flag[2:], aliases=aliases, help=setting.text, help_behavior_hint=f"(default: {default})"
    )
    return Annotated[kind | None if setting.is_optional else kind, shown]


def _shown(value: Any) -> str:
    """Return a value as it is written after its flag."""
    if value == ():
        return "none (linear)"  # no hidden layers, the only tuple that may be empty
    return " ".join(map(str, value)) if isinstance(value, tuple) else "none" if value is None else str(value)


def _asked_config(words: Sequence[str]) -> TrainConfig:
    """Return the settings of the environment, preset and algorithm in `words`.

    Raises:
        UnknownNameError: There is no such preset or algorithm; or another setting has an unknown name, which may be why
            one of its flags is unknown, too.
    """
    choosing = {name: each for name, each in known_settings().items() if each.choices or name == "preset"}
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    for name, each in choosing.items():
        parser.add_argument(each.flag, dest=name, nargs="?")
    found = vars(parser.parse_known_args(words)[0]).items()
    given = {name: choosing[name].checked(value) for name, value in found if value is not None}
    place = _find_environment(words)
    env = DEFAULT_ENV if place is None else words[place]
    return make_config(env, given.get("preset", "laptop"), {"algorithm": given.get("algorithm", "shes")})


def _find_environment(words: Sequence[str]) -> int | None:
    """Return the index of the environment in `words`, or None. The value of a flag is no environment."""
    for i, word in enumerate(words):
        before = words[i - 1] if i else ""
        is_value = before.startswith("--") and not before.startswith("--no-") and "=" not in before
        if not is_value and (word in ENVIRONMENTS or word in EXTERNAL_ENVIRONMENTS or word.startswith(GYMNASIUM)):
            return i
    return None


def _with_environment_first(words: Sequence[str]) -> list[str]:
    """Return `words` with the environment before all flags: in `--hidden 4 3 ENV` it would be a value of the flag."""
    moved, place = list(words), _find_environment(words)
    if place is not None:
        first = next((i for i, word in enumerate(words) if word.startswith("-")), place)
        moved.insert(min(first, place), moved.pop(place))
    return moved


_VALUES = ConstructorRegistry()
"""Rules for values that tyro by itself reads otherwise."""


@_VALUES.primitive_rule
def _name_spec(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[str] | None:
    """Read one of several names; the error for an unknown one suggests the nearest."""
    if get_origin(info.type) is not Literal:
        return None
    known: tuple[str, ...] = get_args(info.type)

    def read(words: list[str]) -> str:
        if words[0] not in known:
            raise ValueError(str(UnknownNameError("name", words[0], known)))  # tyro adds the flag
        return words[0]

    return PrimitiveConstructorSpec(1, f"{{{','.join(known)}}}", read, known.__contains__, lambda name: [name])


@_VALUES.primitive_rule
def _none_spec(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[None] | None:
    """Read None as `none`."""
    if info.type is not NoneType:
        return None
    words = ("none", "None")
    return PrimitiveConstructorSpec(1, "none", lambda _: None, lambda it: it is None, lambda _: ["none"], words)
