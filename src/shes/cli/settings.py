"""The settings of a run as options: every field of `TrainConfig`, under the heading of its section."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from shes.cli.options import Group, Option, shown_value
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS
from shes.runs.config import TrainConfig
from shes.settings import Execution, Setting, Unasked, flag, setting_fields
from shes.training.presets import PRESETS, make_config
from shes.training.transfer import TRANSFERRED

__all__ = ["DEFAULT_ENV", "asked_config", "environment_group", "make_asked_config", "setting_groups"]

DEFAULT_ENV = "ant-gather"
"""Environment of the help's values and of `shes bench` where none is named."""
DEFAULT_PRESET = "laptop"
"""Preset where none is named."""


def setting_groups(config: TrainConfig, *, only_execution: bool = False) -> tuple[Group, ...]:
    """Return an option for each setting of `config`, by room, with its value; or for those that `resume` takes."""
    groups: list[Group] = []
    for room in config.rooms.values():
        options = [
            _option(setting, "" if only_execution else shown_value(getattr(room, setting.name)))
            for setting in setting_fields(type(room)).values()
            if setting.name not in ("env", "external") and not setting.has(Unasked)
            if not only_execution or (setting.has(Execution) and setting.name != "preset")
        ]
        if options:
            heading = (type(room).__doc__ or "").partition(".")[0].lower()
            groups.append(Group(heading=heading, options=tuple(options)))
    return tuple(groups)


def _option(setting: Setting, default: str) -> Option:
    kind = tuple[setting.item, ...] if setting.kind is tuple else setting.kind
    return Option(
        name=setting.name,
        kind=kind | None if setting.is_optional else kind,
        text=setting.text,
        flags=tuple(dict.fromkeys((setting.flag, flag(setting.name)))),
        choices=tuple(PRESETS) if setting.name == "preset" else setting.choices,
        default=default,
        is_run=setting.name in TRANSFERRED,
    )


def environment_group(*, is_required: bool) -> Group:
    """Return the positional that names the environment."""
    names = (*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS)
    env = Option(
        name="env",
        kind=str,
        text=f"What to train on: {', '.join(names)}; or a file (.toml, .json) that describes another environment.",
        metavar="ENV",
        choices=names,
        default="" if is_required else DEFAULT_ENV,
        noun="an environment",
        is_required=is_required,
    )
    return Group(heading="environment", options=(env,))


def asked_config(words: Sequence[str]) -> TrainConfig:
    """Return the settings whose values the help shows: those of the environment and the preset among `words`.

    Raises:
        UnknownNameError: There is no such preset.
    """
    env = next((word for word in words if word in ENVIRONMENTS or word in EXTERNAL_ENVIRONMENTS), DEFAULT_ENV)
    given = {"--preset": DEFAULT_PRESET, "--algorithm": "shes"}
    for word, follower in zip(words, [*words[1:], ""], strict=False):
        name, equals, value = word.partition("=")
        if name in given and (value or follower):
            given[name] = value if equals else follower
    return make_config(env, given["--preset"], {"algorithm": given["--algorithm"]})


def make_asked_config(values: dict[str, Any]) -> TrainConfig:
    """Return the settings that were given by name, over those of the preset.

    Raises:
        UnknownNameError: A name is not known.
        ConfigError: A value is not allowed.
    """
    settings = {name: value for name, value in values.items() if name not in ("env", "preset")}
    return make_config(values["env"], values.get("preset", DEFAULT_PRESET), settings)
