"""Commands are plain functions: tyro makes their flags from signature and docstring, parses, and calls them.

Parameters without a default are positional, and so are the first one and an environment; the others are flags. A
parameter `settings` stands for the settings of a run, which become flags unless the command names them itself: in a
command that takes an environment all of them, in another those with which a run can be resumed. A command returns what
is printed: a listing, or an object that has one, which `--json` prints as JSON; or the paths of files that it has
written.
"""

from __future__ import annotations

import inspect
import json
import re
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from itertools import pairwise
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypedDict, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from shes.cli.program import COMMANDS, find_command
from shes.console import LineConsole
from shes.envs.named_environments import (
    ENVIRONMENTS,
    EXTERNAL_ENVIRONMENTS,
    GYMNASIUM,
    ROBOT_ENVIRONMENTS,
    find_environment,
)
from shes.errors import ConfigError
from shes.runs.config import TrainConfig, by_name, known_settings, resumable_settings, settings_by_section
from shes.runs.make_config import make_config, transferred_levels
from shes.runs.progress_display import drawing_progress
from shes.settings import Setting, Shown, flag, setting_fields
from shes.types import Listing

DEFAULT_ENV = "ant-gather"
"""Environment whose settings the help shows if none is named."""
_HELP_ALL = "--help-all"
_HELP = {"-h", "--help", _HELP_ALL}
_WRITES = {"plot": "Learning curves", "report": "Report", "render": "Video", "export": "Policy"}  # into files
_CONFIG = (tyro.conf.OmitArgPrefixes, tyro.conf.PositionalRequiredArgs)
_VALUES = ConstructorRegistry()
"""Rules for values that tyro by itself reads otherwise."""


def call(name: str, function: Callable[..., Any], words: Sequence[str]) -> int:
    """Call command `name` with the values in `words`, and print what it returns; return the exit code."""
    env = DEFAULT_ENV
    if "env" in inspect.signature(function).parameters:
        env, words = _environment_first(words)
    command = _command(name, function, env, words)
    if not _HELP.isdisjoint(words):
        words = ["--help"]
    else:
        _check_flags(words, command)
    try:
        return tyro.cli(command, prog=f"shes {name}", args=words, config=_CONFIG, registry=_VALUES)
    except SystemExit as end:  # of tyro, which has printed a help or an error
        return end.code if isinstance(end.code, int) else 0 if end.code is None else 2


def completion(shell: Literal["bash", "zsh", "fish"]) -> None:
    """Print a script by which a shell completes commands, flags and choices.

    For bash: shes completion bash > ~/.local/share/bash-completion/completions/shes
    """
    commands = {name: _command(name, find_command(name), DEFAULT_ENV, [_HELP_ALL]) for name in COMMANDS}
    given = {"prog": "shes", "args": ["--tyro-write-completion", shell, "-"], "config": _CONFIG, "registry": _VALUES}
    tyro.extras.subcommand_cli_from_dict(commands, **given)


def _command(name: str, function: Callable[..., Any], env: str, words: Sequence[str]) -> Callable[..., int]:
    """Return `function` as tyro reads it: it prints what `function` returns, and returns the exit code."""

    def command(**values: Any) -> int:
        is_json = values.pop("json", False)
        with (
            _steps_shown() if shows_steps else nullcontext({}) as steps,
            redirect_stdout(None if is_json else sys.stdout),
        ):
            found = function(**values, **steps)
        return _show(found, _WRITES.get(name, ""), as_json=is_json)

    parameters = _parameters(function)
    shows_steps = parameters.pop("on_step", None) is not None
    if "settings" in parameters:
        kind = _settings_type(parameters, _asked_config(env, words), words)
        parameters["settings"] = parameters["settings"].replace(annotation=Annotated[kind, tyro.conf.arg(name="")])
    command.__annotations__ = {name: each.annotation for name, each in parameters.items()}
    command.__signature__ = inspect.Signature(list(parameters.values()))  # type: ignore[attr-defined] - tyro reads it
    text = inspect.getdoc(function) or ""  # each paragraph, and the text of each argument, on one line
    command.__doc__ = re.sub(r"(?<=\S)\n( {8})?(?=\S)", " ", text).replace("`", "")
    return command


@contextmanager
def _steps_shown() -> Iterator[dict[str, Callable[[int, int], None]]]:
    """Yield `on_step`, which shows the progress of a drawing in a terminal. SIGTERM lets it remove its files."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # no SystemExit: that may be an environment's own
    with drawing_progress(LineConsole(stderr=True)) as on_step:
        yield {"on_step": on_step}


def _show(found: Any, kind: str, *, as_json: bool) -> int:
    """Print a listing, an object that has one, or paths, at which is `kind`; return the exit code."""
    listing = found.listing() if hasattr(found, "listing") else found
    if not isinstance(listing, Listing):
        files = () if found is None else found if isinstance(found, tuple) else (found,)
        listing = Listing([], [f"{kind}: {file}" for file in files])
    console = LineConsole()
    if as_json:
        print(json.dumps(listing.facts, indent=2 if isinstance(listing.facts, list) else None))
    for part in () if as_json else listing.parts:
        if isinstance(part, str):
            console.print_line(part)
        else:
            console.print_table(part)
    for error in listing.errors:
        LineConsole(stderr=True).print_error(error)
    return 1 if listing.errors else 0


def _environment_first(words: Sequence[str]) -> tuple[str, list[str]]:
    """Return the environment in `words`, or `DEFAULT_ENV`, and `words` with it before all flags.

    In `--hidden 4 3 ENV` it would be a value of the flag; what follows a flag at once is no environment.
    """
    names = {*ENVIRONMENTS, *ROBOT_ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS}
    for i, (before, word) in enumerate(zip(["", *words], words, strict=False)):
        is_value = before.startswith("--") and not before.startswith("--no-") and "=" not in before
        if not is_value and (word in names or word.startswith(GYMNASIUM)):
            first = next((j for j, each in enumerate(words[:i]) if each.startswith("-")), i)
            return word, [*words[:first], word, *words[first:i], *words[i + 1 :]]
    return DEFAULT_ENV, list(words)


def _check_flags(words: Sequence[str], command: Callable[..., int]) -> None:
    """Raise ConfigError for a flag, or one and its opposite or alias, that is given twice and not repeatable."""
    kinds = command.__annotations__
    repeatable = {flag(name) for name in kinds if tyro.conf.UseAppendAction in get_args(kinds[name])}
    aliases = {flag(each.name): each.flag for each in known_settings().values()} | {"--checkpoints": "--checkpoint"}
    given = [word.partition("=")[0].replace("_", "-") for word in words if word.startswith("--")]
    given = [aliases.get(each, each) for each in (each.replace("--no-", "--") for each in given)]
    for each in given:
        if each not in repeatable and given.count(each) > 1:
            raise ConfigError(f"{each} is given twice. Give it once, followed by all its values.")


def _parameters(function: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the parameters of a command by name, as tyro reads them, with `json` if it returns a listing."""
    signature, found = inspect.signature(function, eval_str=True), dict[str, inspect.Parameter]()
    # Flags that are not the name, which is an alias.
    flags = {each.name: each.flag for each in known_settings().values() if each.flag != flag(each.name)}
    flags["checkpoints"] = "--checkpoint"
    for name, each in signature.parameters.items():
        kind, is_required = each.annotation, each.default is each.empty
        shown: dict[str, Any] = {}
        kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
        several, one = any(get_origin(it) is Sequence for it in kinds), name.removesuffix("s").upper()
        if several:
            kind = tuple[str, ...] | None if NoneType in kinds else tuple[str, ...]
            hint = "(required)" if is_required else None if each.default else "(default: none)"
            shown |= {"metavar": f"{one} [{one} ...]", "help_behavior_hint": hint}
        elif str in kinds:  # text where text will do
            kind = str | None if NoneType in kinds else str
            one = "PATH" if name == "out" else one if found or is_required else f"[{one}]"
            shown |= {"metavar": f"none|{one}" if NoneType in kinds else one}
        if name in flags:
            shown |= {"name": flags[name][2:], "aliases": (flag(name),)}
        kind = Annotated[kind, tyro.conf.arg(**shown)] if shown else kind
        if (not found or name == "env") and each.kind is not each.KEYWORD_ONLY and not is_required:
            kind = Annotated[kind, tyro.conf.Positional]
        found[name] = each.replace(annotation=kind, kind=each.KEYWORD_ONLY)
    if signature.return_annotation is Listing or hasattr(signature.return_annotation, "listing"):
        kind = Annotated[bool, tyro.conf.arg(help="Print JSON.")]
        found["json"] = inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
    return found


def _asked_config(env: str, words: Sequence[str]) -> TrainConfig:
    """Return the settings of `env` with the preset and algorithm in `words`; raise UnknownNameError for any name."""
    choosing = {each.flag: each for each in known_settings().values() if each.choices or each.kind is dict}
    pairs = [*pairwise(words), *(word.split("=", 1) for word in words if "=" in word)]
    found = {choosing[name]: value for name, value in pairs if name in choosing and not value.startswith("-")}
    given = {each.name: each.checked(value) for each, value in found.items() if each.choices or value != "none"}
    named = {"algorithm", *setting_fields(find_environment(env).task.Options)}
    asked = {name: value for name, value in given.items() if name in named}
    return make_config(env, given.get("preset"), asked)


def _settings_type(named: Mapping[str, Any], config: TrainConfig, words: Sequence[str]) -> Any:
    """Return the type of the settings that are flags of a command with parameters `named` on a run like `config`.

    If `words` ask for help, it has a group for each section, or the everyday one. Otherwise it includes every known
    setting; the configuration rejects those that do not apply.
    """
    is_parsed = _HELP.isdisjoint(words)
    takes_env, sections = "env" in named, settings_by_section(config.run)
    here = by_name(sections) if takes_env else resumable_settings()
    offered = {**(known_settings() if is_parsed else {}), **here}
    offered = {name: each for name, each in offered.items() if name not in {*named, "env"}}
    values = dict.fromkeys(offered, "as before")
    if takes_env:
        values = {name: config.values.get(name, each.default) for name, each in offered.items()}
    if is_parsed:
        return _group("", offered, values)
    if not takes_env:
        groups = {"settings": _group("A setting that is not given keeps its value.", offered, values)}
    elif _HELP_ALL not in words:
        title = f"Values of preset {config.run.preset} for {config.run.env}. All {len(here)} settings: {_HELP_ALL}."
        everyday = {name: each for name, each in offered.items() if any(note.everyday for note in each.all_of(Shown))}
        groups = {"everyday": _group(title, everyday, values, is_brief=True)}
    else:
        groups = {}
        for name, section in config.sections.items():
            title = (type(section).__doc__ or "").partition("\n")[0]
            own = {each: offered.pop(each) for each in sections[name] if each in offered}  # may be shared
            groups[name] = _group("" if title.rstrip(".").lower() == name else title, own, values)
    return TypedDict("Settings", groups)  # type: ignore[misc] - the keys are known at run time only


def _group(title: str, settings: Mapping[str, Setting], values: Mapping[str, Any], *, is_brief: bool = False) -> Any:
    """Return a group of flags, whose help shows `values`. A `TypedDict`, because tyro then omits keys not given."""
    keys: dict[str, Any] = {}
    for name, each in settings.items():
        kind: Any = Literal[each.choices] if each.choices else str if each.kind is dict else each.kind
        metavar = "none|RUN" if name in transferred_levels() else "none|JSON" if each.kind is dict else None
        if each.kind is tuple:
            kind = tuple[each.item, ...]
            kind = kind | _Empty if each.can_be_empty and not each.is_optional else kind
            metavar = f"{'none|' * (each.can_be_empty or each.is_optional)}{each.item.__name__.upper()} ..."
        text = each.text.replace("`", "")
        if is_brief:
            text = re.split(r"(?<=\.)\s", text, maxsplit=1)[0]
            if each.choices:
                metavar = "NAME"
                text = text if each.choices[0] in text else f"{text.rstrip('.')}: {', '.join(each.choices)}."
        value = values[name]
        if isinstance(value, tuple):  # the only one that may be empty has the sizes of hidden layers
            value = " ".join(map(str, value)) or "none (linear)"
        shown = tyro.conf.arg(
            name=each.flag[2:],
            aliases=None if is_brief or each.flag == flag(name) else (flag(name),),
            help=text,
            help_behavior_hint=f"(default: {'none' if value is None else value})",
            metavar=metavar,
        )
        keys[name] = Annotated[kind | None if each.is_optional else kind, shown]
    group = TypedDict("Settings", keys, total=False)  # type: ignore[misc] - as above
    group.__doc__ = title
    return group


class _Empty:
    """Type of the empty tuple, written `none`."""


@_VALUES.primitive_rule
def _none_spec(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Read None, or the empty tuple, as `none`."""
    if info.type not in (NoneType, _Empty):
        return None
    words, value = ("none", "None"), None if info.type is NoneType else ()
    return PrimitiveConstructorSpec(1, "none", lambda _: value, lambda it: it == value, lambda _: ["none"], words)


@_VALUES.primitive_rule
def _whole_spec(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Read a whole number also in the form 1e6."""
    if info.type is not int:
        return None
    return PrimitiveConstructorSpec(
        1, "INT", lambda words: _whole(words[0]), lambda it: type(it) is int, lambda it: [str(it)]
    )


def _whole(word: str) -> int:
    with suppress(ValueError):
        return int(word)
    if not (number := float(word)).is_integer():  # also infinity and NaN
        raise ValueError(f"{word} is not a whole number")
    return int(number)
