"""The processes backend: worker processes on this machine. A lost or silent worker is replaced, its work repeated.

`ProcessPoolExecutor` is not used, because it breaks as a whole when one worker is killed, and outlives a killed parent.
Workers are started as a module, so a caller's script needs no `__main__` guard.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import wait
from pathlib import Path
from time import monotonic
from typing import Annotated, Any, ClassVar

import cloudpickle

from shes.backends.backend import Backend, WorkerFactory
from shes.backends.process import WorkerProcess, cause_of_death
from shes.errors import ConfigError, WorkerError
from shes.settings import Execution, Gt, Settings

MAX_LOSSES = 3
"""The run ends when this many workers died on one task, or as many per worker in a row without a result."""
_TOLD_AT, _REPLACED_AT = 2, 10
"""A worker is told of, and replaced, only if its silence is this many times the longest that ended with a result."""
_PATIENCE = 4
"""Factor of the limit after each loss of the same task, or each loss in a row: maybe the work just takes long."""
_TICK_S = 1.0


@dataclass(frozen=True, kw_only=True)
class ProcessesSettings(Settings):
    """Limits for workers that give no answer."""

    worker_warning_s: Annotated[float, Gt(0), Execution()] | None = 60.0
    """Seconds without an answer after which a warning names the worker; none for no warning. Long tasks get longer."""
    worker_timeout_s: Annotated[float, Gt(0), Execution()] | None = 600.0
    """Seconds without an answer after which a worker (stopped, swapped out) is replaced; none for never. If tasks take
    long, ten times the longest so far."""


class _Run:
    """State of one `map` call."""

    def __init__(self, tasks: Sequence[Any], share: int) -> None:
        self.tasks = tasks
        self.share = share
        self.queue: deque[int] = deque(range(len(tasks)))
        self.results: dict[int, Any] = {}
        self.losses: Counter[int] = Counter()


class ProcessesBackend(Backend):
    """Worker processes on this machine, each with one thread."""

    Options: ClassVar[type[Settings]] = ProcessesSettings

    def __init__(
        self,
        factory: WorkerFactory,
        num_workers: int,
        *,
        worker_warning_s: float | None = None,
        worker_timeout_s: float | None = None,
    ) -> None:
        """Start `num_workers` processes. Each creates its worker by `factory`, which cloudpickle pickles."""
        self.num_workers = num_workers
        self.worker_warning_s, self.worker_timeout_s = worker_warning_s, worker_timeout_s
        limits = [limit for limit in (worker_warning_s, worker_timeout_s) if limit is not None]
        self._tick_s = max(0.01, min([_TICK_S, *(limit / 4 for limit in limits)]))
        self._longest_s = 0.0  # of the silences that ended with a result
        self._factory = _pickle_factory(factory)
        self._import_path = os.pathsep.join(_import_path())
        self._state: bytes | None = None
        self._deaths_in_a_row = 0
        self._processes: list[WorkerProcess] = []
        self._start_missing()

    def broadcast(self, state: Any) -> None:
        """Send `state` to every worker, and later to the replacements of lost ones."""
        self._state = pickle.dumps(state, pickle.HIGHEST_PROTOCOL)
        for process in self._processes:
            process.send("state", self._state)
        self._start_missing()

    def map(self, tasks: Sequence[Any]) -> Iterator[Any]:
        """Yield the result of every task, in order."""
        run = _Run(tasks, share=max(1, -(-len(tasks) // self.num_workers)))
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
            while any(process.is_running for process in self._processes):
                self._serve(run)
            is_finished = True
        finally:
            if not is_finished:  # a worker raised, or the caller stopped iterating: nobody needs the remaining results
                self.close()

    def close(self) -> None:
        """End every worker process."""
        processes, self._processes = self._processes, []
        for process in processes:
            process.popen.kill()
        for process in processes:
            process.end()

    def pids(self) -> list[int]:
        """Return the process ids of the workers."""
        return [process.popen.pid for process in self._processes]

    def _start_missing(self) -> None:
        """Start the processes that are missing, and send them the state."""
        try:
            while len(self._processes) < self.num_workers:
                process = WorkerProcess(self._factory, self._import_path, self.worker_timeout_s)
                self._processes.append(process)
                if self._state is not None:
                    process.send("state", self._state)
        except OSError as error:
            self.close()
            raise WorkerError(
                f"not all of the {self.num_workers} worker processes could be started: {error.strerror or error}. "
                "Lower --workers, or raise the limit on processes and open files (ulimit)."
            ) from error

    def _start_run(self, run: _Run) -> None:
        """Let the processes that have no work request tasks."""
        for process in self._processes:
            if not process.is_running:
                process.is_running, process.silent_s = True, 0.0
                process.send("run", run.share)

    def _serve(self, run: _Run) -> None:
        """Wait for messages and answer them. Replace workers that have died or given no answer for too long."""
        connections = {process.connection: process for process in self._processes}
        start = monotonic()
        ready = wait(list(connections), self._tick_s)
        # Time in which this process has been stopped, for example by Ctrl-Z together with its workers, does not count.
        waited_s = min(monotonic() - start, self._tick_s)
        for process in connections.values():
            process.silent_s += waited_s
        for connection in ready:
            process = connections[connection]  # type: ignore[index] - wait returns what it was given
            try:
                message = process.connection.recv()
            except BlockingIOError:  # it was stopped while it sent a message
                process.silent_s += self.worker_timeout_s or 0.0
                self._replace(process, run, is_silent=True)
            except (EOFError, OSError):
                self._replace(process, run)
            else:
                self._answer(process, message, run)
                self._end_silence(process)
        for process in list(self._processes):
            if process.is_running:
                self._judge_silence(process, run)

    def _end_silence(self, process: WorkerProcess) -> None:
        """Note that the process has sent a message."""
        if process.is_told:
            self._tell(f"worker {process.popen.pid} answers again, after {process.silent_s:.0f} s")
        process.silent_s, process.is_told = 0.0, False

    def _judge_silence(self, process: WorkerProcess, run: _Run) -> None:
        """Tell of a process that has been silent for long, or replace it."""
        losses = max(self._deaths_in_a_row, *(run.losses[number] for number in process.tasks), 0)
        limit_s = max(self.worker_timeout_s or 0.0, _REPLACED_AT * self._longest_s) * _PATIENCE ** min(
            losses, MAX_LOSSES - 1
        )
        if self.worker_timeout_s is not None and process.silent_s >= limit_s:
            self._replace(process, run, is_silent=True)
        elif (
            self.worker_warning_s is not None
            and not process.is_told
            and process.silent_s >= max(self.worker_warning_s, _TOLD_AT * self._longest_s)
        ):
            process.is_told = True
            end = "never replaced" if self.worker_timeout_s is None else f"replaced after {limit_s:.0f} s"
            self._tell(
                f"worker {process.popen.pid} has given no answer for {process.silent_s:.0f} s; it is {end} "
                "(--worker-timeout-s)"
            )

    def _answer(self, process: WorkerProcess, message: tuple[Any, ...], run: _Run) -> None:
        kind, *content = message
        if kind == "want":
            if run.queue:
                number = run.queue.popleft()
                process.tasks[number] = None
                process.send("task", number, pickle.dumps(run.tasks[number], pickle.HIGHEST_PROTOCOL))
            else:
                process.send("end")
        elif kind == "result":
            number, result = content
            process.tasks.pop(number)
            run.results[number] = result
            self._deaths_in_a_row = 0
            self._longest_s = max(self._longest_s, process.silent_s)
        elif kind == "done":
            process.is_running = False
        elif kind == "refused":
            raise content[0]
        elif kind == "failed":
            at_work = ", ".join(repr(run.tasks[number]) for number in list(process.tasks)[:3])
            raise WorkerError(f"a worker failed while at work on {at_work or 'nothing yet'}:\n{content[0]}")

    def _replace(self, process: WorkerProcess, run: _Run, *, is_silent: bool = False) -> None:
        """Replace a worker that died or is silent, and put its tasks back at the front of the queue."""
        self._processes.remove(process)
        process.end()
        lost = list(process.tasks)
        run.queue.extendleft(reversed(lost))
        run.losses.update(lost)
        self._deaths_in_a_row += 1
        code, silence = process.popen.returncode, f"no answer for {process.silent_s:.0f} s"
        end = f"was ended ({silence})" if is_silent else f"died (exit code {code})"
        self._tell(f"worker {process.popen.pid} {end}; {len(lost)} tasks are done again")
        worst = max(run.losses.values(), default=0)
        if worst >= MAX_LOSSES or self._deaths_in_a_row >= MAX_LOSSES * self.num_workers:
            fault = f"giving {silence}" if is_silent else f"dying ({cause_of_death(code)})"
            advice = "If its work takes so long, raise --worker-timeout-s." if is_silent else _advice(code)
            raise WorkerError(
                f"workers keep {fault} {f'on the same task, {worst} times' if worst else 'at once'}. "
                f"{advice} Everything up to the last checkpoint is kept."
            )
        self._start_missing()
        self._start_run(run)

    def _tell(self, event: str) -> None:
        if self.on_event is not None:
            self.on_event(event)


def _pickle_factory(factory: WorkerFactory) -> bytes:
    """Return `factory` pickled. Classes defined in the caller's script are pickled by value.

    Raises:
        ConfigError: An object that it refers to cannot be pickled.
    """
    try:
        return cloudpickle.dumps(factory)
    except Exception as error:
        raise ConfigError(
            f"the work cannot be sent to worker processes: {error}. Move what your own class refers to into a module "
            "beside your script, which workers import, or set --backend serial."
        ) from error


def _import_path() -> list[str]:
    """Return the import path of this process, on which workers find the modules of the caller's classes.

    Workers import these modules rather than receive them by value, so that the modules' own imports work as well.
    """
    path = [entry for entry in sys.path if entry]
    # An empty entry is the working directory: of a notebook, of `python -c`. Workers search it last, so that no file
    # there replaces a module of the standard library. It is resolved now, because it may change later.
    if len(path) < len(sys.path):
        with suppress(FileNotFoundError):
            path.append(str(Path.cwd()))
    return path


def _advice(code: int | None) -> str:
    """Return advice to the user about a process that ended with this exit code."""
    if code == -signal.SIGKILL:
        return "Usually memory ran out: lower --workers or --chunk-size."
    return "It may have printed the reason above; --backend serial does the same work in this process."
