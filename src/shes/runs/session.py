"""The records of a run during one call of `train` or `resume`: tables, evaluations, checkpoints, events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from time import perf_counter, process_time
from typing import Any

import numpy as np

from shes.algorithms.contract import Algorithm, Report
from shes.backends.backend import Backend
from shes.runs.checkpoint import Best, Checkpoint
from shes.runs.config import TrainConfig
from shes.runs.divergence import Divergence
from shes.runs.evaluate import EvaluationBeside, evaluation_seeds
from shes.runs.folder import RunFolder
from shes.runs.interruption import Interruption
from shes.runs.listening import Audience
from shes.runs.log import logger
from shes.runs.tables import Row, read_process_time, read_wall_time
from shes.runs.writer import RunWriter


@dataclass(frozen=True, kw_only=True)
class _Owed:
    """An evaluation under way."""

    evaluation: EvaluationBeside
    checkpoint: Checkpoint
    """The evaluated state."""
    kept: Mapping[str, np.ndarray]
    """Its arrays in a checkpoint that is kept beside `last`."""


class Session:
    """The records, evaluations and checkpoints of a run during one call.

    A generation is evaluated beside the next one. Until then its checkpoint marks the evaluation as pending.
    """

    def __init__(
        self,
        folder: RunFolder,
        algorithm: Algorithm[Any],
        checkpoint: Checkpoint,
        writer: RunWriter,
        backend: Backend,
        audience: Audience,
    ) -> None:
        self.checkpoint = checkpoint
        self._folder, self._algorithm = folder, algorithm
        self._config: TrainConfig = algorithm.problem.settings
        self._divergence = Divergence(self._config)
        self._writer, self._backend, self._audience = writer, backend, audience
        self._owed: _Owed | None = None
        self._is_stopped = False
        self._earlier_s = read_wall_time(folder.progress)
        self._earlier_process_s = read_process_time(folder.progress)
        self._start = self._generation_start = perf_counter()
        self._process_start = process_time()
        backend.on_event = self._tell_event
        self._tell("on_start", folder.path, self._config, checkpoint.generation, backend.num_workers)

    def log_warnings(self) -> None:
        """Log the algorithm's warnings about the settings."""
        for warning in self._algorithm.warnings():
            self._tell_event(warning)

    def is_over(self) -> bool:
        """Return whether the run or the time of this call is over, or a listener has ended it."""
        minutes = self._config.run.minutes
        is_late = minutes is not None and perf_counter() - self._start >= 60 * minutes
        last = self.checkpoint
        return self._is_stopped or is_late or self._config.run.is_over(last.generation, last.env_steps)

    def start_owed_evaluation(self, state: Any) -> None:
        """Begin the evaluation that the checkpoint of `state` marks as pending, if any."""
        if self.checkpoint.owes_evaluation:
            self._owed = self._evaluate(state, self.checkpoint)

    def add(self, report: Report[Any], interruption: Interruption) -> None:
        """Record a generation, after the evaluation of the one before; evaluate it if that is due, and checkpoint it.

        A listener of that evaluation may end the run: then the generation is dropped.

        Raises:
            DivergenceError: Every episode of the last generations has diverged.
        """
        self._add_evaluation()
        if self._is_stopped:
            return
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
        warning = self._divergence.add(row)
        for event in (*report.log, *([warning] if warning else [])):
            self._tell_event(event)
        is_due = state.generation == 1 or state.generation % self._config.evaluation.evaluation_interval == 0
        arrays = self._algorithm.to_arrays(state)
        checkpoint = replace(self.checkpoint, arrays=arrays, owes_evaluation=is_due)
        if is_due:
            with interruption.at_once():
                self._owed = self._evaluate(state, checkpoint)
        self._generation_start = perf_counter()
        row["evaluation_s"] = round(self._generation_start - now, 4) if is_due else 0.0
        row["process_time_s"] = self._process_time()
        self._writer.add_row("progress", row)
        if not is_due:
            self._keep(checkpoint, self._kept(state, checkpoint))
        # `last` comes last: a run killed before that repeats this generation.
        self._save("last", checkpoint)
        self.checkpoint = checkpoint
        self._tell("on_generation", row)
        if self._algorithm.shares_memory:
            self.finish(interruption)
            self._writer.wait()
            self._generation_start = perf_counter()
        elif self._owed is not None and self._owed.evaluation.is_done:
            self._add_evaluation()
        self._divergence.check(is_over=self.is_over())

    def finish(self, interruption: Interruption) -> None:
        """Finish the evaluation of the last generation, if it is under way."""
        if self._owed is not None:
            with interruption.at_once():
                self._owed.evaluation.result()
            self._add_evaluation()

    def close(self) -> None:
        """Record the evaluation under way if all its episodes have ended: an error or Ctrl-C loses no result."""
        if self._owed is not None and self._owed.evaluation.is_done:
            self._add_evaluation()

    def _evaluate(self, state: Any, checkpoint: Checkpoint) -> _Owed:
        """Begin the evaluation of `state`, which is that of `checkpoint`."""
        seeds = evaluation_seeds(state.seed, state.generation, self._config.evaluation.evaluation_episodes)
        return _Owed(
            evaluation=EvaluationBeside(self._algorithm, state, seeds, self._backend),
            checkpoint=checkpoint,
            kept=self._kept(state, checkpoint),
        )

    def _kept(self, state: Any, checkpoint: Checkpoint) -> Mapping[str, np.ndarray]:
        """Return the arrays of `state`, which is that of `checkpoint`, in a checkpoint that is kept beside `last`."""
        kept = self._algorithm.kept(state)
        return checkpoint.arrays if kept is state else self._algorithm.to_arrays(kept)

    def _add_evaluation(self) -> None:
        """Record the evaluation under way, if any, and keep its state if it is the best so far."""
        if self._owed is None:
            return
        owed, self._owed = self._owed, None
        found = owed.evaluation.result()
        evaluated = replace(owed.checkpoint, owes_evaluation=False)
        row: Row = {
            "generation": evaluated.generation,
            "env_steps": evaluated.env_steps,
            "wall_time_s": round(self._earlier_s + perf_counter() - self._start, 3),
            **found.summary(),
            "process_time_s": self._process_time(),
        }
        self._writer.add_row("evaluation", row)
        is_sound = row["diverged_episodes"] < row["episodes"]  # else its score means nothing
        if is_sound and evaluated.best.is_beaten_by(row["score_mean"], row["return_mean"]):
            best = Best(generation=evaluated.generation, score=row["score_mean"], mean_return=row["return_mean"])
            evaluated = replace(evaluated, best=best)
            self._save("best", replace(evaluated, arrays=owed.kept))
        if not is_sound:
            self._tell_event(f"all {row['episodes']} episodes of the evaluation diverged: its score does not count")
        self._keep(evaluated, owed.kept)
        self._save("last", evaluated)
        self.checkpoint = evaluated
        self._tell("on_evaluation", row)

    def _process_time(self) -> float:
        """Return the processor time of this process for the run so far, in seconds; without that of its workers."""
        return round(self._earlier_process_s + process_time() - self._process_start, 3)

    def _keep(self, checkpoint: Checkpoint, arrays: Mapping[str, np.ndarray]) -> None:
        """Save a checkpoint with `arrays` under its generation if it is one of those to keep."""
        if checkpoint.generation % self._config.evaluation.keep_checkpoints == 0:
            self._save(str(checkpoint.generation), replace(checkpoint, arrays=arrays))

    def _save(self, name: str, checkpoint: Checkpoint) -> None:
        self._writer.save(self._folder.checkpoint_path(name), checkpoint)

    def _tell_event(self, event: str) -> None:
        logger.warning(event)
        self._tell("on_event", event)

    def _tell(self, method: str, *content: Any) -> None:
        """Tell the listeners; one of them may end the run."""
        if self._audience.tell(method, *content) and not self._is_stopped:
            logger.info("a listener ends the run")
            self._is_stopped = True
