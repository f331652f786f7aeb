"""What a run writes down every generation: CSV always, TensorBoard beside it."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path
from time import time
from typing import Any

import numpy as np
from tensorboardX.event_file_writer import EventsWriter
from tensorboardX.proto.event_pb2 import Event, SessionLog  # type: ignore[attr-defined] - made when imported
from tensorboardX.summary import scalar

from shes.algorithms.evolution.algorithm import GenerationReport
from shes.errors import RunFolderError
from shes.es.level import select_fitness
from shes.hierarchy.episodes import PARTS
from shes.runs.folder import RunFolder
from shes.storage import storage_errors, write_atomically
from shes.types import F64Array, IntArray

__all__ = ["CsvTable", "Records", "progress_row", "read_csv"]

Row = dict[str, Any]


def progress_row(report: GenerationReport, wall_time_s: float, generation_s: float) -> Row:
    """Return the row of `progress.csv` for a generation. Columns that end in `_s` are times and rates.

    `physics_s`, `policy_s` and `task_s` are added up over the workers; NaN stands for what a generation has not.
    """
    results, levels = report.results, report.state.levels
    populations = [each for each in (report.population, report.branches) if each is not None]
    row: Row = {
        "generation": report.state.generation,
        "env_steps": report.state.env_steps,
        "wall_time_s": round(wall_time_s, 3),
        "env_steps_per_s": round(report.num_steps / generation_s, 1),
    }
    for level, (population, i) in zip(levels, report.sources, strict=True):
        fitness = population.members.fitness[i]
        row[f"{level.name}_return_mean"] = float(fitness.mean())
        row[f"{level.name}_return_max"] = float(fitness.max())
    row |= {
        "score_mean": float(results.score.mean()),
        "success_rate": float(results.success.mean()),
        "episode_steps_mean": float(results.steps.mean()),
        "terminated_rate": float(results.has_terminated.mean()),
        "diverged_rate": float(results.has_diverged.mean()),
        "diverged_episodes": int(results.has_diverged.sum()),
        "episodes_per_policy": results.score.shape[1],
        "sigma": report.population.work.generation.sigma,
        "learning_rate": report.population.learning_rate,
    }
    if any(level.name == "primitive" for level in levels):
        row["goals_reached_mean"] = float(results.goals_reached.mean())
    for level, update, (population, i) in zip(levels, report.updates, report.sources, strict=True):
        signs = population.work.signs[:, :, i]
        indices = population.work.noise_index[i][signs.any(axis=1)]
        row |= {
            f"{level.name}_noise_distinct": len(np.unique(indices)),
            f"{level.name}_noise_overlapping": _overlapping(indices, len(level.theta)),
            f"{level.name}_rank_ties": _tied(select_fitness(population.members.fitness[i], signs)),
            f"{level.name}_gradient_norm": update.gradient_norm,
            f"{level.name}_halves_cosine": update.halves_cosine,
            f"{level.name}_update_ratio": update.update_ratio,
            f"{level.name}_theta_norm": float(np.linalg.norm(level.theta.astype(np.float64))),
        }
    if report.state.novelty is not None:
        row |= {
            "novelty_weight": report.state.novelty.weight,
            "novelty_archive": len(report.state.novelty.archive),
            "novelty_best_return": report.state.novelty.best_return,
        }
    if report.branches is not None:
        branches = report.branches.members
        row |= {
            "branch_steps_mean": float(branches.steps.mean()),
            "branch_terminated_rate": float(branches.has_terminated.mean()),
            "primitive_sigma": report.branches.work.generation.sigma,
            "primitive_learning_rate": report.branches.learning_rate,
        }
    row |= {"rollout_s": round(report.rollout_s, 4), "update_s": round(report.update_s, 4)}
    seconds = np.sum([each.results.seconds for each in populations], axis=0)
    return row | {f"{part}_s": round(float(s), 4) for part, s in zip(PARTS, seconds, strict=True)}


def _tied(fitness: F64Array) -> float:
    """Return the share of the members whose fitness another one has, too; NaN where there are no members."""
    if not len(fitness):
        return float("nan")
    _, counts = np.unique(fitness, return_counts=True)
    return float(counts[counts > 1].sum() / len(fitness))


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
            RunFolderError: It is damaged.
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
        if not kept:  # the header may be half written: it comes again with the first row
            self._columns = None
            write_atomically(self._path, lambda file: file.write(b""))
            return
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


class _Events:
    """A file of TensorBoard events, written in this thread.

    Not tensorboardX's `SummaryWriter`: its thread dies of a full disk, and the run then waits for it for ever.
    """

    def __init__(self, folder: Path, generation: int) -> None:
        """Begin a file that takes the place of earlier ones' events after `generation`."""
        self._folder = folder
        with storage_errors(folder):
            folder.mkdir(exist_ok=True)
            # The name holds the second; two parts of a run that begin in the same one must not share a file.
            self._writer = EventsWriter(str(folder / "events"), f".{os.getpid()}.{generation}")
            if generation:
                start = SessionLog(status=SessionLog.START)
                self._writer.write_event(Event(wall_time=time(), step=generation + 1, session_log=start))

    def add(self, group: str, row: Row) -> None:
        """Write the values of `row`, by generation."""
        with storage_errors(self._folder):
            for name, value in row.items():
                if name != "generation" and np.isfinite(value):
                    summary = scalar(f"{group}/{name}", value)
                    self._writer.write_event(Event(wall_time=time(), step=row["generation"], summary=summary))
            self._writer.flush()  # before the checkpoint, which says that this generation is done

    def close(self) -> None:
        """Finish the file."""
        with storage_errors(self._folder):
            self._writer.close()


class Records:
    """The tables of a run and its TensorBoard events."""

    def __init__(self, folder: RunFolder, generation: int) -> None:
        """Go on after `generation`: what the tables say of later ones is forgotten."""
        self._progress = CsvTable(folder.progress, generation)
        self._evaluation = CsvTable(folder.evaluation, generation)
        self._events = _Events(folder.tensorboard, generation)

    def add_progress(self, row: Row) -> None:
        """Write down a generation."""
        self._progress.add(row)
        self._events.add("progress", row)

    def add_evaluation(self, row: Row) -> None:
        """Write down an evaluation."""
        self._evaluation.add(row)
        self._events.add("evaluation", row)

    def close(self) -> None:
        """Finish the event file."""
        self._events.close()
