"""The settings of a run as options: every field of `TrainConfig`, under the heading of its section."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import fields
from typing import Any, get_type_hints

from shes.cli.options import Group, Option, field_texts, shown_value
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS
from shes.runs.config import HEADINGS, TrainConfig
from shes.runs.settings import choices, flag
from shes.training.presets import PRESETS, make_config

__all__ = ["DEFAULT_ENV", "asked_config", "environment_group", "make_asked_config", "setting_groups"]

DEFAULT_ENV = "ant-gather"
"""Environment of the help's values and of `shes bench` where none is named."""
DEFAULT_PRESET = "laptop"
"""Preset where none is named."""


def setting_groups(config: TrainConfig | None, names: Container[str]) -> tuple[Group, ...]:
    """Return options for the settings `names`, by heading; shown are the values of `config`, if there is one."""
    kinds, texts = get_type_hints(TrainConfig), field_texts(TrainConfig)
    grouped: dict[str, list[Option]] = {}
    heading = ""
    for field in fields(TrainConfig):
        heading = HEADINGS.get(field.name, heading)
        if field.name not in names:
            continue
        option = Option(
            name=field.name,
            kind=kinds[field.name],
            text=texts[field.name],
            flags=tuple(dict.fromkeys((flag(field.name), "--" + field.name.replace("_", "-")))),
            choices=tuple(PRESETS) if field.name == "preset" else choices(field.name),
            default="" if config is None else shown_value(getattr(config, field.name)),
            is_run=field.name == "primitive",
        )
        grouped.setdefault(heading, []).append(option)
    return tuple(Group(heading=heading, options=tuple(options)) for heading, options in grouped.items())


def environment_group(*, is_required: bool) -> Group:
    """Return the positional that names the environment."""
    names = (*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS)
    env = Option(
        name="env",
        kind=str,
        text=f"What to train on: {', '.join(names)}; or gymnasium:ID.",
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
    preset = DEFAULT_PRESET
    for word, follower in zip(words, [*words[1:], ""], strict=False):
        name, equals, value = word.partition("=")
        if name == "--preset" and (value or follower):
            preset = value if equals else follower
    return make_config(env, preset)


def make_asked_config(values: dict[str, Any]) -> TrainConfig:
    """Return the settings that were given by name, over those of the preset.

    Raises:
        UnknownNameError: A name is not known.
        ConfigError: A value is not allowed.
    """
    settings = {name: value for name, value in values.items() if name not in ("env", "preset")}
    return make_config(values["env"], values.get("preset", DEFAULT_PRESET), settings)
