"""The files of a run in training: rows of its tables, checkpoints, the best evaluation, the log; and its listeners.

A generation is on the disk in this order: its rows, the checkpoints `best` and those that are kept, and at last `last`.
A run killed before that repeats the generation.
"""

from __future__ import annotations

import inspect
import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from time import perf_counter, process_time
from typing import Any, TypeAlias

import numpy as np

from shes.algorithms.contract import Algorithm, Report
from shes.backends.backend import Backend
from shes.errors import ConfigError, DivergenceError, UnknownNameError
from shes.runs.checkpoint import Best, Checkpoint, save_checkpoint
from shes.runs.config import TrainConfig
from shes.runs.evaluate import evaluate_state, evaluation_seeds, logger
from shes.runs.folder import RunFolder
from shes.runs.tables import CsvTable, Events, Row, last_value
from shes.storage import storage_errors

_MOST_DIVERGED = 10
"""Generations in a row in which every episode diverges, after which a run ends."""
_CLOCKS = {"wall_time_s": perf_counter, "process_time_s": process_time}
"""Columns of times; the processor time is that of this process, without its workers."""


class StopTraining(Exception):  # noqa: N818 - a request, as StopIteration is
    """Raised by a listener to end the run after this generation, as if it were over."""


AnyListener: TypeAlias = "Callable[[Row], Any] | object | Sequence[Any] | None"
"""A function of a row of `progress.csv`, an object with any of the methods below, several of these, or None."""

_METHODS = {
    "on_start": ("path", "config", "generation", "num_workers"),  # of the run, which begins after `generation`
    "on_generation": ("row",),  # of progress.csv
    "on_evaluation": ("row",),  # of evaluation.csv
    "on_event": ("event",),  # a warning: a silent or lost worker, diverged episodes, or one of the simulator
}
"""Methods of a listener, with their parameters. One that returns True ends the run."""


ListenerMethods: TypeAlias = dict[str, Callable[..., Any]]
"""The methods of a listener by name; a plain function is its `on_generation`."""


def listener_methods(listener: AnyListener) -> list[ListenerMethods]:
    """Return the methods of each listener; raise ConfigError or UnknownNameError if one has none of these."""
    if isinstance(listener, list | tuple):
        return [methods for each in listener for methods in listener_methods(each)]
    if listener is None:
        return []
    if isinstance(listener, type):
        name = listener.__name__
        raise ConfigError(f"listener must be an object, got the class {name}. Write {name}().")
    names = [name for name in dir(listener) if name.startswith("on_") and callable(getattr(listener, name))]
    if unknown := [name for name in names if name not in _METHODS]:
        raise UnknownNameError("method of a listener", unknown[0], _METHODS, "Rename it.")
    found = {name: getattr(listener, name) for name in names}
    if not found and callable(listener):
        found = {"on_generation": listener}
    if not found:
        raise ConfigError(
            f"listener must be a function of a row, or an object with any of {', '.join(_METHODS)}; got {listener!r}."
        )
    for name, method in found.items():
        shown = getattr(method, "__qualname__", repr(method))
        if inspect.iscoroutinefunction(method):
            raise ConfigError(f"listener {shown} must be a plain function, not an async one.")
        try:
            inspect.signature(method).bind(*_METHODS[name])
        except TypeError as error:
            raise ConfigError(f"listener {shown} must take ({', '.join(_METHODS[name])}): {error}.") from error
        except ValueError:  # some built-in functions have no signature
            pass
    return [found]


class Divergence:
    """The diverged generations of a run during one call: from them nothing is learned."""

    def __init__(self, env: str) -> None:
        self._env, self._in_a_row, self._is_any_sound = env, 0, False

    def add(self, row: Mapping[str, Any]) -> str | None:
        """Count a generation by its row of `progress.csv`; return a warning if all its episodes diverged."""
        returns = [value for name, value in row.items() if name.endswith("_return_mean")] or [0.0]
        if row.get("diverged_rate") != 1 and any(map(math.isfinite, returns)):
            self._in_a_row, self._is_any_sound = 0, True
            return None
        self._in_a_row += 1
        return (
            f"every episode of generation {row['generation']} diverged (physics, observation or reward not finite): "
            "nothing can be learned from it"
        )

    def check(self, *, is_over: bool) -> None:
        """Raise DivergenceError after ten diverged generations in a row, or at the end of a run of nothing else."""
        count = self._in_a_row
        if count >= _MOST_DIVERGED or (is_over and count and not self._is_any_sound):
            raise DivergenceError(
                f"every episode of the last {count} generation{'s' * (count > 1)} diverged. Likely cause: a reward or "
                f"an observation of {self._env} is NaN or infinite, or its physics is unstable. Check what its reset "
                "and step return. Everything up to the last checkpoint is kept."
            )


class Recorder:
    """Evaluates the generations of a run during one call and writes its files. Close it at the end."""

    def __init__(
        self, folder: RunFolder, algorithm: Algorithm[Any], checkpoint: Checkpoint, listeners: list[ListenerMethods]
    ) -> None:
        """Open the tables and remove the rows after `checkpoint`; raise RunFolderError if a table is damaged."""
        self.folder, self.algorithm, self.checkpoint = folder, algorithm, checkpoint
        self._config: TrainConfig = algorithm.problem.settings
        self._listeners, self._is_stopped = listeners, False
        self._divergence = Divergence(self._config.run.env)
        self._tables = {
            "progress": CsvTable(folder.progress, checkpoint.generation, has_every_row=True),
            "evaluation": CsvTable(folder.evaluation, checkpoint.generation),
        }
        self._events = Events(folder.tensorboard, checkpoint.generation, self._config.numbers())
        self.close = self._events.close

    def begin(self, backend: Backend, changes: Iterable[str]) -> None:
        """Start the clock, and tell of the run, of `changes` since it began, and of warnings about its settings."""
        self._backend = backend
        self._start = self._generation_start = perf_counter()
        self._starts = {name: clock() - last_value(self.folder.progress, name) for name, clock in _CLOCKS.items()}
        backend.on_event = self._tell_event
        self._tell("on_start", self.folder.path, self._config, self.checkpoint.generation, backend.num_workers)
        if changes:
            self._tell_event(f"not as before ({', '.join(changes)}): numbers may differ from here on")
        for warning in self.algorithm.warnings(self.algorithm.problem.settings):
            self._tell_event(warning)

    def is_over(self) -> bool:
        """Return whether the run or the time of this call is over, or a listener has ended it."""
        run, last = self._config.run, self.checkpoint
        is_late = run.minutes is not None and perf_counter() - self._start >= 60 * run.minutes
        return self._is_stopped or is_late or run.is_over(last.generation, last.env_steps)

    def evaluate_if_due(self, report: Report[Any]) -> tuple[Row, Row | None]:
        """Return the row of a generation, and that of its evaluation if it is due. This writes no file."""
        state, now, settings = report.state, perf_counter(), self._config.evaluation
        reached = {"generation": state.generation, "env_steps": state.env_steps}
        made = state.env_steps - self.checkpoint.env_steps
        row: Row = {
            **reached,
            **self._time("wall_time_s"),
            "env_steps_per_s": round(made / (now - self._generation_start), 1),
            **report.columns,
            "evaluation_s": 0.0,
        }
        evaluated = None
        if state.generation == 1 or state.generation % settings.evaluation_interval == 0:
            seeds = evaluation_seeds(state.seed, state.generation, settings.evaluation_episodes)
            found = evaluate_state(self.algorithm, state, seeds, self._backend).summary()
            row["evaluation_s"] = round(perf_counter() - now, 4)
            evaluated = {**reached, **self._time("wall_time_s"), **found, **self._time("process_time_s")}
        row |= self._time("process_time_s")
        self._generation_start = perf_counter()
        return row, evaluated

    def add(self, report: Report[Any], row: Row, evaluated: Row | None) -> None:
        """Write the rows and the checkpoints of a generation, and tell the listeners."""
        warning = self._divergence.add(row)
        for event in (*report.log, *([warning] if warning else [])):
            self._tell_event(event)
        for name, added in (("progress", row), ("evaluation", evaluated)):
            if added is not None:
                self._tables[name].add(added)  # a checkpoint on the disk needs the rows before it
                self._events.add(name, added)
        self._save(report.state, is_best=self._is_best(evaluated))
        self._tell("on_generation", row)
        if evaluated is not None:
            self._tell("on_evaluation", evaluated)
        self._divergence.check(is_over=self.is_over())

    def _is_best(self, evaluated: Row | None) -> bool:
        """Return whether an evaluation is the best so far, which it then becomes."""
        if evaluated is None:
            return False
        count, best = evaluated["episodes"], self.checkpoint.best
        if evaluated["diverged_episodes"] == count:
            self._tell_event(f"all {count} episodes of the evaluation diverged: its score does not count")
            return False
        found = Best(
            generation=evaluated["generation"], score=evaluated["score_mean"], mean_return=evaluated["return_mean"]
        )
        is_best = (found.score, found.mean_return) >= (best.score, best.mean_return)
        self.checkpoint = replace(self.checkpoint, best=found if is_best else best)
        return is_best

    def _save(self, state: Any, *, is_best: bool) -> None:
        """Write the checkpoints of a generation; `last` comes last."""
        checkpoint = replace(self.checkpoint, arrays=self.algorithm.to_arrays(state))
        is_kept = state.generation % self._config.evaluation.keep_checkpoints == 0
        names = ["best"] * is_best + [str(state.generation)] * is_kept
        if names:
            kept = self.algorithm.kept(state)
            arrays = checkpoint.arrays if kept is state else self.algorithm.to_arrays(kept)
            for name in names:
                save_checkpoint(self.folder.checkpoint_path(name), replace(checkpoint, arrays=arrays))
        save_checkpoint(self.folder.checkpoint_path("last"), checkpoint)
        self.checkpoint = checkpoint

    def _time(self, column: str) -> Row:  # of the run so far, in seconds
        return {column: round(_CLOCKS[column]() - self._starts[column], 3)}

    def _tell_event(self, event: str) -> None:
        logger.warning(event)
        self._tell("on_event", event)

    def _tell(self, method: str, *content: Any) -> None:
        """Call `method` of every listener that has it; one of them may end the run."""
        for methods in self._listeners:
            try:
                answer = methods[method](*content) if method in methods else None
            except StopTraining:
                answer = True
            if isinstance(answer, bool | np.bool_) and answer and not self._is_stopped:
                logger.info("a listener ends the run")
                self._is_stopped = True


@contextmanager
def run_log(folder: RunFolder) -> Iterator[None]:
    """Write the log of the run to its `log.txt` inside the block.

    An error that ends the block is logged with its traceback, which says where in the user's own code it began.
    """
    with storage_errors(folder.log):
        file = logging.FileHandler(folder.log, encoding="utf-8")
    file.handleError = lambda *_, **__: None  # a full disk ends the run when tables or checkpoints are written
    file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    previous = logger.level, logger.propagate
    logger.addHandler(file)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        yield
    except Exception:
        logger.exception("the run ends with an error")
        raise
    finally:
        logger.removeHandler(file)
        logger.level, logger.propagate = previous
        with suppress(OSError):  # buffered text may not fit on the disk
            file.close()
