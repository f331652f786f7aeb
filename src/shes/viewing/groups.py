"""Runs read for drawing, and their groups: which are repetitions of each other, and how the groups differ."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from shes.errors import ConfigError, ShesError
from shes.runs.comparison import differing_settings, settings_and_seeds
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder
from shes.runs.make_config import transferred_levels
from shes.runs.runs_folder import find_runs
from shes.runs.shipped import shipped_name
from shes.runs.tables import read_csv
from shes.viewing.curves import Table

_T = TypeVar("_T")
_FIRST = ("env", "algorithm", "preset")
"""The kind of a run: settings that are named first in a label, because others follow from them."""
_MOST_NAMED = 4


@dataclass(kw_only=True, eq=False)
class RunData:
    """A run, as its files describe it."""

    folder: RunFolder
    name: str
    """Its path, or its name as a shipped agent."""
    config: TrainConfig
    tables: dict[str, Table] = field(default_factory=dict)
    """`progress` and `evaluation`; a table that is missing or damaged is empty."""
    is_damaged: bool = False
    """Whether a table cannot be read."""
    notes: list[str] = field(default_factory=list)
    """Faults found while this run was read or played."""


class Group(NamedTuple):
    """Runs with equal settings and different seeds, and primitives of such runs. They are drawn as one curve."""

    number: int
    """Which of the groups it is, for the look of its curve."""
    label: str
    """How its settings differ from those of the other groups, and the number of its runs."""
    runs: list[RunData]


def read_runs(runs: Path | str | Sequence[Path | str], command: str) -> tuple[list[RunData], dict[str, ShesError]]:
    """Return `runs`, the arguments of `command`, and the errors of those that cannot be read, by name."""
    given = list(runs) if isinstance(runs, Iterable) and not isinstance(runs, str) else [runs]
    if not given:
        raise ConfigError(f"{command} needs at least one run folder: shes {command} RUN...")
    folders = {folder.path.resolve(): folder for each in given for folder in find_runs(each)}
    read: list[RunData] = []
    errors: dict[str, ShesError] = {}
    for folder in folders.values():  # a run named twice counts once
        try:
            read.append(read_run(folder))
        except ShesError as error:
            errors[_name(folder)] = error
    if not read:
        raise next(iter(errors.values()))
    return read, errors


def read_run(folder: RunFolder) -> RunData:
    """Return what the files of a run say; raise ShesError if its record cannot be read."""
    run = RunData(folder=folder, name=_name(folder), config=folder.read_config())
    for path in (folder.progress, folder.evaluation):
        try:
            run.tables[path.stem] = read_csv(path)
            if not run.tables[path.stem]:
                what = "has no row" if path.exists() else "is missing"
                run.notes.append(f"{path.name} {what}: its curves are left out.")
        except ShesError as error:
            run.tables[path.stem], run.is_damaged = {}, True
            run.notes.append(f"Curves are left out: {error}")
    return run


def _name(folder: RunFolder) -> str:
    return shipped_name(folder.path) or str(folder.path)


def group_runs(runs: Sequence[RunData]) -> list[Group]:
    """Return the groups of repetitions in `runs`: runs of equal settings that differ in the seed only.

    Workers and machine do not change the numbers of a run: two runs with the same seed are one result seen twice, and
    no repetitions. The runs of a group that has a seed twice are groups of their own.
    """
    found: list[list[RunData]] = []
    for members in _divided(runs, _design):
        has_seed_twice = len(_divided(members, lambda run: settings_and_seeds(run.folder)[1])) < len(members)
        found += [[run] for run in members] if has_seed_twice else [members]
    labels = _labels([members[0] for members in found])
    counts = [f" ({len(members)} runs)" if len(members) > 1 else "" for members in found]
    return [Group(number, labels[number] + counts[number], members) for number, members in enumerate(found)]


def _divided(items: Sequence[_T], key: Callable[[_T], Any]) -> list[list[_T]]:
    """Return `items` divided by `key`, a JSON value."""
    found: dict[str, list[_T]] = {}
    for item in items:
        found.setdefault(json.dumps(key(item), sort_keys=True), []).append(item)
    return list(found.values())


def _design(run: RunData) -> dict[str, Any]:
    """Return the preset and the settings of a run that repetitions have in common."""
    return {"preset": run.config.run.preset, **settings_and_seeds(run.folder)[0]}


def _labels(firsts: Sequence[RunData]) -> list[str]:
    """Return a label for the group of each run: environment and preset of a single one, else what differs."""
    if len(firsts) == 1:
        run = firsts[0].config.run
        return [f"{run.env} {run.preset}"]
    designs = [_design(first) for first in firsts]
    kind = [name for name in _FIRST if name in differing_settings(designs)]
    # Other settings are named where they differ among groups of one kind.
    alike = _divided(designs, lambda design: [design.get(name) for name in _FIRST])
    names = list(dict.fromkeys(chain(*map(differing_settings, alike))))
    names.sort(key=lambda name: name not in transferred_levels())  # a level of another run brings other settings
    labels = [_label(design, [*kind, *names]) for design in designs]
    if len(set(labels)) == len(labels):
        return labels
    return [f"{label}, {first.name}" if label else first.name for label, first in zip(labels, firsts, strict=True)]


def _label(settings: dict[str, Any], names: list[str]) -> str:
    """Return the values of settings `names`, at most `_MOST_NAMED` of them."""
    shown = [f"{name.replace('_', ' ')} {setting_text(settings[name])}" for name in names if name in settings]
    more = len(shown) - _MOST_NAMED
    return ", ".join(shown[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def setting_text(value: Any) -> str:
    """Return the value of a setting as people write it: lists as `64x64`, nothing as `none`."""
    if isinstance(value, list | tuple):
        return "x".join(map(setting_text, value)) or "none"
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
