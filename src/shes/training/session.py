"""The records of a run during one call of `train` or `resume`: tables, evaluations, checkpoints, events."""

from __future__ import annotations

from time import perf_counter
from typing import Any

from shes.algorithms.contract import Algorithm, Report
from shes.backends.backend import Backend
from shes.runs.checkpoint import Best, Checkpoint, CheckpointWriter
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder
from shes.runs.log import logger
from shes.runs.tables import Records, Row, read_wall_time
from shes.training.divergence import Divergence
from shes.training.evaluate import evaluate_state, evaluation_seeds
from shes.training.interruption import Interruption
from shes.training.listening import Audience


class Session:
    """The records, evaluations and checkpoints of a run during one call."""

    def __init__(
        self,
        folder: RunFolder,
        algorithm: Algorithm[Any],
        checkpoint: Checkpoint,
        records: Records,
        writer: CheckpointWriter,
        backend: Backend,
        audience: Audience,
    ) -> None:
        self.checkpoint = checkpoint
        self._folder, self._algorithm = folder, algorithm
        self._config: TrainConfig = algorithm.problem.settings
        self._divergence = Divergence(self._config)
        self._records, self._writer, self._backend, self._audience = records, writer, backend, audience
        self._is_stopped = False
        self._earlier_s = read_wall_time(folder.progress)
        self._start = self._generation_start = perf_counter()
        backend.on_event = self._tell_event
        self._tell("on_start", folder.path, self._config, checkpoint.generation, backend.num_workers)

    def check_schedules(self) -> None:
        """Log a warning if the run ends before its schedules do."""
        config = self._config
        if config.has_schedule and config.run.generations < config.schedules.schedule_generations:
            self._tell_event(
                f"the schedules take {config.schedules.schedule_generations} generations, but the run ends after "
                f"{config.run.generations}, short of their end: see --schedule-generations"
            )

    def is_over(self) -> bool:
        """Return whether the run or the time of this call is over, or a listener has ended it."""
        minutes = self._config.run.minutes
        is_late = minutes is not None and perf_counter() - self._start >= 60 * minutes
        last = self.checkpoint
        return self._is_stopped or is_late or self._config.run.is_over(last.generation, last.env_steps)

    def add(self, report: Report[Any], interruption: Interruption) -> None:
        """Record a generation, evaluate if it is due, and start writing the checkpoint.

        Raises:
            DivergenceError: Every episode of the last generations has diverged.
        """
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
        warning = self._divergence.add(row)
        for event in (*report.log, *([warning] if warning else [])):
            self._tell_event(event)
        # `last` comes last: a run killed before that repeats this generation with its evaluation and checkpoints.
        best, paths = self.checkpoint.best, [self._folder.checkpoint_path("last")]
        if state.generation == 1 or state.generation % self._config.evaluation.evaluation_interval == 0:
            with interruption.at_once():
                evaluation = self._evaluate(state)
            self._records.add("evaluation", evaluation)
            is_sound = evaluation["diverged_episodes"] < evaluation["episodes"]  # else its score means nothing
            if is_sound and best.is_beaten_by(evaluation["score_mean"], evaluation["return_mean"]):
                best = Best(
                    generation=state.generation, score=evaluation["score_mean"], mean_return=evaluation["return_mean"]
                )
                paths.insert(0, self._folder.checkpoint_path("best"))
            if not is_sound:
                self._tell_event(
                    f"all {evaluation['episodes']} episodes of the evaluation diverged: its score does not count"
                )
            self._tell("on_evaluation", evaluation)
            self._generation_start = perf_counter()
            row["evaluation_s"] = round(self._generation_start - now, 4)
        if state.generation % self._config.evaluation.keep_checkpoints == 0:
            paths.insert(0, self._folder.checkpoint_path(str(state.generation)))
        self._records.add("progress", row)
        self.checkpoint = self._checkpoint(state, best)
        kept = self._algorithm.kept(state)
        if kept is not state and paths[:-1]:
            self._writer.write(paths[:-1], self._checkpoint(kept, best))
            paths = paths[-1:]
        self._writer.write(paths, self.checkpoint)
        self._tell("on_generation", row)
        self._divergence.check(is_over=self.is_over())

    def _checkpoint(self, state: Any, best: Best) -> Checkpoint:
        """Return the checkpoint of `state`."""
        return Checkpoint(arrays=self._algorithm.to_arrays(state), best=best, numbers=self.checkpoint.numbers)

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

    def _tell_event(self, event: str) -> None:
        logger.warning(event)
        self._tell("on_event", event)

    def _tell(self, method: str, *content: Any) -> None:
        """Tell the listeners; one of them may end the run."""
        if self._audience.tell(method, *content) and not self._is_stopped:
            logger.info("a listener ends the run")
            self._is_stopped = True
