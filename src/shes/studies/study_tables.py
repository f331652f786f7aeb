"""The tables of a study. A study can be continued from them alone, without the run folders."""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from shes.errors import RunFolderError
from shes.runs.tables import Row, csv_text
from shes.storage import write_atomically
from shes.studies.provenance_columns import PROVENANCE
from shes.training.make_config import preset_values

_SETTINGS = "settings"  # the column with the digest of a row's settings
_EVALUATIONS = "evaluations"  # the column of runs.csv with the number of rows that the run has in curves.csv
_PLACE = ("group", "variant", "env", "seed")
_WORDS = frozenset({"group", "variant", "env", "kind", _SETTINGS, *PROVENANCE})  # columns of text


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One run of a study."""

    group: str
    """Group of variants."""
    variant: str
    """Name of the changed settings; runs of a variant differ only in the seed."""
    env: str
    seed: int
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Settings by name that differ from those of the preset."""
    primitive: Cell | None = None
    """The cell whose primitive it takes."""
    preset: str = "laptop"

    @property
    def name(self) -> str:
        """Its name, which is the path of its run folder below that of the study."""
        return f"{self.env}/{self.group}/{self.variant}/seed-{self.seed}"

    @property
    def body(self) -> str:
        """Name of the robot in that of its environment: `point` or `ant`."""
        return self.env.partition("-")[0]

    @property
    def identity(self) -> Row:
        """The columns that identify it in tables."""
        return {"group": self.group, "variant": self.variant, "env": self.env, "seed": self.seed}

    @cached_property
    def digest(self) -> str:
        """Digest of its settings, those of its preset and of its primitive among them: eight hexadecimal digits.

        It is the same for every seed.
        """
        values = {**preset_values(self.env, self.preset, self.settings), **self.settings}
        source = self.primitive
        primitive = None if source is None else [source.env, source.group, source.variant, source.digest]
        text = json.dumps([values, primitive], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:8]


@dataclass(frozen=True, kw_only=True)
class CellResults:
    """The results of a cell."""

    row: Row
    """Its row of `runs.csv`."""
    curve: tuple[Row, ...]
    """Its rows of `curves.csv`."""


def write_tables(cells: Sequence[Cell], summaries: Mapping[str, CellResults], out: Path) -> None:
    """Write `runs.csv`, a row per finished cell, and `curves.csv`, a row per evaluation, in the order of `cells`.

    Existing rows of other cells, and of cells that are not finished, are kept, after these.
    """
    found = [(cell, summaries[cell.name]) for cell in cells if cell.name in summaries]
    curves = [{**row, _SETTINGS: cell.digest} for cell, summary in found for row in summary.curve]
    runs = [{**summary.row, _EVALUATIONS: len(summary.curve), _SETTINGS: cell.digest} for cell, summary in found]
    own = {_key(cell) for cell, _ in found}
    for name, rows in (("curves.csv", curves), ("runs.csv", runs)):
        others = [row for row in _read(out / name) if _place(row) not in own]
        write_csv(out / name, [*rows, *others])


def read_tables(cells: Sequence[Cell], out: Path) -> dict[str, CellResults]:
    """Return the summaries of `cells` in the tables at `out`, by name; rows with other settings are ignored.

    Raises:
        RunFolderError: A table is damaged, or has some rows of a run twice or not at all.
    """
    runs: dict[tuple[Any, ...], list[Row]] = {}
    curves: dict[tuple[Any, ...], list[Row]] = {}
    for table, found in (("runs", runs), ("curves", curves)):
        for row in _read(out / f"{table}.csv"):
            found.setdefault(_place(row), []).append(row)
    summaries: dict[str, CellResults] = {}
    for cell in cells:
        rows, curve = runs.get(_key(cell), []), curves.get(_key(cell), [])
        if not rows or not (curve or rows[0].get(_EVALUATIONS)):
            continue
        if len(rows) > 1:
            raise RunFolderError(f"{out / 'runs.csv'} has {len(rows)} rows of {cell.name}. Keep the one that is right.")
        evaluations = rows[0].get(_EVALUATIONS)  # unknown in a table of an earlier version
        if evaluations not in (None, len(curve)):
            raise RunFolderError(
                f"{out / 'curves.csv'} has {len(curve)} rows of {cell.name}, whose run had {evaluations} evaluations. "
                "Restore the file, or remove the run's rows from both tables to have it made again."
            )
        summaries[cell.name] = CellResults(row=_results(rows[0]), curve=tuple(map(_results, curve)))
    return summaries


def _key(cell: Cell) -> tuple[Any, ...]:
    return _place({**cell.identity, _SETTINGS: cell.digest})


def _results(row: Row) -> Row:
    """Return a row without what tables have beside the results."""
    return {name: value for name, value in row.items() if name not in (_SETTINGS, _EVALUATIONS)}


def _place(row: Row) -> tuple[Any, ...]:
    return tuple(row[name] for name in (*_PLACE, _SETTINGS))


def _read(path: Path) -> list[Row]:
    """Return the rows of a table, none if it does not exist; raise RunFolderError if it is damaged."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        for row in rows[:1]:
            _check_columns(row)
        return [_converted(row, number) for number, row in enumerate(rows, start=2)]
    except FileNotFoundError:
        return []
    except (OSError, ValueError, TypeError) as error:
        text = error.strerror if isinstance(error, OSError) else error
        raise RunFolderError(f"{path} cannot be read as a table of runs: {text}. Move it elsewhere.") from error


def _check_columns(row: Mapping[str, str]) -> None:
    missing = {*_PLACE, _SETTINGS} - row.keys()
    if missing:
        raise ValueError(f"it has no column {', '.join(sorted(missing))}")


def _converted(row: Mapping[str, str], line: int) -> Row:
    if None in row or None in row.values():  # so the csv module reports rows that are longer or shorter
        raise ValueError(f"line {line} does not have a value for each column")
    try:
        return {name: _value(name, text) for name, text in row.items()}
    except ValueError as error:
        raise ValueError(f"line {line}: {error}") from None


def _value(name: str, text: str) -> Any:
    if not text:
        return None
    if name in _WORDS:
        return text
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{name} is {text}")
    return int(text) if text.lstrip("-").isdigit() else value


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write `rows` as a CSV file, atomically; None and missing columns are empty."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = csv_text([columns, *([row.get(name) for name in columns] for row in rows)]) if rows else ""
    write_atomically(path, lambda file: file.write(text.encode()))
