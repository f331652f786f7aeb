"""Commands are plain functions: tyro makes their flags from signature and docstring, parses, and calls them.

Parameters without a default are positional, the others are flags. `**options` annotated with the name of a function
stands for those parameters of that function that the command does not name. A parameter `settings` stands for the
settings of a run, which become flags unless the command names them itself: in a command that takes an environment all
of them, in another those with which a run can be resumed.
"""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Callable, Mapping, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypedDict, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

import shes
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS, GYMNASIUM
from shes.errors import UnknownNameError
from shes.runs.config import TrainConfig
from shes.runs.rooms import known_settings, settings_in
from shes.settings import Setting, flag
from shes.training.presets import PRESETS, make_config
from shes.training.train import resumable_settings

__all__ = ["DEFAULT_ENV", "Env", "Json", "Run", "asked_config", "call", "offered_settings", "parameters_of"]

DEFAULT_ENV = "ant-gather"
"""Environment whose settings the help shows if none is named."""
_HELP_ALL = "--help-all"

_OTHER_FLAGS = {"num_workers": "workers", "checkpoints": "checkpoint"}
"""Flags of parameters that have another name in Python, which is a flag, too."""

Run = Annotated[str, tyro.conf.arg(metavar="RUN", help="The run folder, or the name of a shipped agent.")]
Env = Annotated[
    str, tyro.conf.arg(metavar="ENV", help="Environment, see shes envs; or gymnasium:ID for one of Gymnasium.")
]
Json = Annotated[bool, tyro.conf.arg(help="Print JSON.")]


def call(function: Callable[..., int], words: Sequence[str]) -> int:
    """Call a command with the values in `words`; return its exit code.

    Raises:
        UnknownNameError: A value is none of the names that it can be.
    """

    def program(**values: Any) -> int:
        return function(**values)

    parameters = parameters_of(function)
    if "settings" in parameters:
        kind = Annotated[_settings_type(function, words), tyro.conf.arg(name="")]
        parameters["settings"] = parameters["settings"].replace(annotation=kind)
    program.__annotations__ = {name: each.annotation for name, each in parameters.items()}
    program.__signature__ = inspect.Signature(list(parameters.values()))  # type: ignore[attr-defined] - tyro reads it
    program.__doc__ = _text(function)
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


def parameters_of(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the parameters of a command by name, as tyro reads them."""
    found: dict[str, inspect.Parameter] = {}
    for name, each in inspect.signature(function, eval_str=True).parameters.items():
        if each.kind is inspect.Parameter.VAR_KEYWORD:
            found = {**parameters_of(_behind(each)), **found}
        elif not name.startswith("on_"):  # a callback
            kind = _read_as(each.annotation)
            if name in _OTHER_FLAGS:
                kind = Annotated[kind, tyro.conf.arg(name=_OTHER_FLAGS[name], aliases=(flag(name),))]
            elif kind is str and each.default is each.empty:
                kind = Annotated[kind, tyro.conf.arg(metavar=name.upper())]
            found[name] = each.replace(annotation=kind, kind=inspect.Parameter.KEYWORD_ONLY)
    return found


def _read_as(kind: Any) -> Any:
    """Return the type as which the command line reads a parameter of type `kind`: text where text will do."""
    kinds = get_args(kind) if isinstance(kind, UnionType) else ()
    if str not in kinds:
        return kind
    if any(get_origin(each) is Sequence for each in kinds):
        return tuple[str, ...]
    return str | None if NoneType in kinds else str


def _behind(options: inspect.Parameter) -> Callable[..., Any]:
    """Return the function for whose parameters `**options` stands."""
    module, _, name = options.annotation.__metadata__[0].rpartition(".")
    return getattr(shes.import_module(module), name)


def _text(function: Callable[..., Any]) -> str:
    """Return the docstring of a command, with the arguments of the function for which `**options` stands."""
    text, options = inspect.getdoc(function) or "", inspect.signature(function, eval_str=True).parameters.get("options")
    if options is not None:
        behind = inspect.getdoc(_behind(options)) or ""
        text += f"\n\nArgs:\n{behind.partition('Args:')[2].partition('Raises:')[0]}"
    return text.replace("`", "")


def _asks_for_help(words: Sequence[str]) -> bool:
    return not {"-h", "--help", _HELP_ALL}.isdisjoint(words)


def offered_settings(function: Callable[..., int], config: TrainConfig) -> dict[str, Setting]:
    """Return the settings by name that are flags of a command on a run like `config`."""
    named = parameters_of(function)
    if "settings" not in named:
        return {}
    found = settings_in(map(type, config.rooms.values())) if "env" in named else resumable_settings()
    return {name: each for name, each in found.items() if name not in named}


def _settings_type(function: Callable[..., int], words: Sequence[str]) -> Any:
    """Return the type of the parameter `settings`; for the help it has a group for each room, or the everyday one."""
    config = asked_config(words)
    offered, named = offered_settings(function, config), function.__annotations__
    if not _asks_for_help(words):  # the run says which of the others it does not have
        others = {name: each for name, each in known_settings().items() if name not in named}
        return _group("", {**others, **offered}, config.settings)
    groups: dict[str, Any] = {}
    if "env" not in named:
        groups["settings"] = _group("A setting that is not given keeps its value.", offered, {})
    elif _HELP_ALL not in words:
        title = f"Values of preset {config.run.preset} for {config.run.env}. {_HELP_ALL} shows all {len(offered)}."
        everyday = {name: each for name, each in offered.items() if each.is_everyday}
        groups["everyday"] = _group(title, everyday, config.settings)
    else:
        for name, room in config.rooms.items():
            title = (type(room).__doc__ or "").partition("\n")[0]
            own = {each: offered.pop(each) for each in settings_in([type(room)]) if each in offered}  # may be shared
            groups[name] = _group("" if title.rstrip(".").lower() == name else title, own, config.settings)
    return TypedDict("Settings", groups)  # type: ignore[misc] - the keys are known at run time only


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


def asked_config(words: Sequence[str]) -> TrainConfig:
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
    return make_config(
        env, given.get("preset", "laptop"), {name: given[name] for name in ("algorithm",) if name in given}
    )


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
