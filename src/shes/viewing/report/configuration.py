"""In which settings runs differ, from each other and from their preset."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from shes.runs.config import TrainConfig
from shes.training.make_config import make_config
from shes.viewing.report.reading import ReportedGroup

_IDENTITY = ("env", "algorithm", "preset", "seed")
"""Settings that every run is asked for."""


def differing_settings(groups: Sequence[ReportedGroup]) -> dict[str, list[str]]:
    """Return the settings in which the runs of `groups` differ: name -> its values in each group, as text.

    A group whose runs differ has all of their values; a setting that a run does not have is `-`.
    """
    values = [[_values(run.config) for run in group.runs] for group in groups]
    every = [each for group in values for each in group]
    found: dict[str, list[str]] = {}
    for name in dict.fromkeys(name for each in every for name in each):
        if len({each.get(name, "-") for each in every}) > 1:
            found[name] = [", ".join(dict.fromkeys(each.get(name, "-") for each in group)) for group in values]
    return found


def changed_settings(config: TrainConfig) -> dict[str, tuple[str, str]]:
    """Return the settings of a run that its preset gives another value: name -> that of the run and of the preset.

    Raises:
        ShesError: The preset cannot be made here.
    """
    run = config.run
    own, preset = _values(config), _values(make_config(run.env, run.preset, {"algorithm": run.algorithm}))
    return {
        name: (value, preset.get(name, "-"))
        for name, value in own.items()
        if name not in _IDENTITY and value != preset.get(name, "-")
    }


def _values(config: TrainConfig) -> dict[str, str]:
    """Return all settings of a run by name, as text."""
    return {name: _text(value) for section in config.to_dict().values() for name, value in section.items()}


def _text(value: Any) -> str:
    if isinstance(value, list | tuple):
        return " ".join(map(_text, value)) or "none"
    if isinstance(value, float):
        return f"{value:g}"
    return "none" if value is None else value if isinstance(value, str) else json.dumps(value, default=str)
