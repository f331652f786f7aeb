"""Groups of runs: which runs are repetitions of each other, and how the groups differ."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from shes.runs.folder import RunFolder
from shes.runs.repetitions import differing_settings, repeated_settings, seeds_of
from shes.runs.transfer import transferred_levels

_T = TypeVar("_T")

_FIRST = ("env", "algorithm", "preset")
"""The kind of a run: settings that are named first in a label, because others follow from them."""
_MOST_NAMED = 4
_STYLES = ("-", "--", ":", "-.")
_COLORS = 10


@dataclass(frozen=True, kw_only=True)
class Group:
    """Runs with equal settings and different seeds, and primitives of such runs. They are drawn as one curve."""

    folders: list[RunFolder]
    label: str
    """How its settings differ from those of the other groups, and the number of its runs."""
    color: str
    style: str
    """Style of its line: after ten groups the colours begin anew with another one."""


def group_runs(folders: Sequence[RunFolder], *, by_time: bool = False) -> list[Group]:
    """Return the groups of repetitions in `folders`.

    Workers and machine do not change the numbers of a run: two runs with the same seed are one result seen twice,
    and no repetitions. A group that has a seed twice is divided by workers and machine, else into single runs; over
    time, which depends on them, each group is.
    """
    found: list[list[RunFolder]] = []
    for group in _divided(folders, _design):
        for part in _divided(group, _execution) if by_time or _has_seed_twice(group) else [group]:
            found += [[folder] for folder in part] if _has_seed_twice(part) else [part]
    return _named(found, _labels(found))


def name_groups(folders: Sequence[RunFolder], labels: Sequence[str]) -> list[Group]:
    """Return the groups of `folders` that have the same label of `labels`, one for each folder."""
    found: dict[str, list[RunFolder]] = {}
    for folder, label in zip(folders, labels, strict=True):
        found.setdefault(label, []).append(folder)
    return _named(list(found.values()), list(found))


def _named(groups: list[list[RunFolder]], labels: list[str]) -> list[Group]:
    """Return `groups` with these labels, each with a colour and a style of its own."""
    return [
        Group(
            folders=members,
            label=label + (f" ({len(members)} runs)" if len(members) > 1 else ""),
            color=f"C{number % _COLORS}",
            style=_STYLES[number // _COLORS % len(_STYLES)],
        )
        for number, (members, label) in enumerate(zip(groups, labels, strict=True))
    ]


def _divided(items: Sequence[_T], key: Callable[[_T], Any]) -> list[list[_T]]:
    """Return `items` divided by `key`, a JSON value."""
    found: dict[str, list[_T]] = {}
    for item in items:
        found.setdefault(json.dumps(key(item), sort_keys=True), []).append(item)
    return list(found.values())


def _design(folder: RunFolder) -> dict[str, Any]:
    """Return the preset and the settings of a run that repetitions have in common."""
    return {"preset": folder.read_config().run.preset, **repeated_settings(folder)}


def _execution(folder: RunFolder) -> dict[str, Any]:
    """Return the settings of a run's workers, and its machine."""
    machine = folder.read_record().get("machine", {})
    facts = {name: machine.get(name) for name in ("processor", "cores")} if isinstance(machine, dict) else {}
    return {**folder.read_config().workers.to_dict(), **facts}


def _has_seed_twice(folders: Sequence[RunFolder]) -> bool:
    seeds = [seeds_of(folder) for folder in folders]
    return any(each in seeds[:number] for number, each in enumerate(seeds))


def _labels(groups: list[list[RunFolder]]) -> list[str]:
    """Return a label for every group: environment and preset of a single one, else what differs."""
    firsts = [members[0] for members in groups]
    if len(groups) == 1:
        run = firsts[0].read_config().run
        return [f"{run.env} {run.preset}"]
    designs = [_design(first) for first in firsts]
    facts = [{**design, **_execution(first)} for design, first in zip(designs, firsts, strict=True)]
    kind = [name for name in _FIRST if name in differing_settings(facts)]
    # Other settings are named where they differ among groups of one kind, and workers and machine as the last resort.
    alike = [differing_settings(each) for each in _divided(facts, lambda each: [each.get(name) for name in _FIRST])]
    names = [name for name in dict.fromkeys(itertools.chain(*facts)) if any(name in each for each in alike)]
    own = [name for name in names if any(name in design for design in designs)]
    own.sort(key=lambda name: name not in transferred_levels())  # a level of another run brings other settings
    others = [name for name in names if name not in own]
    labels: list[str] = []
    for chosen in ([*kind, *own], [*kind, *own, *others]):
        labels = [_label(each, chosen) for each in facts]
        if len(set(labels)) == len(labels):
            return labels
    return [f"{label}, {first.path}" if label else str(first.path) for label, first in zip(labels, firsts, strict=True)]


def _label(facts: dict[str, Any], names: list[str]) -> str:
    """Return the values of settings `names`, at most `_MOST_NAMED` of them."""
    shown = [f"{name.replace('_', ' ')} {_text(facts.get(name))}" for name in names if name in facts]
    more = len(shown) - _MOST_NAMED
    return ", ".join(shown[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _text(value: Any) -> str:
    if isinstance(value, list):
        return "x".join(map(_text, value)) or "none"
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
