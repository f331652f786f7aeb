"""The tables of a run, with a row per generation or evaluation: CSV and TensorBoard."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from shes.errors import RunFolderError
from shes.runs.folder import RunFolder
from shes.runs.tensorboard import Events
from shes.storage import storage_errors, write_atomically

_MOST_TEXT = 200  # characters of the cause in a message, which may quote the file

Row = dict[str, Any]


def read_csv(path: Path) -> dict[str, list[float]]:
    """Return the columns of a CSV file of numbers by name; raise RunFolderError if it is missing or damaged.

    A last row without the end of its line is left out: it is being written, or a crash has cut it off.
    """
    header, *rows = _read_rows(path, are_whole=True) or [[]]
    if (short := next((i for i, row in enumerate(rows, start=1) if len(row) < len(header)), None)) is not None:
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
    """Return the value of a column in the last whole row of a table; None without one. A crash may cut off a row."""
    header, *rows = (_read_rows(path) if path.exists() else []) or [[]]
    whole = [row for row in rows if len(row) == len(header) and "" not in row]
    try:
        return float(whole[-1][header.index(column)]) if whole and column in header else None
    except ValueError as error:
        raise _damaged(path, error) from error


def _read_rows(path: Path, *, are_whole: bool = False) -> list[list[str]]:
    """Return the rows of a CSV file, its header first; those without a value are left out.

    If `are_whole`, so is a last row without the end of its line.
    """
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise _damaged(path, OSError("it is not a regular file"))
    try:
        with path.open(newline="", encoding="utf-8") as file:
            text = file.read()
        rows = list(csv.reader(io.StringIO(text)))
        return [row for row in (rows[:-1] if are_whole and not text.endswith("\n") else rows) if row]
    except (OSError, ValueError, csv.Error) as error:
        raise _damaged(path, error) from error


def _kept_rows(path: Path, generation: int) -> list[list[str]]:
    """Return the header and the rows up to `generation`; raise RunFolderError if one of them is not whole.

    Later ones need not be, and the last may be cut off within its generation.
    """
    header, *rows = _read_rows(path) or [[]]
    if rows and len(rows[-1]) == 1:
        rows.pop()
    try:
        kept = [row for row in rows if int(row[0]) <= generation]
        if (short := next((row for row in kept if len(row) != len(header)), None)) is not None:
            raise RunFolderError(
                f"{path} is damaged: the row of generation {short[0]} has {len(short)} values for {len(header)} "
                "columns. Restore the file from a copy, or empty it to go on without the rows so far."
            )
        for row in kept:
            [float(value) for value in row]
    except ValueError as error:
        raise _damaged(path, error) from error
    return [header, *kept]


def _damaged(path: Path, error: Exception) -> RunFolderError:
    text = " ".join(str(error).split())[:_MOST_TEXT]
    return RunFolderError(f"{path} cannot be read as a table of numbers: {text}. Restore it from a copy.")


def check_tables(folder: RunFolder, generation: int, *, owes_evaluation: bool = False) -> None:
    """Raise RunFolderError unless the tables of a run are there, can be read and are whole after `generation`.

    The first evaluation, of generation 1, may be pending: then there is no table of evaluations. A table may be empty:
    somebody goes on without its rows.
    """
    for path, until in ((folder.progress, generation), (folder.evaluation, generation - owes_evaluation)):
        if not generation:
            return
        if path == folder.evaluation and generation == 1 and owes_evaluation and not path.exists():
            continue
        if not path.is_file():
            raise RunFolderError(
                f"{path} is missing, but the run has made {generation} generations. Restore it from a copy, or make an "
                "empty file of this name to go on without the rows so far."
            )
        rows = _kept_rows(path, until)[1:]
        if path == folder.progress and rows and int(rows[-1][0]) != generation:
            raise RunFolderError(
                f"{path} ends with generation {rows[-1][0]}, but the run has made {generation}: rows are missing. "
                "Restore it from a copy, or empty it to go on without the rows so far."
            )


def csv_text(rows: Iterable[Sequence[Any]]) -> str:
    """Return `rows` as the text of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


class CsvTable:
    """A CSV file to which whole rows are appended; numbers read back bit-identically."""

    def __init__(self, path: Path, keep_until: int) -> None:
        """Open `path` and remove the rows after generation `keep_until`; raise RunFolderError if it is damaged."""
        self._path = path
        self._columns: list[str] | None = None
        self._is_on_disk = True
        if path.exists():
            self._truncate(keep_until)

    def _truncate(self, keep_until: int) -> None:
        header, *kept = _kept_rows(self._path, keep_until) or [[]]
        self._columns = header
        if not kept:  # the header may be incomplete: it is written again with the first row
            self._columns = None
            write_atomically(self._path, lambda file: file.write(b""))
            return
        write_atomically(self._path, lambda file: file.write(csv_text([header, *kept]).encode()))

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


class Records:
    """The tables of a run and its TensorBoard events."""

    def __init__(
        self,
        folder: RunFolder,
        generation: int,
        env_steps: int = 0,
        hyperparameters: Mapping[str, Any] = MappingProxyType({}),
        *,
        owes_evaluation: bool = False,
    ) -> None:
        """Open the tables and remove the rows after `generation`, which ended at `env_steps`.

        If its evaluation is pending, it has no row either.
        """
        kept = {folder.progress: generation, folder.evaluation: generation - owes_evaluation}
        self._tables = {path.stem: CsvTable(path, until) for path, until in kept.items()}
        self._events = Events(folder.tensorboard, generation, env_steps, hyperparameters)

    def add(self, table: str, row: Row) -> None:
        """Add the row of a generation to `progress`, or that of an evaluation to `evaluation`."""
        self._tables[table].add(row)
        self._events.add(table, row)

    def flush(self) -> None:
        """Let the rows of the tables be on the disk: a checkpoint there needs those before it."""
        for table in self._tables.values():
            table.flush()

    def close(self) -> None:
        """Close the event files."""
        self._events.close()
