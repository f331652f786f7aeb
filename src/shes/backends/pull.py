"""Base class of the backends with remote workers: it hands out tasks, and repeats those of lost and silent workers.

A subclass starts workers and waits for their messages, over pipes, Ray or MPI. `shes.backends.serving` is the other
side of the conversation.
"""

from __future__ import annotations

import pickle
from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Annotated, Any

from shes.backends.backend import Backend, Pending
from shes.backends.job import Job, State
from shes.backends.remote_worker import RemoteWorker
from shes.errors import WorkerError
from shes.settings import Execution, Gt, Settings

MAX_LOSSES = 3
"""The run ends when this many workers died on one unit of work, or as many per worker in a row without a result."""
_TOLD_AT, _REPLACED_AT = 2, 10
"""A silent worker is reported or replaced only after this multiple of the longest silence that ended with a result."""
_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S = 1.0, 60.0
"""Pause before workers are started again, if others died before they were ready; it doubles each time."""
_PATIENCE = 4
"""Factor of the limit after each loss of the same task, or each loss in a row: maybe the work just takes long."""
_TICK_S = 1.0


@dataclass(frozen=True, kw_only=True)
class WarningSettings(Settings):
    """When to warn of workers that do not answer."""

    worker_warning_s: Annotated[float, Gt(0), Execution()] | None = 60.0
    """Seconds without an answer after which a warning names the worker; none for no warning. The limit is longer for
    long tasks."""


@dataclass(frozen=True, kw_only=True)
class SilenceSettings(WarningSettings):
    """Limits for workers that give no answer."""

    worker_timeout_s: Annotated[float, Gt(0), Execution()] | None = 600.0
    """Seconds without an answer after which a worker (stopped, swapped out) is replaced; none for never. If tasks take
    long, ten times the longest so far."""


class PullBackend(Backend):
    """Workers in other processes, which ask for tasks.

    A subclass fills `workers` in `start_workers`, which its constructor calls, and defines `ready_workers`, `advice`
    and `close`. It may override `send_state`, `end_worker` and `look_around`.
    """

    def __init__(self, num_workers: int, worker_warning_s: float | None, worker_timeout_s: float | None) -> None:
        """Begin without workers. See `SilenceSettings` for the limits of silence."""
        self.num_workers = num_workers
        self.worker_warning_s, self.worker_timeout_s = worker_warning_s, worker_timeout_s
        limits = [limit for limit in (worker_warning_s, worker_timeout_s) if limit is not None]
        self._tick_s = max(0.01, min([_TICK_S, *(limit / 4 for limit in limits)]))
        self._clock_s = 0.0  # how long this process has waited for messages
        self._judged_s = 0.0  # when silent workers were last looked for
        self._longest_s = 0.0  # of the silences that ended with a result
        self._deaths_in_a_row = 0
        self._most_workers = 0  # a cluster that has lost a node has fewer
        self._pause_s = _SHORTEST_PAUSE_S
        self._starts_at = 0.0  # when the next workers may start
        self._state: State | None = None  # the last broadcast
        self._beside: list[Job] = []  # to be done beside the next `map`
        self._jobs: list[Job] = []  # of the `map` under way
        self.workers: list[Any] = []
        """The workers that are not known to have died."""

    @abstractmethod
    def start_workers(self) -> None:
        """Start the workers that are missing from `workers`: at first, after a loss, and before work."""

    @property
    def pauses(self) -> bool:
        """Whether workers have died before they were ready, so that others are started only after a while."""
        return bool(self.workers) and monotonic() < self._starts_at

    def _restart_workers(self) -> None:
        """Start the workers that are missing, unless it `pauses`."""
        if not self.pauses:
            self.start_workers()

    @abstractmethod
    def ready_workers(self, timeout_s: float) -> Sequence[RemoteWorker]:
        """Wait at most `timeout_s` for messages; return the workers that have sent some, or are gone."""

    @abstractmethod
    def advice(self, worker: RemoteWorker) -> str:
        """Return advice to the user about a worker that ended."""

    def broadcast(self, state: Any) -> None:
        """Send `state` to every worker, and later to those that are in another run or have not started."""
        self._state = State(pickle.dumps(state, pickle.HIGHEST_PROTOCOL))
        self._restart_workers()
        for worker in self.workers:
            if worker.job is None and worker.is_started:
                self.send_state(worker, self._state)

    def send_state(self, worker: RemoteWorker, state: State) -> None:
        """Send `state` to one worker, and let it note that. `state.stored` is for what all workers share."""
        worker.note_state(state)
        worker.send("state", state.number, state.pickled)

    def map(self, tasks: Sequence[Any]) -> Iterator[Any]:
        """Yield the result of every task, in order."""
        job = Job(tasks, self._state, self.num_workers)
        return self._do([*self._beside, job], job)

    def beside(self, tasks: Sequence[Any], state: Any) -> Pending:
        """Do `tasks`, which refer to `state`, in the next `map` call. Workers begin with them."""
        job = Job(tasks, State(pickle.dumps(state, pickle.HIGHEST_PROTOCOL)), self.num_workers)
        self._beside.append(job)
        return _Beside(job, self._do_beside)

    def _do_beside(self, job: Job) -> Iterator[Any]:
        """Do `job` alone, if it still waits for the next `map` call; yield its results in order."""
        if job not in self._beside:
            raise WorkerError("this work ended with an error, of its own or of the work beside it")
        return self._do([job], job)

    def _do(self, jobs: Sequence[Job], wanted: Job) -> Iterator[Any]:
        """Do all `jobs`, the first one first; yield the results of `wanted` in order."""
        is_finished = False
        self._jobs = list(jobs)
        self._beside = [job for job in self._beside if job not in self._jobs]
        try:
            self._restart_workers()
            self._start_runs()
            while not all(job.is_done for job in self._jobs):
                self._serve()
                yield from wanted.finished()
            while any(worker.job is not None and self.waits_for(worker) for worker in self.workers):
                self._serve()
            is_finished = True
        finally:
            self._jobs = []
            if not is_finished:  # a worker raised, or the caller stopped iterating: nobody needs the remaining results
                self.close()

    def waits_for(self, worker: RemoteWorker) -> bool:
        """Return whether a `map` whose work is done waits for this worker, which is in a run.

        It does not for one that was ready and never asked for tasks, since it may have been stopped; nor, later, for
        one whose run belongs to an earlier `map`.
        """
        return worker.job in self._jobs and not (worker.is_ready and worker.is_expected)

    def _start_runs(self) -> None:
        """Tell the workers without work of the first job that wants them."""
        for job in self._jobs:
            for worker in self.workers:
                if not self._wants_worker(job):
                    break
                if worker.is_started and worker.job is None:
                    self._start_run(worker, job)

    def _wants_worker(self, job: Job) -> bool:
        """Return whether a job wants another worker: for more work, or for lost work that nobody who is here would do.

        A worker that is expected and never asks may have been stopped.
        """
        if job.division.wants_worker:
            return True
        is_left = job.has_losses and job.division.units_left > 0
        return is_left and all(worker.job is not job or worker.is_expected for worker in self.workers)

    def _start_run(self, worker: RemoteWorker, job: Job) -> None:
        if job.state is not None and job.state not in worker.states:
            self.send_state(worker, job.state)
        worker.job, worker.is_expected, worker.heard_s = job, True, self._clock_s
        job.division.expect()
        worker.send("run", job.division.share, None if job.state is None else job.state.number)

    def _serve(self) -> None:
        """Wait for messages and answer them. Replace workers that have died or given no answer for too long."""
        start = monotonic()
        ready = self.ready_workers(self._tick_s)
        # Time in which this process has been stopped, for example by Ctrl-Z together with its workers, does not count.
        self._clock_s += min(monotonic() - start, self._tick_s)
        for worker in ready:
            if worker.is_ended:  # meanwhile
                continue
            try:
                messages = worker.receive()
            except BlockingIOError:  # it was stopped while it sent a message
                worker.heard_s -= self.worker_timeout_s or 0.0
                self._replace(worker, is_silent=True)
            except (EOFError, OSError):
                self._replace(worker)
            else:
                for message in messages:
                    self._answer(worker, message)
                self._end_silence(worker)
        if self._clock_s >= self._judged_s + self._tick_s:
            self._judged_s = self._clock_s
            for worker in [each for each in self.workers if each.job is not None]:
                self._judge_silence(worker)
            if len(self.workers) < self.num_workers:
                self._restart_workers()
        self.look_around()
        self._start_runs()

    def look_around(self) -> None:
        """Do what is due beside messages; called at least once a second while there is work. By default nothing."""

    def _silent_s(self, worker: RemoteWorker) -> float:
        """Return the seconds that this process has waited for a message of the worker since the last one."""
        return self._clock_s - worker.heard_s

    def _end_silence(self, worker: RemoteWorker) -> None:
        """Note that the worker has sent a message."""
        if worker.is_told:
            self.tell(f"worker {worker.name} answers again, after {self._silent_s(worker):.0f} s")
        worker.heard_s, worker.is_told = self._clock_s, False

    def _judge_silence(self, worker: RemoteWorker) -> None:
        """Tell of a worker that has been silent for long, or replace it."""
        assert worker.job is not None
        losses = max(self._deaths_in_a_row, worker.job.most_losses(tuple(worker.numbers))[0])
        limit_s = max(self.worker_timeout_s or 0.0, _REPLACED_AT * self._longest_s) * _PATIENCE ** min(
            losses, MAX_LOSSES - 1
        )
        silent_s = self._silent_s(worker)
        if self.worker_timeout_s is not None and silent_s >= limit_s:
            self._replace(worker, is_silent=True)
        elif (
            self.worker_warning_s is not None
            and not worker.is_told
            and silent_s >= max(self.worker_warning_s, _TOLD_AT * self._longest_s)
        ):
            worker.is_told = True
            end = "never replaced" if self.worker_timeout_s is None else f"replaced after {limit_s:.0f} s"
            hint = " (--worker-timeout-s)" if issubclass(self.Options, SilenceSettings) else ""
            self.tell(f"worker {worker.name} has given no answer for {silent_s:.0f} s; it is {end}{hint}")

    def _answer(self, worker: RemoteWorker, message: tuple[Any, ...]) -> None:
        kind, *content = message
        job = worker.job
        if kind == "refused":
            raise content[0]
        if kind == "failed":
            at_work = [] if job is None else [repr(job.task(number)) for number in list(worker.numbers)[:3]]
            raise WorkerError(f"a worker failed while at work on {', '.join(at_work) or 'nothing yet'}:\n{content[0]}")
        if kind == "ready":
            worker.is_ready, self._pause_s = True, _SHORTEST_PAUSE_S
        if job is None or kind in ("ready", "started"):
            return
        results = content.pop(0)
        for number, result in results:
            worker.numbers.pop(number)
            job.add(number, result)
        if results:
            self._deaths_in_a_row = 0
            self._longest_s = max(self._longest_s, self._silent_s(worker))
        if kind == "want":
            self._meet(worker)
            given = job.give(*content)
            worker.numbers.update(dict.fromkeys(number for number, _ in given))
            worker.send(*(("tasks", pickle.dumps(given, pickle.HIGHEST_PROTOCOL)) if given else ("end",)))
        elif kind == "done":
            self._meet(worker)
            worker.job = None

    @staticmethod
    def _meet(worker: RemoteWorker) -> None:
        """Note that the worker has asked for tasks, or never will."""
        if worker.is_expected and worker.job is not None:
            worker.is_expected = False
            worker.job.division.meet()

    def _replace(self, worker: RemoteWorker, *, is_silent: bool = False) -> None:
        """Replace a worker that died or is silent, and hand out its tasks before all others."""
        self._most_workers = max(self._most_workers, len(self.workers))
        self.workers.remove(worker)
        worker.is_ended = True
        self.end_worker(worker)
        lost = tuple(worker.numbers)
        worst, task = 0, None
        if worker.job is not None:
            self._meet(worker)
            worker.job.take_back(lost)
            worst, task = worker.job.most_losses(lost)
        if not worker.is_ready and any(other.is_ready for other in self.workers):
            if not self.pauses:  # on a node that lacks something, maybe: the others work on
                self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)
                self._starts_at = monotonic() + self._pause_s
        else:
            self._deaths_in_a_row += 1
        silence = f"no answer for {self._silent_s(worker):.0f} s"
        end = f"was ended ({silence})" if is_silent else f"died ({worker.ending})"
        self.tell(f"worker {worker.name} {end}; {len(lost)} tasks are done again")
        if worst >= MAX_LOSSES or self._deaths_in_a_row >= MAX_LOSSES * self._most_workers:
            fault = f"giving {silence}" if is_silent else f"dying ({worker.cause})"
            advice = "If its work takes so long, raise --worker-timeout-s." if is_silent else self.advice(worker)
            error = WorkerError(
                f"workers keep {fault} {f'on the same task, {worst} times' if worst else 'at once'}. "
                f"{advice} Everything up to the last checkpoint is kept."
            )
            error.task = task if worst >= MAX_LOSSES else None
            raise error
        self._restart_workers()
        self._start_runs()

    def end_worker(self, worker: RemoteWorker) -> None:
        """End a worker that is replaced; it has left `workers`."""
        worker.end()

    def tell(self, event: str) -> None:
        """Tell the user of an event, if anyone listens; see `on_event`."""
        if self.on_event is not None:
            self.on_event(event)


class _Beside:
    """A job that is done in the next `map` call, or when its results are asked for."""

    def __init__(self, job: Job, do: Callable[[Job], Iterator[Any]]) -> None:
        self._job, self._do = job, do
        self._results: list[Any] = []

    @property
    def is_done(self) -> bool:
        return self._job.is_done

    def results(self) -> list[Any]:
        self._results += self._job.finished() if self._job.is_done else self._do(self._job)
        return self._results
