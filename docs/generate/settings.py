"""The settings of a run with their values in every preset."""

from __future__ import annotations

from typing import Any

from generate.tables import table
from shes.envs.registry import ENVIRONMENTS
from shes.settings import Unasked, setting_fields
from shes.training.presets import PRESETS, make_config


def settings(page: str) -> str:
    """Return a table of the settings of `train` for each room: flag, presets, meaning."""
    del page
    configs = [make_config("ant-gather", preset) for preset in PRESETS]
    parts = []
    for name, room in configs[0].rooms.items():
        if name == "environment":
            continue
        rows = [
            (f"`{each.flag}`", each.text, *(_shown(config.settings[each.name]) for config in configs))
            for each in setting_fields(type(room)).values()
            if each.name not in ("env", "preset")
        ]
        parts += [f"### {_title(type(room))}", table(["flag", "meaning", *(f"`{name}`" for name in PRESETS)], rows)]
    return "\n\n".join([*parts, "### Environment", _options()])


def _options() -> str:
    """Return the table of the options of all tasks."""
    tasks: dict[str, list[str]] = {}
    found = {}
    for environment in ENVIRONMENTS.values():
        for each in setting_fields(environment.options).values():
            if not each.has(Unasked):
                found[each.name] = each
                tasks.setdefault(each.name, []).append(environment.task.name)
    count = len(ENVIRONMENTS)
    rows = [
        (
            f"`{each.flag}`",
            "every task" if len(tasks[name]) == count else ", ".join(dict.fromkeys(tasks[name])),
            each.text,
            _shown(each.default),
        )
        for name, each in found.items()
    ]
    return table(["flag", "task", "meaning", "default"], rows)


def _title(cls: type) -> str:
    return (cls.__doc__ or "").partition(".")[0]


def _shown(value: Any) -> str:
    """Return a value as it is written on the command line."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return " ".join(map(str, value)) or "none"
    return f"{value:,}" if isinstance(value, int) else str(value)
