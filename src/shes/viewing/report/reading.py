"""Reads the files of runs for a report. A damaged table is noted and only its curves are missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shes.errors import ConfigError, RunFolderError, ShesError
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder
from shes.runs.listings import RunState, run_state
from shes.runs.runs_folder import find_runs
from shes.runs.shipped import shipped_name
from shes.runs.tables import read_csv
from shes.types import F64Array
from shes.viewing.groups import Group, group_runs, name_groups
from shes.viewing.report.experiment_runs import RunPlace, group_places, place_runs

Table = dict[str, F64Array]
"""Columns by name, with a value per row."""
RUNS_OF_STUDY = "runs.csv"
"""Table of the runs of an experiment, in its folder."""


@dataclass(frozen=True, kw_only=True)
class ReportedRun:
    """A run, as its files describe it."""

    folder: RunFolder
    name: str
    """Its path, its name as a shipped agent, or that of its place in an experiment."""
    config: TrainConfig
    record: dict[str, Any]
    """Content of `config.json`."""
    state: RunState
    tables: dict[str, Table]
    """`progress` and `evaluation`; a table that is missing or damaged is empty."""
    place: RunPlace | None = None
    """Its place in an experiment."""
    notes: list[str] = field(default_factory=list)
    """What could not be read, or done with this run."""


@dataclass(frozen=True, kw_only=True)
class ReportedGroup:
    """Runs that are drawn as one curve."""

    group: Group
    runs: list[ReportedRun]

    @property
    def label(self) -> str:
        """How it differs from the other groups."""
        return self.group.label

    @property
    def title(self) -> str:
        """The run's name if the group has a single run, otherwise the label; of an experiment, with environment."""
        place = self.runs[0].place
        if len(self.runs) == 1:
            return self.runs[0].name
        return self.label if place is None else f"{place.env}: {self.label} ({len(self.runs)} runs)"


@dataclass(frozen=True, kw_only=True)
class ReportedRuns:
    """The runs of a report, in groups."""

    groups: list[ReportedGroup]
    groups_over_time: list[ReportedGroup]
    """Groups of curves over wall-clock time, on which workers and machine have an effect."""
    left_out: list[str]
    """Why runs that cannot be read are left out."""
    experiments: list[Path] = field(default_factory=list)
    """Those of the given folders that are an experiment's."""

    @property
    def runs(self) -> list[ReportedRun]:
        """All runs, by group."""
        return [run for group in self.groups for run in group.runs]

    def groups_over(self, x: str) -> list[ReportedGroup]:
        """Return the groups of curves over the column `x`."""
        return self.groups_over_time if x == "wall_time_s" else self.groups


def read_runs(runs: Sequence[Path | str], labels: Sequence[str] = ()) -> ReportedRuns:
    """Return what the files of `runs` say, in groups.

    Args:
        runs: Run folders, folders of runs or experiments, or names of shipped agents. An experiment may have no runs.
        labels: Label of each of `runs`: those of one label are a group. By default the groups are those of `shes plot`.

    Raises:
        ConfigError: `runs` is empty, or `labels` has not one label for each of them.
        RunFolderError: One of `runs` is neither a folder of runs nor a shipped agent, or an experiment without a
            result, or none can be read.
    """
    if not runs:
        raise ConfigError("report needs at least one run folder: shes report RUN... --out report.html")
    if labels and len(labels) != len(runs):
        raise ConfigError(
            f"there must be one label for each of the {len(runs)} runs, got {len(labels)}: {', '.join(labels)}. "
            "Set --labels."
        )
    experiments = list(dict.fromkeys(Path(each) for each in runs if is_experiment(Path(each))))
    read: dict[Path, ReportedRun] = {}  # a run named twice counts once
    label_of: dict[Path, str] = {}
    places: dict[Path, RunPlace] = {}
    errors: dict[str, ShesError] = {}
    for number, given in enumerate(runs):
        if is_without_runs(Path(given)):
            _check_results(Path(given))
            folders = []
        else:
            folders = find_runs(given)
        if Path(given) in experiments and not labels:
            prefix = f"{given}: " if len(experiments) > 1 else ""
            places |= place_runs(folders, Path(given), prefix)
        for folder in folders:
            path = folder.path.resolve()
            if path in read:
                continue
            try:
                read[path] = read_run(folder, places.get(path))
            except ShesError as error:
                errors[run_name(folder)] = error
            else:
                label_of[path] = labels[number] if labels else ""
    if errors and not read and not any(map(_has_results, experiments)):
        raise next(iter(errors.values()))
    grouped, over_time = (
        _groups(read, [label_of[path] for path in read] if labels else [], places, by_time=by_time)
        for by_time in (False, True)
    )
    return ReportedRuns(
        groups=grouped,
        groups_over_time=over_time,
        left_out=[f"{name} is left out: {error}" for name, error in errors.items()],
        experiments=experiments,
    )


def _groups(
    read: Mapping[Path, ReportedRun], labels: Sequence[str], places: Mapping[Path, RunPlace], *, by_time: bool
) -> list[ReportedGroup]:
    """Return the groups of runs: those of one label, or else of one place in an experiment, or as `shes plot` has them.

    `labels` has one for each run, or none.
    """
    if labels:
        groups = name_groups([run.folder for run in read.values()], labels)
    else:
        placed = [run.folder for run in read.values() if run.place is not None]
        others = [run.folder for run in read.values() if run.place is None]
        groups = group_places(placed, places, group_runs(others, by_time=by_time))
    return [
        ReportedGroup(group=group, runs=[read[folder.path.resolve()] for folder in group.folders]) for group in groups
    ]


def is_experiment(folder: Path) -> bool:
    """Return whether `folder` holds the tables of an experiment."""
    return (folder / RUNS_OF_STUDY).is_file()


def is_without_runs(folder: Path) -> bool:
    """Return whether `folder` holds tables of an experiment and no runs."""
    return is_experiment(folder) and not any(folder.glob("**/config.json"))


def _has_results(folder: Path) -> bool:
    """Return whether the table of an experiment has a row."""
    text = (folder / RUNS_OF_STUDY).read_text(encoding="utf-8", errors="replace")
    return len(text.splitlines()) > 1


def _check_results(folder: Path) -> None:
    """Raise RunFolderError if the table of an experiment has no row."""
    if not _has_results(folder):
        raise RunFolderError(
            f"the experiment in {folder} has neither a run nor a row in {RUNS_OF_STUDY}: there is nothing to report. "
            f"Run it: shes experiment NAME --out {folder}"
        )


def run_name(folder: RunFolder) -> str:
    """Return the path of a run, or its name if it is a shipped agent."""
    return shipped_name(folder.path) or str(folder.path)


def read_run(folder: RunFolder, place: RunPlace | None = None) -> ReportedRun:
    """Return what the files of a run say; raise ShesError if its record or its state cannot be read."""
    notes: list[str] = []
    run = ReportedRun(
        folder=folder,
        name=run_name(folder) if place is None else place.name,
        place=place,
        config=folder.read_config(),
        record=folder.read_record(),
        state=run_state(folder),
        tables={path.stem: _read_table(path, notes) for path in (folder.progress, folder.evaluation)},
        notes=notes,
    )
    if run.state.state == "unreadable":
        what = "damaged" if folder.checkpoint_path("last").is_file() else "missing"
        notes.append(f"The last checkpoint is {what}.")
    return run


def _read_table(path: Path, notes: list[str]) -> Table:
    """Return the columns of a table; if it cannot be read, none, and add the reason to `notes`."""
    if not path.exists():
        notes.append(f"There is no {path.name} yet: curves from it are left out.")
        return {}
    try:
        columns = read_csv(path)
    except ShesError as error:
        notes.append(f"Curves are left out: {error}")
        return {}
    if not columns:
        notes.append(f"{path.name} has no row yet: curves from it are left out.")
    return {name: np.array(values) for name, values in columns.items()}
