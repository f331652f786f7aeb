"""Commands are plain functions: tyro makes their flags from signature and docstring, and parses the command line.

Two parameters have a special meaning. `settings` stands for the settings of a run, which become flags, one group per
room. `**options` annotated with a function stands for those parameters of that function that the command does not name.
"""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Callable, Iterable, Sequence
from types import NoneType
from typing import Annotated, Any, Literal, TypedDict, get_args, get_origin, get_type_hints

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS, GYMNASIUM
from shes.errors import ConfigError
from shes.runs.config import TrainConfig
from shes.runs.rooms import known_settings
from shes.settings import Setting, Unasked, flag, setting_fields
from shes.training.presets import PRESETS, make_config
from shes.training.train import check_resumable, resumable_settings

__all__ = ["DEFAULT_ENV", "Checkpoint", "Env", "ExecutionFlags", "Json", "Run", "VariedSettings"]
__all__ += ["asked_config", "call", "program_of"]

DEFAULT_ENV = "ant-gather"
"""Environment whose settings the help shows if none is named."""
_ALL = "--help-all"
_CONFIG = (tyro.conf.OmitArgPrefixes,)

Run = Annotated[
    str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN", help="The run folder, or the name of a shipped agent.")
]
Env = Annotated[
    str,
    tyro.conf.Positional,
    tyro.conf.arg(metavar="ENV", help="Environment, see shes envs; or gymnasium:ID for one of Gymnasium."),
]
Checkpoint = Annotated[str, tyro.conf.arg(help="Checkpoint: best, last or the number of a generation.")]
Json = Annotated[bool, tyro.conf.arg(help="Print JSON.")]


class ExecutionFlags(dict[str, Any]):
    """Settings by name that `shes resume` takes: the annotation of a parameter `settings`."""


class VariedSettings(dict[str, Any]):
    """Settings by name of which `seed` has several values: the annotation of a parameter `settings`."""


def call(function: Callable[..., int], words: Sequence[str]) -> int:
    """Call a command with the values in `words`; return its exit code.

    Raises:
        ConfigError: A flag is a setting that the run does not have, or that `shes resume` does not take.
        UnknownNameError: There is no such preset or algorithm.
    """
    program = program_of(function, words)
    own = inspect.signature(function).parameters.keys()
    if "settings" in own:
        _check_flags(function, words)
    args = ["--help" if word == _ALL else word for word in words]
    name = function.__name__.rstrip("_")
    try:
        values = tyro.cli(program, prog=f"shes {name}", args=args, config=_CONFIG, registry=_VALUES)
    except SystemExit as end:  # help was shown, or an error was printed
        return end.code if isinstance(end.code, int) else 2
    if "settings" in own:
        rooms = [name for name in values if name not in own or name == "settings"]
        values["settings"] = {name: value for room in rooms for name, value in values.pop(room).items()}
    return function(**values)


def program_of(function: Callable[..., int], words: Sequence[str] = ()) -> Callable[..., Any]:
    """Return the function that tyro parses for a command: it returns the values that it is called with.

    The environment, preset and algorithm in the command line `words` decide which settings it has.
    """
    parameters = dict(inspect.signature(function).parameters)
    hints = get_type_hints(function, include_extras=True)
    text = inspect.getdoc(function) or ""
    if parameters.pop("options", None):
        _, behind = get_args(hints.pop("options"))
        parameters = {**inspect.signature(behind).parameters, **parameters}
        hints = {**get_type_hints(behind, include_extras=True), **hints}
        text += "\n\nArgs:\n" + (inspect.getdoc(behind) or "").partition("Args:\n")[2].partition("\n\n")[0]
    if parameters.pop("settings", None):
        rooms = _rooms(function, words, hints.pop("settings"))
        hints |= rooms
        parameters |= {name: inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY) for name in rooms}

    def program(**values: Any) -> dict[str, Any]:
        return values

    kind = inspect.Parameter.KEYWORD_ONLY
    listed = [each.replace(annotation=hints[name], kind=kind) for name, each in parameters.items()]
    program.__signature__ = inspect.Signature(listed)  # type: ignore[attr-defined] - inspect and tyro read it
    program.__annotations__ = {name: hints[name] for name in parameters}
    program.__doc__ = text
    return program


def _rooms(function: Callable[..., int], words: Sequence[str], kind: Any) -> dict[str, Any]:
    """Return a `TypedDict` for each room of settings; for `--help` one for the everyday settings."""
    if kind is ExecutionFlags:
        return {"settings": _room("A setting that is not given keeps its value.", resumable_settings().values(), None)}
    config = asked_config(function, words)
    if not {"-h", "--help"}.isdisjoint(words):
        everyday = [each for each in map(config.setting, config.settings) if each.is_everyday]
        title = f"Values of preset {config.run.preset} for {config.run.env}. {_ALL} shows all {len(config.settings)}."
        return {"everyday": _room(title, everyday, config, kind)}
    rooms: dict[str, Any] = {}
    seen: set[str] = set()  # a task may share a setting with the hierarchy
    for name, room in config.rooms.items():
        settings = setting_fields(type(room))
        title = (type(room).__doc__ or "").partition("\n")[0]
        title = "" if title.rstrip(".").lower() == name else title  # the group's heading has the name
        rooms[name] = _room(title, [each for each in settings.values() if each.name not in seen], config, kind)
        seen |= settings.keys()
    return rooms


def _room(title: str, settings: Iterable[Setting], config: TrainConfig | None, kind: Any = None) -> Any:
    """Return a `TypedDict` whose keys tyro makes flags of: those that are not given are left out.

    The help shows the values of `config` as defaults.
    """
    keys = {
        each.name: _annotated(each, "as before" if config is None else _shown(config.settings[each.name]))
        for each in settings
        if each.name != "env" and not each.has(Unasked)
    }
    if "seed" in keys and kind is VariedSettings:
        keys["seed"] = _several(keys["seed"])
    room = TypedDict("Settings", keys, total=False)  # type: ignore[misc] - the keys are known at run time only
    room.__doc__ = title
    return room


def _annotated(setting: Setting, default: str) -> Any:
    """Return the type of a setting as tyro shows and reads it."""
    choices = tuple(PRESETS) if setting.name == "preset" else setting.choices
    kind: Any = Literal[choices] if choices else tuple[setting.item, ...] if setting.kind is tuple else setting.kind
    aliases = (flag(setting.name),) if setting.flag != flag(setting.name) else None
    shown = tyro.conf.arg(
        name=setting.flag[2:], aliases=aliases, help=setting.text, help_behavior_hint=f"(default: {default})"
    )
    return Annotated[kind | None if setting.is_optional else kind, shown]


def _several(kind: Any) -> Any:
    """Return the type of one or more values of a setting of type `kind`."""
    item, *notes = get_args(kind)
    return Annotated[(tuple[item, ...], *notes)]


def _shown(value: Any) -> str:
    """Return a value as it is written after its flag."""
    if value == ():
        return "none (linear)"  # no hidden layers, the only tuple that may be empty
    return " ".join(map(str, value)) if isinstance(value, tuple) else "none" if value is None else str(value)


_VALUES = ConstructorRegistry()
"""Rules for values that tyro by itself reads otherwise."""


@_VALUES.primitive_rule
def _name_spec(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[str] | None:
    """Read one of several names; the error for an unknown one suggests the nearest."""
    if get_origin(info.type) is not Literal:
        return None
    known: tuple[str, ...] = get_args(info.type)

    def read(words: list[str]) -> str:
        if words[0] in known:
            return words[0]
        close = difflib.get_close_matches(words[0], known, n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        raise ValueError(f"unknown name {words[0]!r}.{hint} Known: {', '.join(known)}.")

    return PrimitiveConstructorSpec(1, f"{{{','.join(known)}}}", read, known.__contains__, lambda name: [name])


@_VALUES.primitive_rule
def _none_spec(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[None] | None:
    """Read None as `none`."""
    if info.type is not NoneType:
        return None
    words = ("none", "None")
    return PrimitiveConstructorSpec(1, "none", lambda _: None, lambda it: it is None, lambda _: ["none"], words)


def _check_flags(function: Callable[..., int], words: Sequence[str]) -> None:
    """Check that all flags of settings are settings of the run.

    Raises:
        ConfigError: One is not.
    """
    names = {each.flag: name for name, each in known_settings().items() if name != "env"}
    flags = [word.partition("=")[0].replace("_", "-").replace("--no-", "--") for word in words]
    given = [names[each] for each in flags if each in names]
    if get_type_hints(function)["settings"] is ExecutionFlags:
        check_resumable(given)
        return
    config = asked_config(function, words)
    for name in given:
        if name not in config.settings:
            raise ConfigError(
                f"{name} is not a setting of a run of {config.run.env} with algorithm {config.run.algorithm!r}. "
                f"Omit {known_settings()[name].flag}."
            )


def asked_config(function: Callable[..., int], words: Sequence[str]) -> TrainConfig:
    """Return the settings of the environment, preset and algorithm in `words`.

    Raises:
        UnknownNameError: There is no such preset or algorithm.
    """
    given, others = _single_values(function, words)
    known = {*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS}
    env = next((word for word in others if word in known or word.startswith(GYMNASIUM)), DEFAULT_ENV)
    return make_config(env, given.get("--preset", "laptop"), {"algorithm": given.get("--algorithm", "shes")})


def _single_values(function: Callable[..., int], words: Sequence[str]) -> tuple[dict[str, str], list[str]]:
    """Return the values in `words` of flags that take one, and the words that are neither flags nor such values."""
    flags = _flags_of_one_value(function)
    given: dict[str, str] = {}
    others: list[str] = []
    last = ""
    for word in words:
        name, equals, value = word.partition("=")
        name = name.replace("_", "-")
        if last:
            given[last], last = word, ""
        elif name in flags and equals:
            given[name] = value
        elif name in flags:
            last = name
        elif not word.startswith("-"):
            others.append(word)
    return given, others


def _flags_of_one_value(function: Callable[..., int]) -> set[str]:
    """Return the flags of a command that take one value, those of the settings of every run included.

    Flags of several values are not needed: their values are numbers or `NAME=VALUE`, never an environment's name, and
    the environment may follow them.
    """
    settings = [
        each
        for each in known_settings().values()
        if each.kind is not tuple and (each.is_optional or each.kind is not bool)
    ]
    found = {text for each in settings for text in (each.flag, flag(each.name))}
    own = get_type_hints(function).items()
    found |= {flag(name) for name, kind in own if get_origin(kind) is not tuple and kind is not bool}
    return found - {flag("env")}
