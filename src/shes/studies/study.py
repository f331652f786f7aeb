"""Studies: many runs that differ in a few settings, made by one call that can be stopped and made again.

Every cell of a study is an ordinary run folder, trained by one worker process; finished cells are not run again, and
unfinished ones go on as `shes resume` does, so a study that was stopped has the numbers of one that never was.
"""

from __future__ import annotations

import json
import math
import signal
import traceback
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from shes.backends.backend import Backend
from shes.backends.processes import ProcessesBackend
from shes.errors import ConfigError, RunFolderError, ShesError, UnknownNameError
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder
from shes.runs.tables import Row, read_csv
from shes.storage import storage_errors, write_atomically
from shes.studies.design import StudyDesign
from shes.studies.significance import check_scipy
from shes.studies.tables import Cell, Summary, read_tables
from shes.training.evaluate import evaluate
from shes.training.presets import make_config
from shes.training.train import resume, start_run

__all__ = [
    "Outcome",
    "Study",
    "StudyWorker",
    "cell_config",
    "cell_steps",
    "cells_left",
    "check_study",
    "choose",
    "generation_steps",
    "read_summaries",
    "run_cell",
    "run_study",
]

CHECKPOINTS = ("best", "last")
"""What is evaluated on fresh episodes at the end of a cell."""
_TRANSFER = ("primitive", "freeze_primitive")
_CURVE = ("env_steps", "score_mean", "return_mean", "success_rate", "primitive_return_mean", "episode_steps_mean")


@dataclass(frozen=True, kw_only=True)
class Study:
    """Runs that belong together."""

    cells: tuple[Cell, ...]
    episodes: int = 100
    """Fresh episodes on which a finished run's checkpoints are evaluated."""
    design: StudyDesign = field(default_factory=StudyDesign)
    """What is asked of them."""

    def __post_init__(self) -> None:
        """Refuse cells of one name, and primitives of no cell.

        Raises:
            ConfigError: There is one.
        """
        names = [cell.name for cell in self.cells]
        for cell in self.cells:
            if names.count(cell.name) > 1:
                raise ConfigError(f"two cells of the study are called {cell.name}: give one another variant.")
            if cell.primitive is not None and cell.primitive not in names:
                raise ConfigError(f"{cell.name} begins with the primitive of {cell.primitive}, which is no cell.")

    def stages(self) -> tuple[tuple[Cell, ...], ...]:
        """Return the cells in stages: every cell after the one it begins with, and else as late as it may be.

        Within a stage the seed comes first, so that a study that is stopped has as many seeds of every variant.
        """
        followers: dict[str | None, list[Cell]] = {}
        for cell in self.cells:
            followers.setdefault(cell.primitive, []).append(cell)

        def height(cell: Cell) -> int:
            return max((1 + height(follower) for follower in followers.get(cell.name, ())), default=0)

        heights = {cell.name: height(cell) for cell in self.cells}
        ordered = sorted(self.cells, key=lambda cell: cell.seed)
        return tuple(
            tuple(cell for cell in ordered if heights[cell.name] == level)
            for level in sorted(set(heights.values()), reverse=True)
        )

    def ordered(self) -> list[Cell]:
        """Return the cells in the order in which they are run."""
        return [cell for stage in self.stages() for cell in stage]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """A cell that has been run: what came of it, or why nothing did."""

    cell: Cell
    summary: Summary | None = None
    error: str = ""
    events: tuple[str, ...] = ()
    """What happened to the workers meanwhile."""


def choose(study: Study, groups: Sequence[str] | None) -> Study:
    """Return `study` with the cells of `groups` and of the base alone; with all cells if `groups` is None.

    Raises:
        ConfigError: `groups` is empty.
        UnknownNameError: There is no such group.
    """
    if groups is None:
        return study
    if not groups:
        known = ", ".join(sorted(study.design.groups))
        raise ConfigError(f"--only needs at least one group: {known}. Leave it away to run all.")
    for group in groups:
        if group not in study.design.groups:
            raise UnknownNameError("group", group, study.design.groups, "Set --only.")
    chosen = {
        cell.name for cell in study.cells if cell.group in groups or (cell.group, cell.variant) == study.design.base
    }
    return replace(study, cells=tuple(cell for cell in study.cells if cell.name in chosen))


def cell_config(cell: Cell, out: Path) -> TrainConfig:
    """Return the settings of the run of `cell` in the study at `out`.

    Raises:
        ConfigError: A setting is unknown or not allowed.
        UnknownNameError: A name is not known.
        RunFolderError: There is no run yet to take the primitive from.
    """
    transfer = {} if cell.primitive is None else {"primitive": out / cell.primitive}
    alone = {"seed": cell.seed, "backend": "serial", "num_workers": 1}
    return make_config(cell.env, cell.preset, {**cell.settings, **transfer, **alone})


def cell_steps(cell: Cell, episodes: int) -> int:
    """Return the environment steps of a cell, all its evaluations included, if no episode ends before its time."""
    config = make_config(
        cell.env, cell.preset, {name: value for name, value in cell.settings.items() if name not in _TRANSFER}
    )
    per_generation, generations = generation_steps(config), config.run.generations
    if config.run.env_steps is not None:
        generations = min(generations, math.ceil(config.run.env_steps / per_generation))
    training = generations * per_generation
    evaluations = 1 + generations // config.evaluation.evaluation_interval
    evaluated = evaluations * config.evaluation.evaluation_episodes + (len(CHECKPOINTS) + 1) * episodes
    return training + evaluated * config.evaluation_steps


def generation_steps(config: TrainConfig) -> int:
    """Return the environment steps of a generation, if no episode and no branch ends before its time."""
    evolution = config.evolution
    episodes = evolution.population_size * evolution.episodes_per_policy * config.episodes.horizon
    if not config.is_branched or not config.learns[-1]:
        return episodes
    pairs = config.settings.get("primitive_population_size") or evolution.population_size
    branches = pairs * config.estimate.intervals * config.hierarchy.controller_interval
    return branches if config.level_names == ("primitive",) else episodes + branches


# One cell, in a worker process.


def run_cell(cell: Cell, out: Path, episodes: int) -> Summary:
    """Train the cell to its end, from where it stands; evaluate it; return what came of it.

    Raises:
        RunFolderError: Its folder holds a run of other settings.
        ShesError: Whatever `start_run`, `resume` and `evaluate` raise.
    """
    path = out / cell.name
    summary = _read_summary(path)
    if summary is not None:
        return summary
    config = cell_config(cell, out)
    folder = RunFolder(path)
    if not folder.config.is_file():
        start_run(config, path)
    else:
        _check_settings(cell, folder, config)
        last = folder.load("last")
        if not config.run.is_over(last.generation, last.env_steps):
            resume(path)
    summary = _summarise(cell, folder, episodes)
    write_atomically(_summary_path(path), partial(_dump, summary))
    return summary


def _summarise(cell: Cell, folder: RunFolder, episodes: int) -> Summary:
    """Evaluate a finished run and gather what its tables say."""
    last = folder.load("last")
    row: Row = {
        **cell.identity,
        "generations": last.generation,
        "env_steps": last.env_steps,
        "seconds": read_csv(folder.progress)["wall_time_s"][-1],
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
    table, progress = read_csv(folder.evaluation), read_csv(folder.progress)
    curve: list[Row] = []
    first = 0.0
    for i, generation in enumerate(table["generation"]):
        made = zip(progress["generation"], progress["success_rate"], strict=True)
        since = [rate for number, rate in made if first < number <= generation]
        shown = {name: table[name][i] if name in table else None for name in _CURVE}
        curve.append({**cell.identity, **shown, "training_success_rate": sum(since) / len(since)})
        first = generation
    return Summary(row=row, curve=tuple(curve))


def _check_settings(cell: Cell, folder: RunFolder, config: TrainConfig) -> None:
    """Refuse a run folder that holds a run of other settings.

    Raises:
        RunFolderError: It does.
    """
    # A path is no setting of the study: the same folder may be reached by another one.
    wanted, there = (
        {
            **settings.numbers(),
            "generations": settings.run.generations,
            "env_steps": settings.run.env_steps,
            "primitive": settings.settings.get("primitive") is not None,
        }
        for settings in (config, folder.read_config())
    )
    other = [
        f"{name} is {there.get(name)!r} there and {value!r} in the study"
        for name, value in wanted.items()
        if there.get(name) != value
    ]
    if other:
        raise RunFolderError(
            f"{folder.path} holds a run of other settings than cell {cell.name}: {'; '.join(other[:3])}. "
            f"Choose another folder with --out, or remove this one to have it made anew."
        )


class StudyWorker:
    """Runs the cells that it is handed, one after another: the `Worker` of a study's processes."""

    def __init__(self, out: Path, episodes: int) -> None:
        """Leave Ctrl-C, which reaches the whole process group, to the parent: training here must not answer to it."""
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        self._out, self._episodes = out, episodes

    def receive(self, state: Any) -> None:
        """Do nothing: all cells are alike."""

    def run(self, work: Iterator[tuple[int, Cell]], share: int) -> Iterator[tuple[int, Outcome]]:
        """Run a cell at a time; one that fails is an outcome, too."""
        for number, cell in work:
            yield number, self._outcome(cell)

    def _outcome(self, cell: Cell) -> Outcome:
        try:
            return Outcome(cell=cell, summary=run_cell(cell, self._out, self._episodes))
        except ShesError as error:
            return Outcome(cell=cell, error=str(error))
        except Exception:  # noqa: BLE001 - whatever it is, it must not stop the other cells
            return Outcome(cell=cell, error=traceback.format_exc())


# All cells.


def run_study(study: Study, out: Path, *, num_workers: int) -> Generator[Outcome]:
    """Run the cells of `study` that are not finished, `num_workers` at a time, and yield what comes of each, in order.

    Raises:
        RunFolderError: `out` is in use, or a folder below it holds a run of other settings.
        ConfigError: The settings of a cell are not allowed.
        StorageError: `out` cannot be written.
        WorkerError: Workers keep dying.
    """
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    failed: set[str] = set()
    with RunFolder(out).lock():
        check_study(study, out)
        names = {cell.name for cell in cells_left(study, out)}
        left = [tuple(cell for cell in stage if cell.name in names) for stage in study.stages()]
        size = min(num_workers, max(map(len, left), default=0))
        if not size:
            return
        with ProcessesBackend(partial(StudyWorker, out, study.episodes), size) as backend:
            for stage in left:
                for outcome in _run_stage(stage, failed, backend):
                    if outcome.summary is None:
                        failed.add(outcome.cell.name)
                    yield outcome


def _run_stage(stage: Sequence[Cell], failed: set[str], backend: Backend) -> Iterator[Outcome]:
    """Run the cells of a stage; those that cannot be for want of a primitive are outcomes without a run."""
    for cell in stage:
        if cell.primitive in failed:
            yield Outcome(cell=cell, error=f"not run: it begins with the primitive of {cell.primitive}, which failed.")
    for outcome in backend.map([cell for cell in stage if cell.primitive not in failed]):
        events = tuple(backend.take_events())
        yield Outcome(cell=outcome.cell, summary=outcome.summary, error=outcome.error, events=events)


def check_study(study: Study, out: Path) -> None:
    """Refuse settings that are not allowed, and folders that hold other runs, before hours have gone by.

    Raises:
        RunFolderError: A folder holds a run of other settings, or `out` is a run folder itself, or a file.
        ConfigError: The settings of a cell are not allowed.
        MissingExtraError: SciPy, which compares the runs in the end, is not installed.
    """
    check_scipy()
    if out.exists() and not out.is_dir():
        raise RunFolderError(f"{out} is a file, not a folder. Choose another path with --out.")
    if RunFolder(out).config.exists():
        raise RunFolderError(f"{out} is a run folder: the runs of a study need one of their own. Set --out.")
    for cell in study.cells:
        if cell.primitive is not None and not RunFolder(out / cell.primitive).config.is_file():
            continue  # what it brings is not known yet; the cell's worker looks again
        config, folder = cell_config(cell, out), RunFolder(out / cell.name)
        if folder.config.is_file():
            _check_settings(cell, folder, config)


# What is written down.


def _summary_path(path: Path) -> Path:
    return path / "summary.json"


def _dump(summary: Summary, file: Any) -> None:
    file.write(json.dumps({"row": summary.row, "curve": summary.curve}).encode())


def _read_summary(path: Path) -> Summary | None:
    """Return what came of the cell in the folder at `path`; None if it is not finished.

    Raises:
        RunFolderError: The file is damaged.
    """
    file = _summary_path(path)
    try:
        found = json.loads(file.read_bytes())
        return Summary(row=found["row"], curve=tuple(found["curve"]))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise RunFolderError(f"{file} cannot be read: {error!r}. Remove it to have it made again.") from error


def read_summaries(study: Study, out: Path) -> dict[str, Summary]:
    """Return what came of the finished cells, by name, in the order of the study: from their folders, or the tables.

    Raises:
        RunFolderError: A summary or a table is damaged.
    """
    cells = study.ordered()
    # A folder knows better than a row: what has one and is not finished is not done.
    without = [cell for cell in cells if not (out / cell.name).exists()]
    tables = read_tables(without, out) if without else {}
    found = {cell.name: tables.get(cell.name) or _read_summary(out / cell.name) for cell in cells}
    return {name: summary for name, summary in found.items() if summary is not None}


def cells_left(study: Study, out: Path) -> list[Cell]:
    """Return the cells that are still to be run, in order: primitives that are rows of a table alone among them.

    Raises:
        RunFolderError: A summary or a table is damaged.
    """
    done = set(read_summaries(study, out))
    for cell in reversed(study.ordered()):  # what begins with a primitive comes after it
        if cell.primitive is not None and cell.name not in done and _read_summary(out / cell.primitive) is None:
            done.discard(cell.primitive)
    return [cell for cell in study.ordered() if cell.name not in done]
