"""The tables of a run, CSV files with a row per generation or evaluation, and a dozen TensorBoard charts of them."""

from __future__ import annotations

import csv
import io
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from time import time
from typing import Any

import numpy as np

from shes.errors import RunFolderError
from shes.runs.checkpoint import short_text
from shes.runs.folder import RunFolder
from shes.storage import storage_errors, write_atomically
from shes.types import F64Array

Row = dict[str, Any]
_CHARTS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "evaluation": {"evaluation": ("score_mean", "return_mean", "success_rate")},
    "progress": {
        "training": ("score_mean", "*_return_mean"),
        "update": ("*_update_ratio", "*_halves_cosine"),
        "episodes": ("episode_steps_mean",),
        "speed": ("env_steps_per_s",),
    },
}
"""Columns with a chart, by table and group; `*` is any level. `docs/how-to/track.md` lists them."""
_COMPARED = ("evaluation/score_mean", "evaluation/return_mean")
"""Charts in the tab of the hyperparameters."""


def read_csv(path: Path) -> dict[str, F64Array]:
    """Return the columns of a CSV file of numbers by name, each [rows]; none before the first row.

    A last row without the end of its line is left out: it is being written, or a crash has cut it off. Raise
    RunFolderError if the file is damaged.
    """
    header, rows = _read(path) if path.exists() else ([], {})
    columns = np.array([row[: len(header)] for row in rows.values()], dtype=np.float64).T
    return dict(zip(header, columns, strict=False))


def last_value(path: Path, column: str) -> float:
    """Return the last value in a column of a CSV file; 0 before the first row."""
    return float(read_csv(path).get(column, [0.0])[-1])


def trained_minutes(folder: RunFolder) -> float:
    """Return for how many minutes of wall-clock time a run has been trained; 0 before its first row."""
    return last_value(folder.progress, "wall_time_s") / 60


def _read(path: Path) -> tuple[list[str], dict[int, list[str]]]:
    """Return the header and, by generation, the rows of a table, without a last one that is not whole."""
    try:
        text = path.read_text(encoding="utf-8")
        lines = list(csv.reader(io.StringIO(text)))
        header, *rows = [row for row in (lines if text.endswith("\n") else lines[:-1]) if row] or [[]]
        for number, row in enumerate(rows, start=1):
            if len(row) < len(header):
                raise ValueError(  # noqa: TRY301 - worded below, as every fault of a table
                    f"row {number} below the header has {len(row)} values for {len(header)} columns"
                )
            list(map(float, row))  # raises for a word
        return header, {int(row[0]): row for row in rows}
    except (OSError, ValueError, csv.Error) as error:
        raise RunFolderError(
            f"{path} cannot be read as a table of numbers: {short_text(error)}. Restore it from a copy, or let it be "
            "an empty file, to go on without the rows so far."
        ) from error


def csv_text(rows: Iterable[Sequence[Any]]) -> str:
    """Return `rows` as the text of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


class CsvTable:
    """A CSV file to which whole rows are appended; numbers read back bit-identically."""

    def __init__(self, path: Path, keep_until: int, *, has_every_row: bool = False) -> None:
        """Open `path` and remove the rows after generation `keep_until`, which may be cut off."""
        self._path = path
        header, rows = _read(path) if keep_until or path.is_file() else ([], {})
        kept = {generation: row for generation, row in rows.items() if generation <= keep_until}
        if has_every_row and kept and max(kept) != keep_until:
            raise RunFolderError(
                f"{path} ends with generation {max(kept)}, but the run has made {keep_until}: rows are missing. "
                "Restore it from a copy, or let it be an empty file, to go on without the rows so far."
            )
        self._columns = header if kept else []  # a header alone is written again with the first row
        if path.is_file():
            text = csv_text([header, *kept.values()]) if kept else ""
            write_atomically(path, lambda file: file.write(text.encode()))

    def add(self, row: Row) -> None:
        """Append `row` with one write, and let it be on the disk, whatever happens to the machine."""
        header = [] if self._columns else [list(row)]
        self._columns = self._columns or list(row)
        if unknown := [name for name in self._columns if name not in row]:
            raise RunFolderError(
                f"{self._path} has columns that this run does not write: {', '.join(unknown)}. Remove them, or restore "
                "the table from a copy."
            )
        if not header and not self._path.exists():
            raise RunFolderError(f"{self._path} was removed while the run went on. Restore it, then `shes resume`.")
        text = csv_text([*header, [repr(row[name]) for name in self._columns]])
        with storage_errors(self._path), self._path.open("a", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())


class Events:
    """The event file of a run, written in this thread.

    The thread of tensorboardX's `SummaryWriter` dies when the disk is full, and then blocks the run for ever.
    """

    def __init__(self, folder: Path, generation: int, hyperparameters: Mapping[str, Any]) -> None:
        """Open a file that supersedes the events of earlier files after `generation`.

        The hyperparameters are written at generation 0 alone.
        """
        # It would import PyTorch, which takes seconds and 600 MB, only to recognise its tensors.
        sys.modules.setdefault("torch", None)  # type: ignore[arg-type] - "not installed"
        from tensorboardX.event_file_writer import EventsWriter  # slow to import
        from tensorboardX.proto.event_pb2 import Event, SessionLog  # type: ignore[attr-defined] - made when imported
        from tensorboardX.summary import hparams, scalar

        if sys.modules["torch"] is None:
            del sys.modules["torch"]

        self._folder, self._event, self._scalar = folder, Event, scalar
        with storage_errors(folder):
            folder.mkdir(exist_ok=True)
            # The name contains the second; two parts of a run that begin in the same second need different files.
            self._writer = EventsWriter(str(folder / "events"), f".{os.getpid()}.{generation}")
            if generation:
                start = SessionLog(status=SessionLog.START)
                self._writer.write_event(Event(wall_time=time(), step=generation + 1, session_log=start))
                return
            plain = {
                name: it if isinstance(it, bool | int | float) else str(it) for name, it in hyperparameters.items()
            }
            for summary in hparams(plain, dict.fromkeys(_COMPARED))[:2]:  # the third says that the run has ended
                self._writer.write_event(Event(wall_time=time(), summary=summary))

    def add(self, table: str, row: Mapping[str, Any]) -> None:
        """Write the charts of a row of `table`, without values that are not finite."""
        with storage_errors(self._folder):
            for group, patterns in _CHARTS[table].items():
                for name in row:
                    if any(fnmatchcase(name, pattern) for pattern in patterns) and np.isfinite(row[name]):
                        summary = self._scalar(f"{group}/{name}", row[name])
                        event = self._event(wall_time=time(), step=row["generation"], summary=summary)
                        self._writer.write_event(event)
            self._writer.flush()  # before the checkpoint marks this generation as done

    def close(self) -> None:
        """Close the file."""
        with storage_errors(self._folder):
            self._writer.close()
