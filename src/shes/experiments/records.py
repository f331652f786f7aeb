"""What a run writes down every generation: CSV always, TensorBoard beside it."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
from tensorboardX import SummaryWriter

from shes.algorithm import GenerationReport
from shes.errors import RunFolderError
from shes.experiments.run_folder import RunFolder
from shes.experiments.storage import storage_errors, write_atomically
from shes.types import CONTROLLER, LEVEL_NAMES, PRIMITIVE, IntArray

__all__ = ["CsvTable", "Records", "progress_row", "read_csv"]

Row = dict[str, Any]


def progress_row(report: GenerationReport, wall_time_s: float, generation_s: float) -> Row:
    """Return the row of `progress.csv` for a generation. Columns that end in `_s` are times and rates."""
    results = report.results
    steps = int(results.steps.sum())
    row: Row = {
        "generation": report.state.generation,
        "env_steps": report.state.env_steps,
        "wall_time_s": round(wall_time_s, 3),
        "env_steps_per_s": round(steps / generation_s, 1),
    }
    for level in (CONTROLLER, PRIMITIVE):
        row[f"{LEVEL_NAMES[level]}_return_mean"] = float(results.fitness[level].mean())
        row[f"{LEVEL_NAMES[level]}_return_max"] = float(results.fitness[level].max())
    row |= {
        "score_mean": float(results.score.mean()),
        "success_rate": float(results.success.mean()),
        "episode_steps_mean": float(results.steps.mean()),
        "terminated_rate": float(results.has_terminated.mean()),
        "diverged_episodes": int(results.has_diverged.sum()),
    }
    for level, state in enumerate(report.state.levels):
        indices = report.noise_index[level]
        row[f"{LEVEL_NAMES[level]}_noise_distinct"] = len(np.unique(indices))
        row[f"{LEVEL_NAMES[level]}_noise_overlapping"] = _overlapping(indices, len(state.theta))
        row[f"{LEVEL_NAMES[level]}_theta_norm"] = float(np.linalg.norm(state.theta.astype(np.float64)))
    row |= {"rollout_s": round(report.rollout_s, 4), "update_s": round(report.update_s, 4)}
    return row


def _overlapping(indices: IntArray, dim: int) -> int:
    """Return how many noise vectors share normals with another one of their generation."""
    ordered = np.sort(indices)
    touches = np.diff(ordered) < dim
    return int((np.concatenate([touches, [False]]) | np.concatenate([[False], touches])).sum())


def read_csv(path: Path) -> dict[str, list[float]]:
    """Return the columns of a CSV file of a run.

    Raises:
        RunFolderError: The file is missing or damaged.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        return {name: [float(row[name]) for row in rows] for name in (rows[0] if rows else {})}
    except (OSError, ValueError, TypeError) as error:
        raise RunFolderError(f"{path} cannot be read as a table of numbers: {error}.") from error


class CsvTable:
    """A CSV file to which whole rows are added; numbers are written so that they read back to the bit."""

    def __init__(self, path: Path, keep_until: int) -> None:
        """Open `path`, keeping its rows up to generation `keep_until`: later ones are done again.

        Raises:
            StorageError: It cannot be written.
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
        kept = [row for row in rows[1:] if len(row) == len(rows[0]) and int(row[0]) <= keep_until]
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([rows[0], *kept])
        write_atomically(self._path, lambda file: file.write(text.getvalue().encode()))

    def add(self, row: Row) -> None:
        """Add `row`, with one write.

        Raises:
            StorageError: It cannot be written.
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        if self._columns is None:
            self._columns = list(row)
            writer.writerow(self._columns)
        writer.writerow([repr(row[name]) for name in self._columns])
        with storage_errors(self._path), self._path.open("a", encoding="utf-8") as file:
            file.write(text.getvalue())


class Records:
    """The tables of a run and its TensorBoard events."""

    def __init__(self, folder: RunFolder, generation: int) -> None:
        """Go on after `generation`: what the tables say of later ones is forgotten."""
        self._progress = CsvTable(folder.progress, generation)
        self._evaluation = CsvTable(folder.evaluation, generation)
        with storage_errors(folder.tensorboard):
            self._events = SummaryWriter(str(folder.tensorboard), purge_step=generation + 1 if generation else None)

    def add_progress(self, row: Row) -> None:
        """Write down a generation."""
        self._progress.add(row)
        self._add_events("progress", row)

    def add_evaluation(self, row: Row) -> None:
        """Write down an evaluation."""
        self._evaluation.add(row)
        self._add_events("evaluation", row)

    def close(self) -> None:
        """Finish the event file."""
        self._events.close()

    def _add_events(self, group: str, row: Row) -> None:
        for name, value in row.items():
            if name != "generation":
                self._events.add_scalar(f"{group}/{name}", value, row["generation"])
