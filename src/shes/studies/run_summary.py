"""The summary of a finished run of a study: its row of `runs.csv` and its rows of `curves.csv`."""

from __future__ import annotations

import itertools
from typing import Literal

import numpy as np

from shes.errors import RunFolderError
from shes.runs.build import open_run
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.tables import Row, read_csv
from shes.studies.provenance_columns import provenance_columns
from shes.studies.study import CHECKPOINTS
from shes.studies.study_tables import Cell, CellResults

_COLUMNS = ("env_steps", "score_mean", "return_mean", "success_rate", "primitive_return_mean", "episode_steps_mean")


def summarise(cell: Cell, folder: RunFolder, episodes: int, primitive: RunFolder | None) -> CellResults:
    """Evaluate a finished run and return its summary; `primitive` is the run that trained its primitive.

    Raises:
        RunFolderError: A table of the run lacks generations, as one that was damaged and replaced by an empty file.
    """
    last, workers = folder.load("last"), folder.read_config().workers
    is_local = workers.backend in ("processes", "serial")
    row: Row = {
        **cell.identity,
        "generations": last.generation,
        "env_steps": last.env_steps,
        "seconds": _times(folder)[-1],
        "workers": workers.count if is_local else workers.num_workers,  # 0 is all of a cluster
    }
    for checkpoint in CHECKPOINTS:
        found = evaluate(folder.path, episodes=episodes, checkpoint=checkpoint, num_workers=1).summary()
        row |= {
            f"{checkpoint}_score": found["score_mean"],
            f"{checkpoint}_return": found["return_mean"],
            f"{checkpoint}_steps": found["episode_steps_mean"],
            f"{checkpoint}_success": found["success_rate"],
            f"{checkpoint}_primitive_return": found.get("primitive_return_mean"),
            f"{checkpoint}_goals_reached": found.get("goals_reached_mean"),
        }
    random = evaluate(folder.path, episodes=episodes, checkpoint="last", num_workers=1, targets="training").summary()
    row |= {"last_training_success": random["success_rate"], "last_training_return": random["return_mean"]}
    record = folder.read_record()
    row |= provenance_columns([record, *record.get("resumed", [])])
    return CellResults(row=row, curve=_curve(cell, folder, primitive))


def _curve(cell: Cell, folder: RunFolder, primitive: RunFolder | None) -> tuple[Row, ...]:
    """Return a row for each evaluation of a run, with the means of training since the one before."""
    table, progress = read_csv(folder.evaluation), read_csv(folder.progress)
    outer = f"{open_run(folder.path, 'last').algorithm.level_names[0]}_return_mean"
    curve: list[Row] = []
    before = _length_of_primitive(primitive)
    seconds = _times(folder, "evaluation")
    # A table that was damaged may have been emptied, so that the run could go on.
    ends = np.searchsorted(progress.get("generation", []), table["generation"], side="right")
    for i, (first, end) in enumerate(itertools.pairwise([0, *ends.tolist()])):
        if first == end:
            raise RunFolderError(
                f"{folder.progress} has no generation before that of evaluation {i + 1}, {table['generation'][i]:.0f}. "
                f"Remove {folder.path} to have the run made again."
            )
        shown = {name: table[name][i] if name in table else None for name in _COLUMNS}
        for name, column in (("training_success_rate", "success_rate"), ("training_return_mean", outer)):
            shown[name] = sum(progress[column][first:end]) / (end - first)
        curve.append({**cell.identity, **shown, "seconds": seconds[i], **before})
    return tuple(curve)


def _length_of_primitive(primitive: RunFolder | None) -> Row:
    """Return how long the run of a primitive was trained, as columns of `curves.csv`; None without one."""
    if primitive is None:
        return {"primitive_env_steps": None, "primitive_seconds": None}
    steps = read_csv(primitive.progress)["env_steps"]
    return {"primitive_env_steps": steps[-1], "primitive_seconds": _times(primitive)[-1]}


def _times(folder: RunFolder, name: Literal["progress", "evaluation"] = "progress") -> list[float]:
    """Return the time of a run at the rows of one of its tables, in seconds; raise RunFolderError if one is empty.

    That of a run in one process is its processor time: with other work on the machine, as one run has in another one,
    it would take longer, but no more of a core. Both tables must have it, or their times would not go together.
    """
    tables = {"progress": read_csv(folder.progress), "evaluation": read_csv(folder.evaluation)}
    if missing := [each for each, table in tables.items() if "wall_time_s" not in table]:
        raise RunFolderError(
            f"{folder.path} has no rows in {' and '.join(f'{each}.csv' for each in missing)}. Remove the folder to "
            "have the run made again."
        )
    is_one_process = folder.read_config().workers.backend == "serial"
    is_known = all("process_time_s" in table for table in tables.values())
    return tables[name]["process_time_s" if is_one_process and is_known else "wall_time_s"]
