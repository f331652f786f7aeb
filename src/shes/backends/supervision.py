"""Supervision of workers in other processes: who has which task, who is gone, and what is repeated.

A backend derives from `SupervisingBackend`, starts its workers, and carries requests and answers over pipes, Ray or
MPI. `shes.backends.serving` is the worker's side of the conversation.
"""

from __future__ import annotations

import pickle
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from textwrap import shorten
from time import monotonic, sleep
from typing import Any, ClassVar

from shes.backends.backend import Backend
from shes.errors import WorkerError

MAX_LOSSES = 3
"""The run ends when so many workers were lost with the same task, or so many per worker in a row without a result."""
REPORTED_S = 60.0
"""Seconds without a sign of life after which a worker is reported; less if it is replaced sooner."""
CLOSE_S = 5.0
"""Seconds that workers have to close their environments before they are killed."""
_TICK_S = 1.0
_MOST_LETTERS = 60  # of a task in a message


class RemoteWorker(ABC):
    """A worker in another process as its parent sees it."""

    def __init__(self, name: str, *, is_started: bool = True) -> None:
        self.name = name
        self.is_started = is_started  # if not, it waits for a core of the cluster
        self.is_ready = False  # it has sent a request
        self.is_idle = False  # it waits for tasks: its last request has no answer yet
        self.is_expected = False  # it has been told of tasks, and has not asked for any yet
        self.tasks: dict[int, None] = {}  # numbers of the tasks that it has, in the order they were given
        self.state: bytes | None = None  # the state that it has
        self.silent_s = 0.0  # time since its last request
        self.is_reported = False  # the user has been told of its silence

    @abstractmethod
    def answer(self, message: tuple[Any, ...], state: bytes | None = None) -> None:
        """Answer its request, soon and without waiting. If the worker is gone, `requests` notices it."""

    @abstractmethod
    def requests(self) -> Sequence[tuple[Any, ...]]:
        """Return the requests that have arrived; raise EOFError or another OSError if the worker is gone."""

    @abstractmethod
    def stop(self) -> None:
        """Let the worker close its environments and end."""

    def has_stopped(self) -> bool:
        """Return whether the worker has ended."""
        return True

    def end(self) -> str:
        """End the worker at once, even if it does not answer; return how it ended, in words, if that is known."""
        return ""


class SupervisingBackend(Backend):
    """Workers in other processes, which ask for tasks.

    A subclass appends to `workers` in `start_workers`, which its constructor calls.
    """

    silence_limit_s: float | None = 600.0
    """Seconds without a sign of life after which a worker is replaced; None for never."""
    advice: ClassVar[str] = "--backend serial does the same work in this process."
    """Advice in the message about workers that keep dying."""

    def __init__(self, num_workers: int) -> None:
        self.num_workers = num_workers
        self.clock: Callable[[], float] = monotonic
        self.workers: list[Any] = []
        """The workers that are not known to be gone."""
        self._losses_in_a_row = 0
        self._most_workers = 0  # a cluster that has lost a node has fewer
        self._state: bytes | None = None
        self._begin_map(())

    @abstractmethod
    def start_workers(self) -> None:
        """Start the workers that are missing from `workers`: at the start of a `map`, and after a loss."""

    @abstractmethod
    def wait(self, timeout_s: float) -> Sequence[RemoteWorker]:
        """Wait at most `timeout_s` for requests; return the workers that have sent some, or are gone."""

    def look_around(self) -> None:
        """Do what is due between requests; called once a second while there are tasks."""

    def broadcast(self, state: Any) -> None:
        """Keep `state` for every worker that is given tasks from now on."""
        self._state = pickle.dumps(state, pickle.HIGHEST_PROTOCOL)

    def map(self, tasks: Sequence[Any]) -> Iterator[Any]:
        """Yield the result of every task, in order."""
        self._begin_map(tasks)
        is_finished, next_number = False, 0
        try:
            self.start_workers()
            self._engage()
            while next_number < len(tasks):
                self.serve_requests()
                while next_number in self._results:
                    yield self._results.pop(next_number)
                    next_number += 1
            # One that never asked is not waited for: it may have been stopped.
            while any(each.is_ready and not (each.is_idle or each.is_expected) for each in self.workers):
                self.serve_requests()
            is_finished = True
        finally:
            self._begin_map(())
            if not is_finished:  # a worker raised, or the caller stopped iterating: nobody needs the remaining results
                self.close()

    def close(self) -> None:
        """Let every worker close its environments and end; kill those that do not within seconds."""
        workers, self.workers = self.workers, []
        try:
            for worker in workers:
                worker.stop()
            deadline_s = monotonic() + CLOSE_S
            while monotonic() < deadline_s and not all(worker.has_stopped() for worker in workers):
                sleep(0.005)
        finally:
            for worker in workers:
                worker.end()

    def _begin_map(self, tasks: Sequence[Any]) -> None:
        self._tasks = tasks
        self._left = deque(range(len(tasks)))
        self._results: dict[int, Any] = {}
        self._losses: Counter[int] = Counter()  # workers that were lost with each task
        self._waited_s = 0.0  # for requests, since silent workers were last looked for

    def _engage(self) -> None:
        """Tell idle workers of the tasks, as long as those that will ask for the first time leave some for others.

        Lost tasks do not wait for a worker that was told of others: it may have been stopped.
        """
        share = max(1, -(-len(self._tasks) // self.num_workers))
        expected = sum(worker.is_expected for worker in self.workers)
        for worker in self.workers:
            if not self._left or (not self._losses and len(self._left) <= expected * share):
                return
            if worker.is_idle:
                worker.is_idle, worker.is_expected, worker.silent_s = False, True, 0.0
                state, worker.state = None if worker.state is self._state else self._state, self._state
                worker.answer(("run", share), state)
                expected += 1

    def serve_requests(self) -> None:
        """Wait for requests and answer them. Replace workers that are gone or have been silent for too long."""
        start_s, tick_s = self.clock(), min(_TICK_S, (self.silence_limit_s or REPORTED_S) / 4)
        ready = self.wait(tick_s)
        # Time in which this process has been stopped, for example by Ctrl-Z together with its workers, does not count.
        self._waited_s += min(self.clock() - start_s, tick_s)
        for worker in ready:
            if worker not in self.workers:  # it has been replaced meanwhile
                continue
            try:
                requests = worker.requests()
            except (EOFError, OSError) as error:
                self._replace(worker, str(error))
            else:
                worker.silent_s, worker.is_reported = 0.0, False
                for request in requests:
                    self._handle(worker, *request)
        if self._waited_s >= tick_s:
            waited_s, self._waited_s = self._waited_s, 0.0
            for worker in [each for each in self.workers if each.is_started and not each.is_idle]:
                worker.silent_s += waited_s
                self._judge_silence(worker)
            self.look_around()

    def _handle(self, worker: RemoteWorker, kind: str, *content: Any) -> None:
        worker.is_ready = True
        if kind == "failed":
            raise self._failure(worker, *content)
        results, *asked = content
        for number, result in results:
            del worker.tasks[number]
            self._results[number] = result
            self._losses_in_a_row = 0
        worker.is_expected = False
        if kind == "want":
            worker.answer(("tasks", self._give(worker, *asked)))
        elif kind == "ready":
            worker.is_idle = True
            self._engage()
        else:
            worker.answer(("noted",))

    def _give(self, worker: RemoteWorker, most: int, least: int) -> list[tuple[int, Any]]:
        """Return the next numbered tasks for a worker; see `TaskSource.take`. There are none for an earlier state."""
        if worker.state is not self._state:
            return []
        count = min(most, max(least, -(-len(self._left) // (2 * self.num_workers))), len(self._left))
        numbers = [self._left.popleft() for _ in range(count)]
        worker.tasks.update(dict.fromkeys(numbers))
        return [(number, self._tasks[number]) for number in numbers]

    def _failure(self, worker: RemoteWorker, error: bytes | None, text: str) -> Exception:
        """Return the error that a worker has raised, with its traceback in the cause."""
        if error is None:
            at_work = "; ".join(map(self._task_text, list(worker.tasks)[:3])) or "nothing yet"
            return WorkerError(f"a worker failed while at work on {at_work}:\n{text}")
        found: Exception = pickle.loads(error)
        found.__cause__ = WorkerError(f"in a worker:\n{text}")
        return found

    def _judge_silence(self, worker: RemoteWorker) -> None:
        """Report a worker that has been silent for long, or replace it."""
        silent_s, limit_s = worker.silent_s, self.silence_limit_s
        if limit_s is not None and silent_s >= limit_s:
            self._replace(worker, f"no answer for {silent_s:.0f} s", is_silent=True)
        elif not worker.is_reported and silent_s >= min(REPORTED_S, (limit_s or 2 * REPORTED_S) / 2):
            worker.is_reported = True
            end = "never replaced" if limit_s is None else f"replaced after {limit_s:g} s"
            self.on_event(f"worker {worker.name} has given no answer for {silent_s:.0f} s; it is {end}")

    def _replace(self, worker: RemoteWorker, fault: str, *, is_silent: bool = False) -> None:
        """Replace a worker that is gone or silent, and hand out its tasks before all others.

        Raise WorkerError if too many workers were lost with the same task, or in a row.
        """
        self._most_workers = max(self._most_workers, len(self.workers))
        self.workers.remove(worker)
        # One that fails to start while others work is started again with the next `map`: its node may lack something.
        counts = worker.is_ready or not any(other.is_ready for other in self.workers)
        self._losses_in_a_row += counts
        how = worker.end()
        ending = f"was ended ({fault})" if is_silent else f"died ({how or fault})"
        lost = list(worker.tasks)
        self._left.extendleft(reversed(lost))
        self._losses.update(lost)
        self.on_event(f"worker {worker.name} {ending}; {len(lost)} tasks are done again")
        poison = next((number for number in lost if self._losses[number] >= MAX_LOSSES), None)
        if poison is not None or self._losses_in_a_row >= MAX_LOSSES * self._most_workers:
            when = "without a result" if poison is None else f"on {self._task_text(poison)}"
            advice = "If a step takes so long, use --backend serial." if is_silent else self.advice
            kept = "Everything up to the last checkpoint is kept."
            raise WorkerError(f"workers keep dying {when}; the last one {ending}. {advice} {kept}")
        if counts:
            self.start_workers()
        self._engage()

    def _task_text(self, number: int) -> str:
        what = shorten(repr(self._tasks[number]), _MOST_LETTERS, placeholder=" ...")
        return f"task {number + 1} of {len(self._tasks)}, {what}"
