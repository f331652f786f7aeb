"""The results of an experiment: `summary.json` of each finished run, and the tables `runs.csv` and `curves.csv`.

Tables and figures can be made from the two CSV files alone, and an experiment can go on from them.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from experiments.design import Experiment, Place, Run
from shes.errors import RunFolderError
from shes.runs.tables import Row, csv_text
from shes.storage import storage_errors, write_atomically
from shes.types import F64Array

SUMMARY = "summary.json"
_DIGEST = "settings"  # the column with the digest of a row's settings
_PLACE = ("group", "variant", "env", "seed")
_WORDS = frozenset({"group", "variant", "env", "hardware", "versions", "commit", _DIGEST})  # columns of text


@dataclass(frozen=True, kw_only=True)
class RunResults:
    """The results of a finished run."""

    row: Row
    """Its row of `runs.csv`."""
    curve: Sequence[Row]
    """Its rows of `curves.csv`."""

    def column(self, name: str) -> F64Array:
        """Return a column of the curve."""
        return np.array([row[name] for row in self.curve], dtype=np.float64)


class PlacedResults:
    """Results by environment, group and variant, ordered by seed, with the comparisons made of them."""

    def __init__(
        self, experiment: Experiment, results: Mapping[str, RunResults], comparisons: Sequence[Row] = ()
    ) -> None:
        self.experiment = experiment
        self.comparisons = comparisons
        self.runs: dict[Place, list[RunResults]] = {}
        for run in sorted(experiment.runs, key=lambda run: run.seed):
            if run.name in results:
                self.runs.setdefault(run.place, []).append(results[run.name])
        self.places = [place for place in dict.fromkeys(run.place for run in experiment.runs) if place in self.runs]
        """Places that have results, in the order of the experiment."""

    def scores(self, place: Place) -> F64Array:
        """Return the compared measure of every seed."""
        column = self.experiment.metrics[place[0]].column
        return np.array([run.row[column] for run in self.runs.get(place, ())], dtype=np.float64)

    def has(self, *groups: str) -> bool:
        """Return whether a variant of one of `groups`, other than the base, has results."""
        return any(place[1] in groups and place[1:] != self.experiment.base for place in self.places)


def read_summary(run: Run, out: Path) -> RunResults | None:
    """Return the summary of a run in its folder below `out`; None if it is not finished."""
    file = out / run.name / SUMMARY
    try:
        found = json.loads(file.read_bytes())
        results, digest = RunResults(row=found["row"], curve=found["curve"]), found[_DIGEST]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(f"{file} cannot be read: {error}. Remove it to have it made again.") from error
    if digest != run.digest:
        raise RunFolderError(
            f"{file.parent} holds results of other settings than run {run.name}, such as another --scale. Choose "
            "another folder with --out, or remove this one to have it made anew."
        )
    return results


def write_summary(run: Run, out: Path, results: RunResults) -> None:
    """Write the summary of a finished run into its folder below `out`."""
    text = json.dumps({_DIGEST: run.digest, "row": results.row, "curve": list(results.curve)})
    with storage_errors(out / run.name):
        (out / run.name).mkdir(parents=True, exist_ok=True)
    write_atomically(out / run.name / SUMMARY, lambda file: file.write(text.encode()))


def read_results(experiment: Experiment, out: Path) -> dict[str, RunResults]:
    """Return the results of the finished runs by name, in order of execution.

    A run without a folder has those of its rows in the tables, if they are of the same settings.
    """
    runs = experiment.ordered()
    without = {run.name for run in runs if not (out / run.name).exists()}
    tables = read_tables(experiment, out) if without else {}
    found = {run.name: tables.get(run.name) if run.name in without else read_summary(run, out) for run in runs}
    return {name: results for name, results in found.items() if results is not None}


def read_tables(experiment: Experiment, out: Path, *, has_any_settings: bool = False) -> dict[str, RunResults]:
    """Return the results of runs in the tables at `out` by name; rows of other settings only if they may be any."""
    curves: dict[tuple[Any, ...], list[Row]] = {}
    for row in _read(out / "curves.csv"):
        curves.setdefault(_key(row), []).append({name: row[name] for name in row if name != _DIGEST})
    rows = {_key(row): row for row in _read(out / "runs.csv")}
    found: dict[str, RunResults] = {}
    for run in experiment.ordered():
        row = rows.get(_key(run.identity))
        if row is not None and (has_any_settings or row[_DIGEST] == run.digest):
            own = {name: row[name] for name in row if name != _DIGEST}
            found[run.name] = RunResults(row=own, curve=curves.get(_key(run.identity), []))
    return found


def write_tables(experiment: Experiment, results: Mapping[str, RunResults], out: Path) -> None:
    """Write `runs.csv`, a row per finished run, and `curves.csv`, a row per evaluation; keep rows of other runs."""
    found = [(run, results[run.name]) for run in experiment.ordered() if run.name in results]
    curves = [{**row, _DIGEST: run.digest} for run, each in found for row in each.curve]
    runs = [{**each.row, _DIGEST: run.digest} for run, each in found]
    own = {_key(run.identity) for run, _ in found}
    for name, rows in (("curves.csv", curves), ("runs.csv", runs)):
        write_csv(out / name, [*rows, *(row for row in _read(out / name) if _key(row) not in own)])


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write `rows` as a CSV file, atomically; None and missing columns are empty."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = csv_text([columns, *([row.get(name) for name in columns] for row in rows)]) if rows else ""
    write_atomically(path, lambda file: file.write(text.encode()))


def joined(texts: Iterable[str | None]) -> str | None:
    """Return the different ones of `texts` after each other; None if there is none."""
    return "; ".join(dict.fromkeys(text for text in texts if text)) or None


def _key(row: Row) -> tuple[Any, ...]:
    return tuple(row[name] for name in _PLACE)


def _read(path: Path) -> list[Row]:
    """Return the rows of a table, none if it does not exist; raise RunFolderError if it is damaged."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            table = csv.DictReader(file, strict=True)
            rows = [{name: _value(name, text) for name, text in row.items()} for row in table]
    except FileNotFoundError:
        return []
    except (OSError, ValueError, TypeError, csv.Error) as error:
        raise RunFolderError(f"{path} cannot be read as a table of runs: {error}. Move it elsewhere.") from error
    if missing := [name for name in (*_PLACE, _DIGEST) if rows and name not in rows[0]]:
        raise RunFolderError(f"{path} is no table of runs: it has no column {', '.join(missing)}. Move it elsewhere.")
    return rows


def _value(name: str, text: Any) -> Any:
    if not isinstance(text, str):  # so the csv module reports rows that are longer or shorter
        raise TypeError("a line does not have a value for each column")
    if not text or name in _WORDS:
        return text or None
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{name} is {text}")
    return int(text) if text.lstrip("-").isdigit() else value
