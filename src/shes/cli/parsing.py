"""A command is a plain function: tyro makes its flags from its signature and docstring, and calls it.

A parameter `settings` stands for settings of a run, by name; they become flags, a group for each room.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Container, Sequence
from dataclasses import field, make_dataclass
from typing import Annotated, Any, Literal, get_type_hints

import tyro

from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS, GYMNASIUM
from shes.errors import ConfigError
from shes.runs.config import TrainConfig, execution_settings, known_settings
from shes.settings import Setting, Unasked, flag, setting_fields
from shes.training.presets import PRESETS, make_config

__all__ = ["DEFAULT_ENV", "call", "program_of"]

DEFAULT_ENV = "ant-gather"
"""Environment whose settings the help shows where none is named."""
_POSITIONAL = ("env",)
_ALL = "--help-all"
_METAVARS: dict[Any, str] = {int: "INT", float: "FLOAT", str: "TEXT"}


def call(function: Callable[..., int], words: Sequence[str]) -> int:
    """Call a command with the values that `words` give; return its exit code."""
    name = function.__name__.rstrip("_")
    words = _spelled(words)
    is_short = "--help" in words or "-h" in words
    if "settings" in inspect.signature(function).parameters:
        _refuse_other_settings(function, words)
    program = program_of(function, words, is_short=is_short)
    words = ["--help" if word == _ALL else word for word in words]
    try:
        values = tyro.cli(program, prog=f"shes {name}", args=words, config=(tyro.conf.OmitArgPrefixes,))
    except SystemExit as end:  # help was shown, or an error was printed
        return end.code if isinstance(end.code, int) else 2
    return function(**_gathered(values, words) if "settings" in inspect.signature(function).parameters else values)


def program_of(function: Callable[..., int], words: Sequence[str], *, is_short: bool = False) -> Callable[..., Any]:
    """Return a function that returns the values it is called with: what tyro is to parse for a command."""
    parameters = dict(inspect.signature(function).parameters)
    hints = get_type_hints(function, include_extras=True)
    rooms: dict[str, Any] = {}
    if parameters.pop("settings", None) is not None:
        rooms = _resumed_rooms() if hints["settings"] is ExecutionFlags else _rooms(_asked_config(words), is_short)

    def program(**values: Any) -> dict[str, Any]:
        return values

    kinds = {name: hints[name] for name in parameters}
    listed = [each.replace(annotation=kinds[name]) for name, each in parameters.items()]
    for name, default in rooms.items():
        kinds[name] = type(default)
        factory = inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=type(default))
        listed.append(factory)
    program.__signature__ = inspect.Signature(listed)  # type: ignore[attr-defined] - inspect and tyro read it
    program.__annotations__ = kinds
    program.__doc__ = function.__doc__
    return program


class ExecutionFlags(dict[str, Any]):
    """Settings by name that `shes resume` takes: annotates a parameter `settings`."""


def _rooms(config: TrainConfig, is_short: bool) -> dict[str, Any]:
    """Return an object for each room of `config`, whose fields become flags; its everyday settings in one group."""
    if not is_short:
        seen: set[str] = set()  # a task may share a setting with the hierarchy
        rooms: dict[str, Any] = {}
        for name, room in config.rooms.items():
            settings = setting_fields(type(room))
            rooms[name] = _flags(_title(room), [each for each in settings.values() if each.name not in seen], config)
            seen |= settings.keys()
        return rooms
    everyday = [config.setting(name) for name in config.settings if config.setting(name).is_everyday]
    title = (
        f"Values are those of preset {config.run.preset} for {config.run.env}. {_ALL} shows all "
        f"{len(config.settings)} settings."
    )
    return {"everyday": _flags(title, everyday, config)}


def _resumed_rooms() -> dict[str, Any]:
    config = TrainConfig.of(env=DEFAULT_ENV)
    taken = [each for name, each in execution_settings().items() if name != "preset"]
    return {"settings": _flags("What is not given stays as it is.", taken, config, hint="(default: as before)")}


def _title(room: Any) -> str:
    return (type(room).__doc__ or "").partition("\n")[0]


def _flags(title: str, settings: Any, config: TrainConfig, hint: str | None = None) -> Any:
    """Return an object of a dataclass whose fields tyro makes flags of; its values are those of `config`."""
    made = [
        (each.name, _kind(each, hint), field(default=config.settings[each.name]))
        for each in settings
        if each.name not in _POSITIONAL and not each.has(Unasked)
    ]
    cls = make_dataclass("Flags", made, kw_only=True)
    cls.__doc__ = title
    return cls()


def _kind(setting: Setting, hint: str | None) -> Any:
    """Return the type of a setting as tyro shows and reads it."""
    choices = tuple(PRESETS) if setting.name == "preset" else setting.choices
    kind: Any = Literal[choices] if choices else setting.kind
    if setting.kind is tuple:
        kind = tuple[setting.item, ...]
    if setting.is_optional:
        kind = kind | None
    aliases = (flag(setting.name),) if setting.flag != flag(setting.name) else None
    metavar = None
    if setting.is_optional and setting.item in _METAVARS:
        metavar = f"{_METAVARS[setting.item]}{' ...' if setting.kind is tuple else ''}|none"
    return Annotated[
        kind,
        tyro.conf.arg(
            name=setting.flag[2:], aliases=aliases, metavar=metavar, help=setting.text, help_behavior_hint=hint
        ),
    ]


def _refuse_other_settings(function: Callable[..., int], words: Sequence[str]) -> None:
    """Refuse flags that are settings, but none of the run that the other words ask for.

    Raises:
        ConfigError: There is one.
    """
    is_resume = get_type_hints(function)["settings"] is ExecutionFlags
    config = None if is_resume else _asked_config(words)
    taken = execution_settings() if config is None else config.settings
    flags = {each.flag: name for name, each in known_settings().items()}
    for word in words:
        shown = word.partition("=")[0]
        name = flags.get(shown) or flags.get(shown.replace("--no-", "--"))
        if name is None or name in taken or name in _POSITIONAL:
            continue
        if config is None:
            allowed = ", ".join(sorted(each.flag for each in execution_settings().values() if each.name != "preset"))
            raise ConfigError(
                f"{shown} would change the numbers of the run; resume takes {allowed}. Start another run to change it."
            )
        raise ConfigError(
            f"{name} is no setting of a run of {config.run.env} with algorithm {config.run.algorithm!r}. "
            f"Leave {shown} away."
        )


def _gathered(values: dict[str, Any], words: Sequence[str]) -> dict[str, Any]:
    """Return the values of a command, the settings that were given under `settings`."""
    given = {word.partition("=")[0].replace("--no-", "--") for word in words if word.startswith("--")}
    settings: dict[str, Any] = {}
    rest: dict[str, Any] = {}
    for name, value in values.items():
        if type(value).__name__ != "Flags":
            rest[name] = value
            continue
        known = {each: known_settings().get(each) for each in vars(value)}
        settings |= {
            each: vars(value)[each]
            for each, setting in known.items()
            if given & {flag(each), setting.flag if setting else ""}
        }
    return {**rest, "settings": settings}


def _asked_config(words: Sequence[str]) -> TrainConfig:
    """Return the settings that the flags are made of: those of environment, preset and algorithm among `words`.

    Raises:
        UnknownNameError: There is no such preset or algorithm.
    """
    env = next((word for word in words if _is_environment(word, (*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS))), DEFAULT_ENV)
    given = {"--preset": "laptop", "--algorithm": "shes"}
    for word, follower in zip(words, [*words[1:], ""], strict=False):
        name, equals, value = word.partition("=")
        if name in given and (value or follower):
            given[name] = value if equals else follower
    return make_config(env, given["--preset"], {"algorithm": given["--algorithm"]})


def _is_environment(word: str, known: Container[str]) -> bool:
    return word in known or word.startswith(GYMNASIUM)


def _spelled(words: Sequence[str]) -> list[str]:
    """Return words as tyro spells them: `--a_b none` is `--a-b None`, but where `none` is one of the names."""
    named = {each.flag for each in known_settings().values() if "none" in each.choices}
    spelled: list[str] = []
    last = ""
    for word in words:
        name, equals, value = word.partition("=") if word.startswith("--") else ("", "", word)
        last = name.replace("_", "-") or last
        value = "None" if value == "none" and last not in named else value
        spelled.append((last if name else "") + equals + value)
    return spelled
