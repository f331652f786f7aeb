"""Training: runs an algorithm's generator of generations, evaluates, writes files, and handles Ctrl-C."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable
from contextlib import ExitStack, closing
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter
from typing import Any, Protocol

from shes.algorithms.contract import Algorithm, Report
from shes.backends.backend import Backend
from shes.errors import ConfigError
from shes.runs.checkpoint import Best, Checkpoint, CheckpointWriter, restore, save_checkpoint
from shes.runs.config import TrainConfig
from shes.runs.device import check_asked_device
from shes.runs.folder import RunFolder, new_folder
from shes.runs.log import logger, run_log
from shes.runs.rooms import execution_settings, known_settings
from shes.runs.tables import Records, Row, read_csv
from shes.settings import Setting
from shes.training.build import build_algorithm, build_backend, check_device
from shes.training.evaluate import evaluate_state, evaluation_seeds
from shes.training.interruption import Interruption
from shes.training.presets import make_config
from shes.training.transfer import check_robot, transfer

__all__ = ["Listener", "Run", "check_resumable", "resumable_settings", "resume", "start_run", "train"]


@dataclass(frozen=True, kw_only=True)
class Run:
    """A finished or stopped run."""

    path: Path
    """The run folder."""
    config: TrainConfig
    generation: int
    """Generations made."""
    best: Best
    """The best evaluation."""


class Listener(Protocol):
    """Receives the progress of a run."""

    def on_start(self, path: Path, config: TrainConfig, generation: int, num_workers: int) -> None:
        """Receive the start of the run at `path`, after `generation`."""

    def on_generation(self, row: Row) -> None:
        """Receive a row of `progress.csv`."""

    def on_evaluation(self, row: Row) -> None:
        """Receive a row of `evaluation.csv`."""

    def on_event(self, event: str) -> None:
        """Receive a warning: a lost worker, or one of the simulator."""


def train(
    env: str,
    *,
    preset: str = "laptop",
    out: Path | str | None = None,
    listener: Listener | None = None,
    **settings: Any,
) -> Run:
    """Train on `env` and return the run.

    Args:
        env: Environment, e.g. `ant-gather`.
        preset: `paper`, `laptop` or `smoke`.
        out: The run folder, which must not hold a run; a new one below `runs/` if none.
        listener: Receives the progress.
        settings: Any setting by name, e.g. `seed=0, num_workers=4`.

    Raises:
        UnknownNameError: The environment, the preset or another name is unknown.
        ConfigError: A setting is unknown or out of range.
        RunFolderError: `out` already holds a run.
        StorageError: A file cannot be written.
        WorkerError: A worker failed, or workers keep dying.
        PolicyError: A policy returned NaN.
    """
    return start_run(make_config(env, preset, settings), out, listener)


def start_run(config: TrainConfig, out: Path | str | None = None, listener: Listener | None = None) -> Run:
    """Begin a run with the settings of `config`; see `train`."""
    check_device(config)
    check_robot(config)
    algorithm = build_algorithm(config)
    algorithm.plan()  # errors of the noise table or a transfer arise before there is a folder
    state, origins = transfer(algorithm, algorithm.start(config.run.seed))
    folder = RunFolder.create(new_folder(config) if out is None else _path(out))
    with folder.lock():
        checkpoint = Checkpoint(arrays=algorithm.to_arrays(state), best=Best(), numbers=config.numbers())
        for name in ("0", "best", "last"):
            save_checkpoint(folder.checkpoint_path(name), checkpoint)
        # From here on the run can be resumed.
        folder.record_start(config, {level: asdict(origin) for level, origin in origins.items()})
        return _go_on(folder, algorithm, state, checkpoint, listener)


def _path(out: Path | str) -> Path:
    """Return `out` as a path.

    Raises:
        ConfigError: It is not a path.
    """
    if not isinstance(out, str | os.PathLike) or not str(out):
        raise ConfigError(f"out must be the path of a folder, got {out!r}. Set --out, or leave it away.")
    return Path(out)


def resume(path: Path | str, *, listener: Listener | None = None, **settings: Any) -> Run:
    """Continue the run at `path` from its last checkpoint, as if it had never stopped.

    Args:
        path: The run folder.
        listener: Receives the progress.
        settings: Execution settings, e.g. `generations=2000, num_workers=8, device="cuda"`.

    Raises:
        RunFolderError: `path` is not a run folder, or belongs to a shipped agent.
        CheckpointError: The last checkpoint is damaged or from another run.
        ConfigError: A setting would change the run's numbers, the run is finished, or the machine has no such device.
        MissingExtraError: The device needs a package that is not installed.
    """
    folder = RunFolder.open(path)
    stored = folder.read_config()
    check_resumable(settings)
    config = stored.having(**{"minutes": None, **settings})
    check_asked_device(config, settings)
    check_device(config)
    with folder.lock():
        checkpoint = folder.load("last")
        done, steps = checkpoint.generation, checkpoint.env_steps
        if config.run.is_over(done, steps):
            is_long = done >= config.run.generations
            made, end = (done, config.run.generations) if is_long else (steps, config.run.env_steps)
            raise ConfigError(
                f"the run has made {made} {'generations' if is_long else 'environment steps'}, and is to end after "
                f"{end}. To go on: shes resume {shlex.quote(str(path))} "
                f"{'--generations' if is_long else '--env-steps'} {2 * made}"
            )
        algorithm = build_algorithm(config)
        state = restore(checkpoint, algorithm.from_arrays, folder.checkpoint_path("last"))
        changes = folder.record_resume(done, config)
        if changes:
            event = f"not as before ({', '.join(changes)}): numbers may differ from here on"
            with run_log(folder):
                logger.warning(event)
            if listener is not None:
                listener.on_event(event)
        return _go_on(folder, algorithm, state, checkpoint, listener)


def resumable_settings() -> dict[str, Setting]:
    """Return the settings that `resume` takes, by name."""
    return {name: each for name, each in execution_settings().items() if name != "preset"}


def check_resumable(names: Iterable[str]) -> None:
    """Refuse settings that `resume` does not take.

    Raises:
        ConfigError: A setting is unknown, or would change the numbers of the run.
    """
    resumable, known = resumable_settings(), known_settings()
    allowed = ", ".join(sorted(each.flag for each in resumable.values()))
    for name in names:
        if name not in known:
            raise ConfigError(f"unknown setting {name!r}. resume takes {allowed}.")
        if name not in resumable:
            raise ConfigError(
                f"{known[name].flag} would change the numbers of the run; resume takes {allowed}. "
                "Start another run to change it."
            )


def _go_on(
    folder: RunFolder, algorithm: Algorithm[Any], state: Any, checkpoint: Checkpoint, listener: Listener | None
) -> Run:
    """Train from `state` until the run is over, its time is up, or Ctrl-C.

    Raises:
        KeyboardInterrupt: Ctrl-C came before the end.
    """
    config: TrainConfig = algorithm.problem.settings
    with ExitStack() as stack:
        stack.enter_context(run_log(folder))
        interruption = stack.enter_context(Interruption())
        records = stack.enter_context(closing(Records(folder, checkpoint.generation)))
        writer = stack.enter_context(closing(CheckpointWriter()))
        backend = stack.enter_context(build_backend(config, algorithm.plan()))
        session = _Session(folder, algorithm, checkpoint, records, writer, backend, listener)
        generations = stack.enter_context(closing(algorithm.run(state, backend)))
        on_device = "" if config.workers.device == "cpu" else f" on device {config.workers.device}"
        logger.info("begins after generation %d with %d workers%s", state.generation, backend.num_workers, on_device)
        session.check_schedules()
        while not session.is_over() and not interruption.is_requested:
            logger.info("generation %d begins", session.checkpoint.generation + 1)
            with interruption.at_once():
                report = next(generations)
            session.add(report, interruption)
            logger.info("generation %d ends", report.state.generation)
    if interruption.is_requested and not session.is_over():
        raise KeyboardInterrupt
    last = session.checkpoint
    return Run(path=folder.path, config=config, generation=last.generation, best=last.best)


class _Session:
    """The records, evaluations and checkpoints of a run during one call."""

    def __init__(
        self,
        folder: RunFolder,
        algorithm: Algorithm[Any],
        checkpoint: Checkpoint,
        records: Records,
        writer: CheckpointWriter,
        backend: Backend,
        listener: Listener | None,
    ) -> None:
        self.checkpoint = checkpoint
        self._folder, self._algorithm = folder, algorithm
        self._config: TrainConfig = algorithm.problem.settings
        self._records, self._writer, self._backend, self._listener = records, writer, backend, listener
        self._earlier_s = _wall_time(folder)
        self._start = self._generation_start = perf_counter()
        if listener is not None:
            listener.on_start(folder.path, self._config, checkpoint.generation, backend.num_workers)

    def check_schedules(self) -> None:
        """Log a warning if the run ends before its schedules do."""
        config = self._config
        if config.has_schedule and config.run.generations < config.schedules.schedule_generations:
            self._tell_event(
                f"the schedules take {config.schedules.schedule_generations} generations, but the run ends after "
                f"{config.run.generations}, short of their end: see --schedule-generations"
            )

    def is_over(self) -> bool:
        """Return whether the run, or the time of this call, is over."""
        minutes = self._config.run.minutes
        is_late = minutes is not None and perf_counter() - self._start >= 60 * minutes
        last = self.checkpoint
        return is_late or self._config.run.is_over(last.generation, last.env_steps)

    def add(self, report: Report[Any], interruption: Interruption) -> None:
        """Record a generation, evaluate if it is due, and start writing the checkpoint."""
        state = report.state
        now = perf_counter()
        made = state.env_steps - self.checkpoint.env_steps
        row: Row = {
            "generation": state.generation,
            "env_steps": state.env_steps,
            "wall_time_s": round(self._earlier_s + now - self._start, 3),
            "env_steps_per_s": round(made / (now - self._generation_start), 1),
            **report.columns,
        }
        self._generation_start = now
        row["evaluation_s"] = 0.0
        self._tell_events(list(report.log))
        # `last` comes last: a run killed before that repeats this generation with its evaluation and checkpoints.
        best, paths = self.checkpoint.best, [self._folder.checkpoint_path("last")]
        if state.generation == 1 or state.generation % self._config.evaluation.evaluation_interval == 0:
            with interruption.at_once():
                evaluation = self._evaluate(state)
            self._records.add_evaluation(evaluation)
            is_sound = evaluation["diverged_episodes"] < evaluation["episodes"]  # else its score means nothing
            if is_sound and best.is_beaten_by(evaluation["score_mean"], evaluation["return_mean"]):
                best = Best(
                    generation=state.generation,
                    score=evaluation["score_mean"],
                    mean_return=evaluation["return_mean"],
                )
                paths.insert(0, self._folder.checkpoint_path("best"))
            self._tell_events([])
            self._tell("on_evaluation", evaluation)
            self._generation_start = perf_counter()
            row["evaluation_s"] = round(self._generation_start - now, 4)
        if state.generation % self._config.evaluation.keep_checkpoints == 0:
            paths.insert(0, self._folder.checkpoint_path(str(state.generation)))
        self._records.add_progress(row)
        arrays = self._algorithm.to_arrays(state)
        self.checkpoint = Checkpoint(arrays=arrays, best=best, numbers=self.checkpoint.numbers)
        self._writer.write(paths, self.checkpoint)
        self._tell("on_generation", row)

    def _evaluate(self, state: Any) -> Row:
        """Return the row of `evaluation.csv` for the agent of `state`."""
        seeds = evaluation_seeds(state.seed, state.generation, self._config.evaluation.evaluation_episodes)
        found = evaluate_state(self._algorithm, state, seeds, self._backend)
        return {
            "generation": state.generation,
            "env_steps": state.env_steps,
            "wall_time_s": round(self._earlier_s + perf_counter() - self._start, 3),
            **found.summary(),
        }

    def _tell_events(self, lines: list[str]) -> None:
        """Log `lines` and the events of the workers."""
        for event in (*lines, *self._backend.take_events()):
            self._tell_event(event)

    def _tell_event(self, event: str) -> None:
        """Log a warning and tell the listener."""
        logger.warning(event)
        self._tell("on_event", event)

    def _tell(self, method: str, content: Any) -> None:
        if self._listener is not None:
            getattr(self._listener, method)(content)


def _wall_time(folder: RunFolder) -> float:
    """Return the wall-clock seconds of the run so far, from its table."""
    times = read_csv(folder.progress).get("wall_time_s", []) if folder.progress.exists() else []
    return times[-1] if times else 0.0
