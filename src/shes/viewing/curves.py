"""Runs read for drawing, their groups of repetitions, and the mean of a group with its confidence interval."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import chain
from math import pi, sqrt
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from shes.errors import ConfigError, ShesError
from shes.runs.comparison import differing_settings, settings_and_seeds
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder
from shes.runs.make_config import transferred_levels
from shes.runs.runs_folder import find_runs
from shes.runs.shipped import shipped_name
from shes.runs.tables import read_csv
from shes.types import F64Array

Table = Mapping[str, F64Array]
"""Columns of a table by name, with a value per row."""
X_AXES = {
    "env_steps": ("environment steps (millions)", 1e-6),
    "wall_time_s": ("minutes", 1 / 60),
    "generation": ("generation", 1.0),
}
"""Abscissae: column of the tables -> label, and factor of the column's values."""
_CONFIDENCE = 0.95
_LEAST_OVERLAP = 0.5
"""Part of the median length of the runs that all of them must cover for a mean."""


@dataclass(frozen=True, kw_only=True)
class MeanCurve:
    """The mean of curves of several runs with its interval, and the runs that are to be shown singly."""

    grid: F64Array
    """Abscissae [grid]; empty if the runs lie apart, so that there is no mean."""
    values: F64Array
    """Values there [runs, grid]."""
    band: tuple[F64Array, F64Array] | None = None
    """Bounds [grid] of the 95 % interval of the mean of three or more runs; of a single run, two standard errors."""
    singles: tuple[tuple[F64Array, F64Array], ...] = ()
    """Abscissae and values of each of two runs, whose interval says nothing, and of runs that lie apart."""

    @property
    def mean(self) -> F64Array:
        """Mean over runs [grid]."""
        return self.values.mean(axis=0)

    @property
    def is_apart(self) -> bool:
        """Whether the runs overlap too little for a mean."""
        return not len(self.grid)


def mean_curve(*curves: tuple[F64Array, F64Array]) -> MeanCurve:
    """Return the mean of curves where all have values; they are ascending abscissae and values, joined linearly.

    Without a common range of at least half of their median length there is no mean: it would leave out most of what
    the runs did.
    """
    if len(curves) == 1:
        return MeanCurve(grid=curves[0][0], values=curves[0][1][None])
    start, end = max(x[0] for x, _ in curves), min(x[-1] for x, _ in curves)
    if end - start < _LEAST_OVERLAP * np.median([x[-1] - x[0] for x, _ in curves]):
        return MeanCurve(grid=np.empty(0), values=np.empty((len(curves), 0)), singles=curves)
    every = np.concatenate([x for x, _ in curves])
    grid = np.unique(every[(every >= start) & (every <= end)])
    values = np.stack([np.interp(grid, *curve) for curve in curves])
    if len(curves) == 2:
        return MeanCurve(grid=grid, values=values, singles=curves)
    return MeanCurve(grid=grid, values=values, band=confidence_interval(values))


def column_curve(tables: Sequence[Table], column: str, x: str) -> MeanCurve:
    """Return the mean of `column` of the tables of several runs, over `x` of `X_AXES`.

    A single table of evaluations has a band of two standard errors over the episodes on either side.
    """
    curve = mean_curve(*((table[x] * X_AXES[x][1], table[column]) for table in tables))
    spread = column.replace("_mean", "_std")
    if len(tables) > 1 or spread == column or not {spread, "episodes"} <= tables[0].keys():
        return curve
    error = 2 * tables[0][spread] / np.sqrt(tables[0]["episodes"])
    return replace(curve, band=(curve.mean - error, curve.mean + error))


def confidence_interval(values: F64Array) -> tuple[F64Array, F64Array]:
    """Return the bounds, each [grid], of the 95 % t interval of the mean over runs of `values` [runs, grid].

    The interval is the mean itself where all runs agree, and of a single run.
    """
    mean, runs = values.mean(axis=0), len(values)
    if runs == 1:
        return mean, mean
    half = t_quantile(runs - 1) * values.std(axis=0, ddof=1) / sqrt(runs)
    return mean - half, mean + half


@cache
def t_quantile(freedom: int) -> float:
    """Return the t that a variable of Student's distribution exceeds in absolute value with probability 5 %.

    With t = √freedom · tan(angle) the density is proportional to cos(angle) to the power freedom - 1. Its integral is
    the trapezoidal sum, to eight digits; the base installation has no SciPy.
    """
    angles = np.linspace(0, pi / 2, 500_001)
    density = np.cos(angles) ** (freedom - 1)
    integral = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
    return float(np.tan(np.interp(_CONFIDENCE * integral[-1], integral, angles)) * sqrt(freedom))


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
    labels = []
    for design in designs:
        shown = [f"{name.replace('_', ' ')} {setting_text(design[name])}" for name in (*kind, *names) if name in design]
        more = f" and {len(shown) - _MOST_NAMED} more" if len(shown) > _MOST_NAMED else ""
        labels.append(", ".join(shown[:_MOST_NAMED]) + more)
    if len(set(labels)) == len(labels):
        return labels
    return [f"{label}, {first.name}" if label else first.name for label, first in zip(labels, firsts, strict=True)]


def setting_text(value: Any) -> str:
    """Return the value of a setting as people write it: lists as `64x64`, nothing as `none`."""
    if isinstance(value, list | tuple):
        return "x".join(map(setting_text, value)) or "none"
    return "none" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
