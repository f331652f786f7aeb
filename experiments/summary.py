"""The summary of a finished run: its row of `runs.csv` and its rows of `curves.csv`."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from experiments.design import Run
from experiments.results import RunResults, joined
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.tables import Row, read_csv
from shes.types import F64Array

_COLUMNS = ("env_steps", "score_mean", "return_mean", "success_rate", "primitive_return_mean", "episode_steps_mean")


def summarise(run: Run, out: Path, episodes: int) -> RunResults:
    """Evaluate the best and the last checkpoint of a finished run on fresh episodes, and return its summary."""
    folder = RunFolder(out / run.name)
    last, config, record = folder.load("last", with_state=False), folder.read_config(), folder.read_record()
    is_local = config.workers.backend in ("processes", "serial")
    row: Row = {
        **run.identity,
        "generations": last.generation,
        "env_steps": last.env_steps,
        "seconds": _times(folder)[-1],
        "workers": config.workers.count if is_local else config.workers.num_workers,  # 0 is all of a cluster
    }
    for checkpoint in ("best", "last"):
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
    row |= provenance_columns([record, *record.get("resumed", [])])
    return RunResults(row=row, curve=_curve(run, out, config.level_names[0]))


def _curve(run: Run, out: Path, outer_level: str) -> list[Row]:
    """Return a row for each evaluation of a run, with the means of training since the one before."""
    folder = RunFolder(out / run.name)
    table, progress, seconds = read_csv(folder.evaluation), read_csv(folder.progress), _times(folder, "evaluation")
    before: Row = {"primitive_env_steps": None, "primitive_seconds": None}
    if run.primitive is not None:
        primitive = RunFolder(out / run.primitive.name)
        steps = read_csv(primitive.progress)["env_steps"][-1]
        before = {"primitive_env_steps": steps, "primitive_seconds": _times(primitive)[-1]}
    ends = np.searchsorted(progress["generation"], table["generation"], side="right")
    curve: list[Row] = []
    for i, (first, end) in enumerate(itertools.pairwise([0, *ends.tolist()])):
        shown = {name: table[name][i] if name in table else None for name in _COLUMNS}
        for name, column in (
            ("training_success_rate", "success_rate"),
            ("training_return_mean", f"{outer_level}_return_mean"),
        ):
            shown[name] = sum(progress[column][first:end].tolist()) / (end - first)
        curve.append({**run.identity, **shown, "seconds": seconds[i], **before})
    return curve


def _times(folder: RunFolder, table: Literal["progress", "evaluation"] = "progress") -> F64Array:
    """Return the time of a run at the rows of one of its tables, in seconds.

    That of a run in one process is its processor time: with other work on the machine, as one run has in another one,
    it would take longer, but no more of a core.
    """
    is_one_process = folder.read_config().workers.backend == "serial"
    return read_csv(folder.path / f"{table}.csv")["process_time_s" if is_one_process else "wall_time_s"]


def provenance_columns(parts: list[Mapping[str, Any]]) -> Row:
    """Return hardware, versions and commit of a run with these parts, each with the provenance of one process."""
    return {
        "hardware": joined(_hardware(part) for part in parts),
        "versions": joined(_facts(part.get("versions", {})) for part in parts),
        "commit": joined(part.get("git_commit") for part in parts),
    }


def _hardware(part: Mapping[str, Any]) -> str:
    machine, device = part.get("machine", {}), part.get("device", {})
    gpu = "" if device.get("name") in (None, "cpu") else f", {_facts(device)}"
    return f"{machine.get('processor')}, {machine.get('cores')} cores{gpu}"


def _facts(facts: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in facts.items())
