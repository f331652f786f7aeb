"""The tables of a run, with a row per generation or evaluation: CSV and TensorBoard."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from shes.errors import RunFolderError
from shes.runs.folder import RunFolder
from shes.runs.tensorboard import Events
from shes.storage import storage_errors, write_atomically

__all__ = ["CsvTable", "Records", "Row", "csv_text", "read_csv"]

Row = dict[str, Any]


def read_csv(path: Path) -> dict[str, list[float]]:
    """Return the columns of a CSV file of numbers by name.

    Raises:
        RunFolderError: The file is missing or damaged.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        return {name: [float(row[name]) for row in rows] for name in (rows[0] if rows else {})}
    except (OSError, ValueError, TypeError) as error:
        raise RunFolderError(f"{path} cannot be read as a table of numbers: {error}.") from error


def csv_text(rows: Iterable[Sequence[Any]]) -> str:
    """Return `rows` as the text of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


class CsvTable:
    """A CSV file to which whole rows are appended; numbers read back bit-identically."""

    def __init__(self, path: Path, keep_until: int) -> None:
        """Open `path` and remove the rows after generation `keep_until`.

        Raises:
            StorageError: The file cannot be written.
            RunFolderError: The file is damaged.
        """
        self._path = path
        self._columns: list[str] | None = None
        if path.exists():
            self._truncate(keep_until)

    def _truncate(self, keep_until: int) -> None:
        with storage_errors(self._path), self._path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        if not rows:
            return
        self._columns = rows[0]
        try:
            kept = [row for row in rows[1:] if len(row) == len(rows[0]) and int(row[0]) <= keep_until]
        except ValueError as error:
            raise RunFolderError(f"{self._path} is damaged: {error}. Restore it from a copy.") from error
        if not kept:  # the header may be incomplete: it is written again with the first row
            self._columns = None
            write_atomically(self._path, lambda file: file.write(b""))
            return
        write_atomically(self._path, lambda file: file.write(csv_text([rows[0], *kept]).encode()))

    def add(self, row: Row) -> None:
        """Append `row`, with one write.

        Raises:
            StorageError: The file cannot be written.
        """
        header = [] if self._columns else [list(row)]
        self._columns = self._columns or list(row)
        text = csv_text([*header, [repr(row[name]) for name in self._columns]])
        with storage_errors(self._path), self._path.open("a", encoding="utf-8") as file:
            file.write(text)


class Records:
    """The tables of a run and its TensorBoard events."""

    def __init__(
        self,
        folder: RunFolder,
        generation: int,
        env_steps: int = 0,
        hyperparameters: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        """Open the tables and remove the rows after `generation`, which ended at `env_steps`."""
        self._progress = CsvTable(folder.progress, generation)
        self._evaluation = CsvTable(folder.evaluation, generation)
        self._events = Events(folder.tensorboard, generation, env_steps, hyperparameters)

    def add_progress(self, row: Row) -> None:
        """Add the row of a generation."""
        self._progress.add(row)
        self._events.add("progress", row)

    def add_evaluation(self, row: Row) -> None:
        """Add the row of an evaluation."""
        self._evaluation.add(row)
        self._events.add("evaluation", row)

    def close(self) -> None:
        """Close the event files."""
        self._events.close()
