"""The execution of a study: many runs by one call, which can be stopped and repeated.

Every cell is an ordinary run folder, trained by one worker process. Finished cells are not run again, and unfinished
ones continue as `shes resume` does: a study that was stopped has the same numbers as one that was not.
"""

from __future__ import annotations

import math
import signal
import traceback
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import time
from typing import Any

from shes.backends.backend import Backend, TaskSource
from shes.backends.named_backends import BACKENDS
from shes.backends.processes import ProcessesBackend
from shes.cores import num_cores
from shes.errors import RunFolderError, ShesError, WorkerError
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder, check_folder_of_runs, differing
from shes.runs.sections import WorkerSettings
from shes.runs.tables import trained_minutes
from shes.runs.train import resume_run, start_run
from shes.storage import storage_errors
from shes.studies.one_core_backend import OneCoreBackend
from shes.studies.run_summary import summarise
from shes.studies.significance import check_scipy
from shes.studies.study import ALONE, Study, cell_config, cell_workers, planned_config
from shes.studies.study_tables import Cell, CellResults
from shes.studies.summaries import cells_left, read_summary, write_summary

_SHORTEST = 1e-6
"""Minutes in which no generation begins."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The summary of a finished cell, the error of one that failed, or neither: the time for it was over."""

    cell: Cell
    summary: CellResults | None = None
    error: str = ""
    events: tuple[str, ...] = ()


# One cell, in a worker process.


def run_cell(
    cell: Cell, out: Path, episodes: int, *, until: float = math.inf, workers: Mapping[str, Any] = ALONE
) -> CellResults | None:
    """Train a cell to its end from its last checkpoint, if it has one; evaluate it and return its summary.

    Args:
        cell: The cell.
        out: Folder of the study.
        episodes: Number of episodes of each evaluation.
        until: Time, as of `time.time`, at which training stops; the summary is None if that is before its end.
        workers: Backend and number of workers of the run, unless the cell has its own.

    Raises:
        ShesError: Raised by `start_run`, `resume` or `evaluate`; its folder may hold a run with other settings.
    """
    path = out / cell.name
    summary = read_summary(cell, out)
    if summary is not None:
        return summary
    workers = cell_workers(cell, workers)
    config = cell_config(cell, out, workers)
    folder = RunFolder(path)
    if folder.config.is_file():
        _check_settings(cell, folder, config)
    if not _is_over(config, folder):
        # Only an evaluation may be left when the limit of the run is over.
        own = math.inf if config.run.minutes is None else max(config.run.minutes - trained_minutes(folder), _SHORTEST)
        left = min(own, (until - time()) / 60)
        if left <= 0:
            return None
        minutes = None if math.isinf(left) else left
        if folder.config.is_file():
            resume_run(path, **workers, minutes=minutes)
        else:
            start_run(config.having(minutes=minutes), path)
        is_late = left == own < math.inf  # its own limit: the last generation may have ended just before
        if not (is_late or _is_over(config, folder)):
            return None
    primitive = None if cell.primitive is None else RunFolder(out / cell.primitive.name)
    return write_summary(cell, out, summarise(cell, folder, episodes, primitive))


def _is_over(config: TrainConfig, folder: RunFolder) -> bool:
    """Return whether the run of a cell has ended, by its length or its own time limit, and has been evaluated."""
    if not folder.config.is_file():
        return False
    last, limit = folder.load("last", with_state=False), config.run.minutes
    is_late = limit is not None and trained_minutes(folder) >= limit
    return config.run.is_over(last.generation, last.env_steps) or is_late


def _check_settings(cell: Cell, folder: RunFolder, config: TrainConfig) -> None:
    """Raise RunFolderError unless a run folder has the settings of its cell."""
    # The path of the primitive is not compared: the same folder may have another path.
    there, wanted = (
        {
            **each.numbers(),
            "generations": each.run.generations,
            "env_steps": each.run.env_steps,
            "primitive": each.values.get("primitive") is not None,
        }
        for each in (folder.read_config(), config)
    )
    if others := differing(there, wanted):
        raise RunFolderError(
            f"{folder.path} holds a run of other settings than cell {cell.name}, such as another --scale: {others}. "
            "Choose another folder with --out, or remove this one to have it made anew."
        )


class StudyWorker:
    """The `Worker` of a study's processes: runs one cell after another."""

    def __init__(self, out: Path, episodes: int, until: float) -> None:
        """Block Ctrl-C, which reaches the whole process group: the parent handles it."""
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        self._run = partial(run_cell, out=out, episodes=episodes, until=until)

    def receive(self, state: Any) -> None:
        """Do nothing: cells share no state."""

    def close(self) -> None:
        """Do nothing: a run closes what it holds."""

    def run(self, work: TaskSource, share: int) -> Iterator[tuple[int, Outcome]]:
        """Yield the outcome of each cell; a failed cell has one, too."""
        for number, cell in work:
            try:
                outcome = _outcome(cell, self._run)
            except KeyboardInterrupt:  # SIGTERM: the process dies of it, and the parent starts another one
                signal.signal(signal.SIGTERM, signal.SIG_DFL)
                signal.raise_signal(signal.SIGTERM)
                raise
            yield number, outcome


def _outcome(cell: Cell, run: Callable[[Cell], CellResults | None]) -> Outcome:
    """Return the outcome of `run` for a cell."""
    try:
        return Outcome(cell=cell, summary=run(cell))
    except ShesError as error:
        return Outcome(cell=cell, error=str(error))
    except Exception:  # noqa: BLE001 - no error may stop the other cells
        return Outcome(cell=cell, error=traceback.format_exc())


# All cells.


def run_study(
    study: Study, out: Path, *, num_workers: int, backend: str = "processes", until: float = math.inf
) -> Generator[Outcome]:
    """Run the unfinished cells of `study`, and yield their outcomes in order.

    Args:
        study: The study.
        out: Its folder.
        num_workers: Number of cells that run at a time; of a study with large runs, the number of workers of each. 0 is
            one for every core, of `backend`'s cluster if it has one.
        backend: Backend of large runs.
        until: Time, as of `time.time`, at which all runs stop.

    Raises:
        RunFolderError: `out` is in use, or a folder below it holds a run with other settings.
        ConfigError: The settings of a cell are not allowed.
        UnknownNameError: There is no such backend.
        MissingExtraError: A package is not installed that the backend, the runs or their comparison need.
        StorageError: `out` cannot be written.
        WorkerError: Workers keep dying, before they begin with any run.
    """
    _check_packages(cells_left(study, out), backend)
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    unfinished: dict[str, Outcome] = {}
    with RunFolder(out).lock():
        check_study(study, out)
        names = {cell.name for cell in cells_left(study, out)}
        left = [tuple(cell for cell in stage if cell.name in names) for stage in study.stages()]
        at_once = WorkerSettings(num_workers=num_workers).count
        size = min(at_once, max(map(len, left), default=0))
        if not size:
            return
        run: Callable[[Sequence[Cell]], Iterator[Outcome]]
        if study.has_large_runs:
            workers = {"backend": backend, "num_workers": num_workers}
            run_one = study.run_cell or partial(run_cell, episodes=study.episodes)
            run = partial(_run_in_turn, partial(run_one, out=out, until=until, workers=workers))
        else:
            factory = partial(StudyWorker, out, study.episodes, until)
            # With fewer workers than cores another study may use the rest, and must not meet this one on a core.
            processes = OneCoreBackend if at_once >= num_cores() else ProcessesBackend
            run = partial(_run_side_by_side, partial(processes, factory, size))
        for stage in left:
            for outcome in _run_stage(stage, unfinished, run):
                if outcome.summary is None:
                    unfinished[outcome.cell.name] = outcome
                yield outcome


def _run_stage(
    stage: Sequence[Cell], unfinished: Mapping[str, Outcome], run: Callable[[Sequence[Cell]], Iterator[Outcome]]
) -> Iterator[Outcome]:
    """Yield the outcomes of a stage; cells whose primitive is unfinished are not run."""
    for cell in stage:
        before = None if cell.primitive is None else unfinished.get(cell.primitive.name)
        if before is not None:
            error = (
                f"not run: it begins with the primitive of {before.cell.name}, which failed." if before.error else ""
            )
            yield Outcome(cell=cell, error=error)
    yield from run([cell for cell in stage if cell.primitive is None or cell.primitive.name not in unfinished])


def _run_side_by_side(open_backend: Callable[[], Backend], cells: Sequence[Cell]) -> Iterator[Outcome]:
    """Yield the outcomes of `cells`, each run by a worker of a backend. One at which workers keep dying has failed."""
    left, events = list(cells), list[str]()
    while left:
        tasks = tuple(left)
        try:
            with open_backend() as backend:
                backend.on_event = events.append
                for outcome in backend.map(tasks):
                    left.remove(outcome.cell)
                    yield replace(outcome, events=tuple(events))
                    events.clear()
        except WorkerError as error:
            if error.task is None:
                raise
            failed = tasks[error.task]
            left.remove(failed)
            yield Outcome(cell=failed, error=str(error), events=tuple(events))
            events.clear()


def _run_in_turn(run: Callable[[Cell], CellResults | None], cells: Sequence[Cell]) -> Iterator[Outcome]:
    """Yield the outcomes of `cells`, run one after another."""
    yield from (_outcome(cell, run) for cell in cells)


def _check_packages(cells: Sequence[Cell], backend: str) -> None:
    """Check that what the runs of `cells` need is installed, before hours of other runs."""
    BACKENDS.find(backend).check_installed()
    configs = map(planned_config, cells)
    for name, algorithm in {config.run.algorithm: config.algorithm for config in configs}.items():
        algorithm.check_installed(name)


def check_study(study: Study, out: Path) -> None:
    """Check all settings and folders of a study before it begins.

    Raises:
        RunFolderError: A folder holds a run with other settings, or `out` is a run folder or a file.
        ConfigError: The settings of a cell are not allowed.
        MissingExtraError: SciPy, which compares the finished runs, is not installed.
    """
    check_scipy()
    check_folder_of_runs(out)
    for cell in study.cells:
        if cell.primitive is not None and not RunFolder(out / cell.primitive.name).config.is_file():
            continue  # the settings of the primitive are not known yet; the worker checks them
        config, folder = cell_config(cell, out), RunFolder(out / cell.name)
        if folder.config.is_file():
            _check_settings(cell, folder, config)
