"""The tables of a run: CSV files with a row per generation or evaluation."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from shes.errors import RunFolderError
from shes.runs.folder import RunFolder
from shes.storage import storage_errors, write_atomically

_MOST_TEXT = 200  # characters of the cause in a message, which may quote the file

Row = dict[str, Any]


def read_csv(path: Path) -> dict[str, list[float]]:
    """Return the columns of a CSV file of numbers by name; raise RunFolderError if it is missing or damaged.

    A last row without the end of its line is left out: it is being written, or a crash has cut it off.
    """
    header, *rows = _read_rows(path, are_whole=True) or [[]]
    short = next((number for number, row in enumerate(rows, start=1) if len(row) < len(header)), None)
    if short is not None:
        text = f"row {short} below the header has {len(rows[short - 1])} values for {len(header)} columns"
        raise _damaged(path, ValueError(text))
    try:
        return {name: [float(row[i]) for row in rows] for i, name in enumerate(header if rows else ())}
    except ValueError as error:
        raise _damaged(path, error) from error


def read_wall_time(path: Path) -> float:
    """Return the wall-clock seconds of a run so far, from its `progress.csv` at `path`; 0 before the first row."""
    return _last_value(path, "wall_time_s") or 0.0


def read_process_time(path: Path) -> float:
    """Return the processor seconds of a run's own process so far; its wall-clock time if it was not recorded."""
    seconds = _last_value(path, "process_time_s")
    return read_wall_time(path) if seconds is None else seconds


def trained_minutes(folder: RunFolder) -> float:
    """Return for how many minutes of wall-clock time a run has been trained; 0 before its first row."""
    return read_wall_time(folder.progress) / 60


def _last_value(path: Path, column: str) -> float | None:
    values = read_csv(path).get(column) if path.exists() else None
    return values[-1] if values else None


def _read_rows(path: Path, *, are_whole: bool = False) -> list[list[str]]:
    """Return the rows of a CSV file, its header first; those without a value are left out.

    If `are_whole`, so is a last row without the end of its line.
    """
    try:
        text = path.read_text(encoding="utf-8")
        rows = list(csv.reader(io.StringIO(text)))
        return [row for row in (rows[:-1] if are_whole and not text.endswith("\n") else rows) if row]
    except (OSError, ValueError, csv.Error) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> RunFolderError:
    text = " ".join(str(error).split())[:_MOST_TEXT]
    return RunFolderError(f"{path} cannot be read as a table of numbers: {text}. Restore it from a copy.")


def csv_text(rows: Iterable[Sequence[Any]]) -> str:
    """Return `rows` as the text of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


class CsvTable:
    """A CSV file to which whole rows are appended; numbers read back bit-identically."""

    def __init__(self, path: Path, keep_until: int, *, has_every_row: bool = False) -> None:
        """Open `path` and remove the rows after generation `keep_until`, which may be cut off.

        Raises:
            RunFolderError: The file is damaged, or missing after the first generation; or rows are missing although it
                `has_every_row`. An empty file is allowed: the run goes on without the rows so far.
        """
        self._path = path
        self._columns: list[str] | None = None
        self._is_on_disk = True
        if path.is_file():
            self._truncate(keep_until, has_every_row=has_every_row)
        elif keep_until:
            raise RunFolderError(
                f"{path} is missing, but the run has made {keep_until} generations. Restore it from a copy, or make an "
                "empty file of this name to go on without the rows so far."
            )

    def _truncate(self, keep_until: int, *, has_every_row: bool) -> None:
        header, *rows = _read_rows(self._path) or [[]]
        if rows and len(rows[-1]) == 1:  # it may be cut off within its generation
            rows.pop()
        try:
            kept = [row for row in rows if int(row[0]) <= keep_until]
            short = next((row for row in kept if len(row) != len(header)), None)
            for row in kept:
                [float(value) for value in row]
        except ValueError as error:
            raise _damaged(self._path, error) from error
        if short is not None:
            raise RunFolderError(
                f"{self._path} is damaged: the row of generation {short[0]} has {len(short)} values for {len(header)} "
                "columns. Restore the file from a copy, or empty it to go on without the rows so far."
            )
        if has_every_row and kept and int(kept[-1][0]) != keep_until:
            raise RunFolderError(
                f"{self._path} ends with generation {kept[-1][0]}, but the run has made {keep_until}: rows are "
                "missing. Restore it from a copy, or empty it to go on without the rows so far."
            )
        self._columns = header if kept else None  # a header alone may be cut off: the first row writes it again
        text = csv_text([header, *kept]) if kept else ""
        write_atomically(self._path, lambda file: file.write(text.encode()))

    def add(self, row: Row) -> None:
        """Append `row`, with one write; raise StorageError if that fails.

        Raises:
            RunFolderError: The table has a column that `row` does not have.
        """
        header = [] if self._columns else [list(row)]
        self._columns = self._columns or list(row)
        if unknown := [name for name in self._columns if name not in row]:
            raise RunFolderError(
                f"{self._path} has columns that this run does not write: {', '.join(unknown)}. Remove them, or restore "
                "the table from a copy."
            )
        text = csv_text([*header, [repr(row[name]) for name in self._columns]])
        with storage_errors(self._path), self._path.open("a", encoding="utf-8") as file:
            file.write(text)
        self._is_on_disk = False

    def flush(self) -> None:
        """Let the rows be on the disk, whatever happens to the machine; raise StorageError if that fails."""
        if not self._is_on_disk:
            with storage_errors(self._path), self._path.open("rb") as file:
                os.fsync(file.fileno())
            self._is_on_disk = True
