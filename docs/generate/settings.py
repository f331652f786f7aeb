"""The settings of a run with their values in every preset."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from generate.fields import field_docs
from generate.tables import table
from shes.runs.config import TrainConfig
from shes.runs.settings import flag
from shes.training.presets import PRESETS, make_config


def settings(page: str) -> str:
    """Return the table of the settings of `train`: flag, presets, meaning."""
    del page
    docs = field_docs(TrainConfig)
    configs = [make_config("ant-gather", preset) for preset in PRESETS]
    names = [field.name for field in fields(TrainConfig) if field.name not in ("env", "preset")]
    rows = [
        (f"`{flag(name)}`", docs.get(name, ""), *(_shown(getattr(config, name)) for config in configs))
        for name in names
    ]
    return table(["flag", "meaning", *(f"`{name}`" for name in PRESETS)], rows)


def _shown(value: Any) -> str:
    """Return a value as it is written on the command line."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return " ".join(map(str, value)) or "none"
    return f"{value:,}" if isinstance(value, int) else str(value)
