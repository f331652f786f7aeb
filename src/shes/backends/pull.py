"""Base class of the backends with remote workers: it hands out tasks, and repeats those of lost and silent workers.

A subclass starts workers and waits for their messages, over pipes, Ray or MPI. `shes.backends.serving` is the other
side of the conversation.
"""

from __future__ import annotations

import pickle
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Annotated, Any, ClassVar

from shes.backends.backend import Backend
from shes.errors import WorkerError
from shes.settings import Execution, Gt, Settings

MAX_LOSSES = 3
"""The run ends when this many workers died on one task, or as many per worker in a row without a result."""
_TOLD_AT, _REPLACED_AT = 2, 10
"""A worker is told of, and replaced, only if its silence is this many times the longest that ended with a result."""
_PATIENCE = 4
"""Factor of the limit after each loss of the same task, or each loss in a row: maybe the work just takes long."""
_TICK_S = 1.0


@dataclass(frozen=True, kw_only=True)
class WarningSettings(Settings):
    """When to tell of workers that give no answer."""

    worker_warning_s: Annotated[float, Gt(0), Execution()] | None = 60.0
    """Seconds without an answer after which a warning names the worker; none for no warning. Long tasks get longer."""


@dataclass(frozen=True, kw_only=True)
class SilenceSettings(WarningSettings):
    """Limits for workers that give no answer."""

    worker_timeout_s: Annotated[float, Gt(0), Execution()] | None = 600.0
    """Seconds without an answer after which a worker (stopped, swapped out) is replaced; none for never. If tasks take
    long, ten times the longest so far."""


class RemoteWorker(ABC):
    """A worker in another process as its parent sees it, and the tasks it is working on."""

    def __init__(self) -> None:
        """Begin without tasks."""
        self.tasks: dict[int, None] = {}  # numbers of the tasks at work, in the order they were given
        self.is_started = True
        """Whether a process for it exists; if not, it waits for a core of the cluster."""
        self.is_running = False
        self.silent_s = 0.0
        """Seconds that the parent has waited for a message since the last one."""
        self.is_told = False
        """Whether the user has been told of the silence."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the worker in messages."""

    @property
    @abstractmethod
    def ending(self) -> str:
        """How the worker ended, in short."""

    @property
    def cause(self) -> str:
        """How the worker ended, at length."""
        return self.ending

    @abstractmethod
    def send(self, *message: Any) -> None:
        """Send a message soon. If the worker is gone, the next read notices it."""

    @abstractmethod
    def receive(self) -> Sequence[tuple[Any, ...]]:
        """Return the messages that have arrived.

        Raises:
            EOFError: The worker is gone. So does OSError.
            BlockingIOError: The worker has stopped in the middle of a message.
        """

    @abstractmethod
    def end(self) -> None:
        """End the worker immediately, even if it has been stopped."""


class Run:
    """State of one `map` call."""

    def __init__(self, tasks: Sequence[Any], share: int) -> None:
        self.tasks = tasks
        self.share = share
        self.queue: deque[int] = deque(range(len(tasks)))
        self.results: dict[int, Any] = {}
        self.losses: Counter[int] = Counter()


class PullBackend(Backend):
    """Workers in other processes, which ask for tasks."""

    most_at_once: ClassVar[int] = 1
    """Largest number of tasks in an answer. More save messages; the last tasks are always given one by one."""

    def __init__(self, num_workers: int, worker_warning_s: float | None, worker_timeout_s: float | None) -> None:
        """Begin without workers. See `SilenceSettings` for the limits of silence."""
        self.num_workers = num_workers
        self.worker_warning_s, self.worker_timeout_s = worker_warning_s, worker_timeout_s
        limits = [limit for limit in (worker_warning_s, worker_timeout_s) if limit is not None]
        self._tick_s = max(0.01, min([_TICK_S, *(limit / 4 for limit in limits)]))
        self._longest_s = 0.0  # of the silences that ended with a result
        self._deaths_in_a_row = 0
        self._state: bytes | None = None  # the last one, pickled
        self._workers: list[Any] = []

    @abstractmethod
    def _start_missing(self) -> None:
        """Start the workers that are missing, and send them the state."""

    @abstractmethod
    def _ready(self, timeout_s: float) -> Sequence[RemoteWorker]:
        """Wait at most `timeout_s` for messages; return the workers that have sent some, or are gone."""

    @abstractmethod
    def _advice(self, worker: RemoteWorker) -> str:
        """Return advice to the user about a worker that ended."""

    def broadcast(self, state: Any) -> None:
        """Send `state` to every worker, and later to the replacements of lost ones."""
        self._state = pickle.dumps(state, pickle.HIGHEST_PROTOCOL)
        for worker in self._workers:
            worker.send("state", self._state)
        self._start_missing()

    def map(self, tasks: Sequence[Any]) -> Iterator[Any]:
        """Yield the result of every task, in order."""
        run = Run(tasks, share=max(1, -(-len(tasks) // self.num_workers)))
        is_finished = False
        try:
            self._start_missing()
            self._start_run(run)
            next_number = 0
            while next_number < len(tasks):
                self._serve(run)
                while next_number in run.results:
                    yield run.results.pop(next_number)
                    next_number += 1
            while any(worker.is_running for worker in self._workers):
                self._serve(run)
            is_finished = True
        finally:
            if not is_finished:  # a worker raised, or the caller stopped iterating: nobody needs the remaining results
                self.close()

    def _start_run(self, run: Run) -> None:
        """Let the workers that have no work request tasks."""
        for worker in self._workers:
            if worker.is_started and not worker.is_running:
                worker.is_running, worker.silent_s = True, 0.0
                worker.send("run", run.share)

    def _serve(self, run: Run) -> None:
        """Wait for messages and answer them. Replace workers that have died or given no answer for too long."""
        start = monotonic()
        ready = self._ready(self._tick_s)
        # Time in which this process has been stopped, for example by Ctrl-Z together with its workers, does not count.
        waited_s = min(monotonic() - start, self._tick_s)
        for worker in self._workers:
            worker.silent_s += waited_s
        for worker in ready:
            try:
                messages = worker.receive()
            except BlockingIOError:  # it was stopped while it sent a message
                worker.silent_s += self.worker_timeout_s or 0.0
                self._replace(worker, run, is_silent=True)
            except (EOFError, OSError):
                self._replace(worker, run)
            else:
                for message in messages:
                    self._answer(worker, message, run)
                self._end_silence(worker)
        for worker in list(self._workers):
            if worker.is_running:
                self._judge_silence(worker, run)

    def _end_silence(self, worker: RemoteWorker) -> None:
        """Note that the worker has sent a message."""
        if worker.is_told:
            self._tell(f"worker {worker.name} answers again, after {worker.silent_s:.0f} s")
        worker.silent_s, worker.is_told = 0.0, False

    def _judge_silence(self, worker: RemoteWorker, run: Run) -> None:
        """Tell of a worker that has been silent for long, or replace it."""
        losses = max(self._deaths_in_a_row, *(run.losses[number] for number in worker.tasks), 0)
        limit_s = max(self.worker_timeout_s or 0.0, _REPLACED_AT * self._longest_s) * _PATIENCE ** min(
            losses, MAX_LOSSES - 1
        )
        if self.worker_timeout_s is not None and worker.silent_s >= limit_s:
            self._replace(worker, run, is_silent=True)
        elif (
            self.worker_warning_s is not None
            and not worker.is_told
            and worker.silent_s >= max(self.worker_warning_s, _TOLD_AT * self._longest_s)
        ):
            worker.is_told = True
            end = "never replaced" if self.worker_timeout_s is None else f"replaced after {limit_s:.0f} s"
            self._tell(
                f"worker {worker.name} has given no answer for {worker.silent_s:.0f} s; it is {end} "
                "(--worker-timeout-s)"
            )

    def _answer(self, worker: RemoteWorker, message: tuple[Any, ...], run: Run) -> None:
        kind, *content = message
        if kind == "want":
            self._give(worker, run)
        elif kind == "result":
            number, result = content
            worker.tasks.pop(number)
            run.results[number] = result
            self._deaths_in_a_row = 0
            self._longest_s = max(self._longest_s, worker.silent_s)
        elif kind == "done":
            worker.is_running = False
        elif kind == "refused":
            raise content[0]
        elif kind == "failed":
            at_work = ", ".join(repr(run.tasks[number]) for number in list(worker.tasks)[:3])
            raise WorkerError(f"a worker failed while at work on {at_work or 'nothing yet'}:\n{content[0]}")

    def _give(self, worker: RemoteWorker, run: Run) -> None:
        """Give the worker its next tasks: fewer and fewer, so that all workers end at the same time."""
        if not run.queue:
            worker.send("end")
            return
        count = max(1, min(self.most_at_once, len(run.queue) // (2 * self.num_workers)))
        numbers = [run.queue.popleft() for _ in range(count)]
        worker.tasks.update(dict.fromkeys(numbers))
        given = [(number, run.tasks[number]) for number in numbers]
        worker.send("tasks", pickle.dumps(given, pickle.HIGHEST_PROTOCOL))

    def _replace(self, worker: RemoteWorker, run: Run, *, is_silent: bool = False) -> None:
        """Replace a worker that died or is silent, and put its tasks back at the front of the queue."""
        self._workers.remove(worker)
        worker.end()
        lost = list(worker.tasks)
        run.queue.extendleft(reversed(lost))
        run.losses.update(lost)
        self._deaths_in_a_row += 1
        silence = f"no answer for {worker.silent_s:.0f} s"
        end = f"was ended ({silence})" if is_silent else f"died ({worker.ending})"
        self._tell(f"worker {worker.name} {end}; {len(lost)} tasks are done again")
        worst = max(run.losses.values(), default=0)
        if worst >= MAX_LOSSES or self._deaths_in_a_row >= MAX_LOSSES * self.num_workers:
            fault = f"giving {silence}" if is_silent else f"dying ({worker.cause})"
            advice = "If its work takes so long, raise --worker-timeout-s." if is_silent else self._advice(worker)
            raise WorkerError(
                f"workers keep {fault} {f'on the same task, {worst} times' if worst else 'at once'}. "
                f"{advice} Everything up to the last checkpoint is kept."
            )
        self._start_missing()
        self._start_run(run)

    def _tell(self, event: str) -> None:
        if self.on_event is not None:
            self.on_event(event)
