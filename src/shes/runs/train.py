"""Training: runs an algorithm's generator of generations, evaluates, writes files, and handles Ctrl-C."""

from __future__ import annotations

import shlex
import signal
import threading
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from shes.algorithms.contract import Algorithm
from shes.backends.backend import Backend
from shes.errors import ConfigError, RunFolderError
from shes.runs.build import build_algorithm, build_backend, check_device, check_limits, most_episodes
from shes.runs.checkpoint import Best, Checkpoint, restore, save_checkpoint
from shes.runs.config import TrainConfig, known_settings, resumable_settings
from shes.runs.evaluate import logger
from shes.runs.folder import RunFolder, checked_out, differing, new_folder
from shes.runs.make_config import check_effects, make_config, transfer
from shes.runs.progress_display import with_display
from shes.runs.recorder import AnyListener, Recorder, listener_methods, run_log
from shes.runs.tables import read_csv, trained_minutes
from shes.types import F64Array, Listing


@dataclass(frozen=True, kw_only=True)
class Run:
    """A finished or stopped run."""

    path: Path
    """The run folder."""
    config: TrainConfig = field(repr=False)
    generation: int
    """Number of finished generations."""
    env_steps: int
    """Environment steps of training."""
    best: Best
    """The best evaluation."""

    def listing(self) -> Listing:
        """Return the listing of what it has reached and what can be done next."""
        best, found, run = "no evaluation yet", shlex.quote(str(self.path)), self.config.run
        if self.best.generation >= 0:
            best = f"best evaluation score {self.best.score:.2f} (generation {self.best.generation})"
        parts = [
            f"Done: {self.generation} generation{'s' * (self.generation != 1)}, {best}.",
            f"Next: shes evaluate {found} · shes render {found} · shes plot {found}",
        ]
        if not run.is_over(self.generation, self.env_steps):
            parts[0] = f"Stopped: {self.generation} of {run.generations} generations, {best}."
            parts.insert(1, f"Go on: shes resume {found}")
        return Listing({"run": str(self.path), "generation": self.generation, "best_score": self.best.score}, parts)

    def __fspath__(self) -> str:
        """Return the run folder, so that a run can be given wherever its path can."""
        return str(self.path)

    @property
    def progress(self) -> dict[str, F64Array]:
        """The columns of `progress.csv` by name, a value per generation; empty before the first one."""
        return read_csv(RunFolder(self.path).progress)

    @property
    def evaluations(self) -> dict[str, F64Array]:
        """The columns of `evaluation.csv` by name, a value per evaluation; empty before the first one."""
        return read_csv(RunFolder(self.path).evaluation)


def train(
    env: str | None = None,
    *,
    like: Path | str | None = None,
    preset: str | None = None,
    out: Path | str | None = None,
    listener: AnyListener = None,
    progress: bool | None = None,
    **settings: Any,
) -> Run:
    """Train on `env` and return the run.

    Args:
        env: Environment, e.g. `ant-gather`; that of run `like` if none.
        like: A run folder or shipped agent that gives every setting that is not given here, except for the seed. In
            another environment, values of its preset are those for that environment.
        preset: `laptop` (if none), `paper`, `smoke`, or one of the algorithm's own: `hiro-paper`, `hiro-table1`.
        out: The run folder, which must not hold a run; a new one below `runs/` if none.
        listener: Receives the progress: a function of a row of `progress.csv`, an object with any of the methods
            `on_start`, `on_generation`, `on_evaluation` and `on_event`, or a list of these. It ends the run by
            returning True or raising `shes.StopTraining`.
        progress: Whether to show the progress; only in a terminal or a notebook if None.
        settings: Any setting by name, e.g. `seed=0, num_workers=4`. Several seeds take a call each.

    Raises:
        ConfigError: A setting is unknown or out of range, or the run does not fit this machine.
        RunFolderError: `out` already holds a run.
        StorageError: A file cannot be written. `resume` goes on afterwards, also after the errors below.
        WorkerError: A worker failed, or workers keep dying.
        PolicyError: A policy returned NaN.
        DivergenceError: Every episode of ten generations in a row diverged.
    """
    if np.ndim(seed := settings.get("seed", 0)):
        raise ConfigError(f"seed must be one number, got {seed!r}. Call shes.train for each, or use --seed 1 2 3.")
    with with_display(listener, progress) as heard:
        return start_run(make_config(env, preset, {**settings, "like": like}), out, heard)


def start_run(config: TrainConfig, out: Path | str | None = None, listener: AnyListener = None) -> Run:
    """Begin a run with the settings of `config`; see `train`."""
    listeners, place = listener_methods(listener), None if out is None else checked_out(out)
    check_device(config)
    algorithm = build_algorithm(config)
    check_limits(config, algorithm.design)
    algorithm.plan()  # errors of the noise table or a transfer arise before there is a folder
    state, origins = transfer(algorithm, algorithm.start(config.run.seed))
    if place is not None:
        RunFolder(place).check_free()
    with _started(algorithm) as workers:  # nor does a cluster that does not answer leave a folder
        folder = RunFolder.create(place or new_folder(config))
        with folder.lock():
            checkpoint = Checkpoint(arrays=algorithm.to_arrays(state), best=Best(), numbers=config.numbers())
            for name in ("0", "best", "last"):
                save_checkpoint(folder.checkpoint_path(name), checkpoint)
            # From here on the run can be resumed.
            folder.record_start(config, origins)
            with resumable(folder.path), closing(Recorder(folder, algorithm, checkpoint, listeners)) as recorder:
                return _go_on(recorder, state, workers)


def resume(path: Path | str, *, listener: AnyListener = None, progress: bool | None = None, **settings: Any) -> Run:
    """Continue the run at `path` from its last checkpoint, as if it had never stopped.

    Args:
        path: The run folder.
        listener: Receives the progress, as in `train`.
        progress: Whether to show the progress; only in a terminal or a notebook if None.
        settings: Execution settings, e.g. `generations=2000, num_workers=8, device="cuda"`.
    """
    folder = RunFolder.open(path)
    check_resumable(settings)
    config = folder.read_config().having(**{"minutes": None, **settings})
    check_effects(config, settings)
    check_device(config)
    with folder.lock(), resumable(folder.path), with_display(listener, progress) as heard:
        algorithm = build_algorithm(config)
        check_limits(config, algorithm.design)
        checkpoint = folder.load("last")
        _check_unfinished(path, config, checkpoint)
        state = restore(checkpoint, algorithm.from_arrays, folder.checkpoint_path("last"))
        checkpoint = replace(checkpoint, arrays=algorithm.to_arrays(state))  # what was read need not stay in memory
        recording = closing(Recorder(folder, algorithm, checkpoint, listener_methods(heard)))
        with recording as recorder, _started(algorithm) as workers:
            changes = folder.record_resume(checkpoint.generation, config)
            return _go_on(recorder, state, workers, changes)


def _check_unfinished(path: Path | str, config: TrainConfig, checkpoint: Checkpoint) -> None:
    done, steps, run = checkpoint.generation, checkpoint.env_steps, config.run
    if not run.is_over(done, steps):
        return
    made, what, flag, end = steps, "environment steps", "--env-steps", run.env_steps
    if done >= run.generations:
        made, what, flag, end = done, "generations", "--generations", run.generations
    raise ConfigError(
        f"the run has made {made} {what}, but {flag} is {end}. "
        f"To go on: shes resume {shlex.quote(str(path))} {flag} {2 * made}"
    )


def finish_run(config: TrainConfig, path: Path, listener: AnyListener = None) -> Run:
    """Train the run at `path` to its end: from its last checkpoint, or from the start if there is no run yet.

    Its minutes are those of all parts of the run. Execution settings of `config` may differ from those of the run so
    far; raise RunFolderError if others do.
    """
    folder = RunFolder(path)
    if not folder.config.is_file():
        return start_run(config, path, listener)
    stored = folder.read_config()
    if others := differing(stored.numbers(), config.numbers()):
        raise RunFolderError(
            f"{path} holds a run of other settings: {others}. Choose another folder with --out, or remove this one to "
            "have it made anew."
        )
    last, left = folder.load("last"), config.run.minutes
    if left is not None:
        left -= trained_minutes(folder)
    if config.run.is_over(last.generation, last.env_steps) or (left is not None and left <= 0):
        return _run(folder, stored, last)
    now = {name: config.values[name] for name in resumable_settings()}
    changed = {name: value for name, value in now.items() if value != stored.values[name]}
    return resume(path, listener=listener, progress=False, **{**changed, "minutes": left})


def check_resumable(names: Iterable[str]) -> None:
    """Raise ConfigError unless `resume` takes the settings called `names`."""
    allowed, known = resumable_settings(), known_settings()
    takes = f"resume takes {', '.join(sorted(each.flag for each in allowed.values()))}."
    for name in names:
        if name not in known:
            raise ConfigError(f"unknown setting {name!r}. {takes}")
        if name not in allowed:
            fix = "Start another run to change it."
            raise ConfigError(f"{known[name].flag} would change the numbers of the run; {takes} {fix}")


@contextmanager
def _started(algorithm: Algorithm[Any]) -> Iterator[tuple[Backend, _Interruption]]:
    """Yield the started backend of the run, with the signals that end it delayed."""
    config: TrainConfig = algorithm.problem.settings
    with _Interruption() as interruption, build_backend(config, algorithm.plan(), most_episodes(config)) as backend:
        yield backend, interruption


def _go_on(recorder: Recorder, state: Any, workers: tuple[Backend, _Interruption], changes: Iterable[str] = ()) -> Run:
    """Train from `state` until the run is over, its time is up, a listener ends it, or Ctrl-C, which it raises.

    `changes` are those since the run began that may change numbers.
    """
    folder, algorithm = recorder.folder, recorder.algorithm
    config: TrainConfig = algorithm.problem.settings
    backend, interruption = workers
    with run_log(folder), closing(algorithm.run(state, backend)) as generations:
        on_device = "" if config.workers.device == "cpu" else f" on device {config.workers.device}"
        logger.info("begins after generation %d with %d workers%s", state.generation, backend.num_workers, on_device)
        recorder.begin(backend, changes)
        while not recorder.is_over() and not interruption.is_requested:
            logger.info("generation %d begins", recorder.checkpoint.generation + 1)
            with interruption.at_once():
                report = next(generations)
                rows = recorder.evaluate_if_due(report)
            recorder.add(report, *rows)
            logger.info("generation %d ends", report.state.generation)
    if interruption.is_requested and not recorder.is_over():
        raise KeyboardInterrupt
    return _run(folder, config, recorder.checkpoint)


def _run(folder: RunFolder, config: TrainConfig, last: Checkpoint) -> Run:
    return Run(path=folder.path, config=config, generation=last.generation, env_steps=last.env_steps, best=last.best)


class _Interruption:
    """A context that delays Ctrl-C, SIGTERM and SIGHUP while files are written; a second one ends the run at once."""

    def __init__(self) -> None:
        self.is_requested = False
        self._may_raise = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> _Interruption:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:  # by `nohup`
                    self._previous[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *exception: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: object) -> None:
        is_second, self.is_requested = self.is_requested, True
        if self._may_raise or is_second:
            raise KeyboardInterrupt

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Raise KeyboardInterrupt at once for a signal inside this block, which writes no file."""
        try:
            self._may_raise = True
            if self.is_requested:
                raise KeyboardInterrupt
            yield
        finally:
            self._may_raise = False


@contextmanager
def resumable(path: Path | str) -> Iterator[None]:
    """Add to a KeyboardInterrupt the note that the run, or the folder of runs, at `path` can be resumed."""
    try:
        yield
    except KeyboardInterrupt as stop:
        stop.add_note(f"Stopped; all finished generations are kept. Go on: shes resume {shlex.quote(str(path))}")
        raise
