"""The results of a study's finished cells: `summary.json` in their folders, or their rows in the study's tables."""

from __future__ import annotations

import json
from pathlib import Path

from shes.errors import RunFolderError
from shes.storage import storage_errors, write_atomically
from shes.studies.study import Study
from shes.studies.study_tables import Cell, CellResults, read_tables

_SUMMARY = "summary.json"


def read_summary(cell: Cell, out: Path) -> CellResults | None:
    """Return the summary of a cell in its folder below `out`; None if it is not finished.

    Raises:
        RunFolderError: It is damaged, or that of a cell with other settings.
    """
    file = out / cell.name / _SUMMARY
    try:
        found = json.loads(file.read_bytes())
        summary, digest = CellResults(row=found["row"], curve=tuple(found["curve"])), found.get("settings")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        text = f"{error} is missing" if isinstance(error, KeyError) else error
        raise RunFolderError(f"{file} cannot be read: {text}. Remove it to have it made again.") from error
    if digest is None:
        raise RunFolderError(
            f"{file} was written by an earlier version, without the settings of its run. Remove it to have it made "
            "again."
        )
    if digest != cell.digest:
        raise RunFolderError(
            f"{file.parent} holds results of other settings than cell {cell.name}, such as another --scale. Choose "
            "another folder with --out, or remove this one to have it made anew."
        )
    return summary


def write_summary(cell: Cell, out: Path, summary: CellResults) -> CellResults:
    """Write the summary of a finished cell into its folder below `out`, which may not exist yet, and return it."""
    path = out / cell.name
    text = json.dumps({"settings": cell.digest, "row": summary.row, "curve": summary.curve})
    with storage_errors(path):
        path.mkdir(parents=True, exist_ok=True)
    write_atomically(path / _SUMMARY, lambda file: file.write(text.encode()))
    return summary


def read_summaries(study: Study, out: Path) -> dict[str, CellResults]:
    """Return the summaries of the finished cells by name, from their folders or the tables, in order of execution."""
    cells = study.ordered()
    # A folder takes precedence over a row: a cell with an unfinished folder is unfinished.
    without = [cell for cell in cells if not (out / cell.name).exists()]
    tables = read_tables(without, out) if without else {}
    for cell in without:
        if cell.name in tables:
            _check_measures(study, cell, tables[cell.name], out)
    found = {cell.name: tables.get(cell.name) or read_summary(cell, out) for cell in cells}
    return {name: summary for name, summary in found.items() if summary is not None}


def _check_measures(study: Study, cell: Cell, found: CellResults, out: Path) -> None:
    """Raise RunFolderError unless the rows of a cell have what is compared and drawn."""
    metrics, curves = study.design.metrics, study.design.curves
    row = {metrics[cell.env].column, "seconds"} if cell.env in metrics else {"seconds"}
    missing = [("runs.csv", name) for name in sorted(row) if found.row.get(name) is None]
    if cell.env in curves and study.run_cell is None:  # a speed-up may be unknown
        column = curves[cell.env].column
        missing += [("curves.csv", column)] if any(point.get(column) is None for point in found.curve) else []
    for table, column in missing:
        raise RunFolderError(
            f"{out / table} has no {column} for {cell.name}. Remove the rows of this run to have it made again."
        )


def cells_left(study: Study, out: Path) -> list[Cell]:
    """Return the cells still to be run, in order, with primitives whose folder is needed but no longer exists."""
    done = set(read_summaries(study, out))
    for cell in reversed(study.ordered()):  # a cell comes after its primitive
        if cell.primitive is not None and cell.name not in done and read_summary(cell.primitive, out) is None:
            done.discard(cell.primitive.name)
    return [cell for cell in study.ordered() if cell.name not in done]
