"""The processes backend: worker processes on this machine. A lost worker is replaced and its work repeated.

`ProcessPoolExecutor` is not used, because it breaks as a whole when one worker is killed, and outlives a killed parent.
Workers are started as a module, so a caller's script needs no `__main__` guard.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import cloudpickle

from shes.backends.backend import Backend, WorkerFactory
from shes.errors import ConfigError, WorkerError

__all__ = ["ProcessesBackend"]

MAX_LOSSES = 3
"""The run ends when this many workers died on one task, or as many per worker in a row without a result."""
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)


class _Process:
    """A worker process and the tasks it is working on."""

    def __init__(self, factory: bytes, import_path: str) -> None:
        ours, theirs = socket.socketpair()
        read_end, self._lifeline = os.pipe()
        # -P: a file in the working directory must not replace a module of the standard library.
        module = [sys.executable, "-P", "-m", "shes.backends.process_worker"]
        arguments = [str(theirs.fileno()), str(read_end), str(os.getpid())]
        # The worker inherits the mask: a Ctrl-C in a terminal reaches it even before it can ignore it.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self.popen = subprocess.Popen(
                [*module, *arguments],
                pass_fds=(theirs.fileno(), read_end),
                env={**os.environ, **_ONE_THREAD, "PYTHONPATH": import_path},
                stdin=subprocess.DEVNULL,
            )
        except OSError:
            ours.close()
            os.close(self._lifeline)
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            theirs.close()
            os.close(read_end)
        self.connection = Connection(ours.detach())
        self.tasks: dict[int, None] = {}  # numbers of the tasks at work, in the order they were given
        self.is_running = False
        with suppress(OSError):  # the next read notices that the process is gone
            self.connection.send_bytes(factory)

    def end(self) -> None:
        """End the process immediately."""
        self.popen.kill()
        self.connection.close()
        os.close(self._lifeline)
        self.popen.wait()


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

    def __init__(self, factory: WorkerFactory, num_workers: int) -> None:
        """Start `num_workers` processes. Each creates its worker by `factory`, which cloudpickle pickles."""
        self.num_workers = num_workers
        self._factory = _pickle_factory(factory)
        self._import_path = os.pathsep.join(_import_path())
        self._state: bytes | None = None
        self._events: list[str] = []
        self._deaths_in_a_row = 0
        self._processes: list[_Process] = []
        self._start_missing()

    def broadcast(self, state: Any) -> None:
        """Send `state` to every worker, and later to the replacements of lost ones."""
        self._state = _pickle(state)
        self._start_missing()
        for process in list(self._processes):
            self._send(process, "state", self._state)

    def map(self, tasks: Sequence[Any]) -> Iterator[Any]:
        """Yield the result of every task, in order."""
        run = _Run(tasks, share=max(1, -(-len(tasks) // self.num_workers)))
        is_finished = False
        try:
            self._start_missing()
            for process in self._processes:
                self._start_run(process, run)
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

    def take_events(self) -> list[str]:
        """Return messages about workers that were lost and replaced since the last call."""
        events, self._events = self._events, []
        return events

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
        try:
            while len(self._processes) < self.num_workers:
                self._processes.append(_Process(self._factory, self._import_path))
        except OSError as error:
            self.close()
            raise WorkerError(
                f"not all of the {self.num_workers} worker processes could be started: {error.strerror or error}. "
                "Lower --workers, or raise the limit on processes and open files (ulimit)."
            ) from error

    def _start_run(self, process: _Process, run: _Run) -> None:
        process.is_running = True
        self._send(process, "run", run.share)

    def _serve(self, run: _Run) -> None:
        """Wait for messages and answer them."""
        connections = {process.connection: process for process in self._processes}
        for connection in wait(list(connections)):
            process = connections[connection]  # type: ignore[index] - wait returns what it was given
            try:
                message = process.connection.recv()
            except (EOFError, OSError):
                self._replace(process, run)
            else:
                self._answer(process, message, run)

    def _answer(self, process: _Process, message: tuple[Any, ...], run: _Run) -> None:
        kind, *content = message
        if kind == "want":
            if run.queue:
                number = run.queue.popleft()
                process.tasks[number] = None
                self._send(process, "task", number, _pickle(run.tasks[number]))
            else:
                self._send(process, "end")
        elif kind == "result":
            number, result = content
            process.tasks.pop(number)
            run.results[number] = result
            self._deaths_in_a_row = 0
        elif kind == "done":
            process.is_running = False
        elif kind == "refused":
            raise content[0]
        elif kind == "failed":
            at_work = ", ".join(repr(run.tasks[number]) for number in list(process.tasks)[:3])
            raise WorkerError(f"a worker failed while at work on {at_work or 'nothing yet'}:\n{content[0]}")

    def _replace(self, process: _Process, run: _Run) -> None:
        """Replace a worker that died, and put its tasks back at the front of the queue."""
        self._processes.remove(process)
        process.end()
        lost = list(process.tasks)
        run.queue.extendleft(reversed(lost))
        run.losses.update(lost)
        self._deaths_in_a_row += 1
        code = process.popen.returncode
        self._events.append(f"worker {process.popen.pid} died (exit code {code}); {len(lost)} tasks are done again")
        worst = max(run.losses.values(), default=0)
        if worst >= MAX_LOSSES or self._deaths_in_a_row >= MAX_LOSSES * self.num_workers:
            raise WorkerError(
                f"workers keep dying ({_cause(code)}) {f'on the same task, {worst} times' if worst else 'at once'}. "
                f"{_advice(code)} Everything up to the last checkpoint is kept."
            )
        replacement = _Process(self._factory, self._import_path)
        self._processes.append(replacement)
        if self._state is not None:
            self._send(replacement, "state", self._state)
        for idle in self._processes:
            if not idle.is_running:
                self._start_run(idle, run)

    @staticmethod
    def _send(process: _Process, *message: Any) -> None:
        """Send a message. If the worker is gone, the next read notices it."""
        with suppress(OSError):
            process.connection.send(message)


def _pickle(value: Any) -> bytes:
    return pickle.dumps(value, protocol=pickle.HIGHEST_PROTOCOL)


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


def _cause(code: int) -> str:
    """Return in words how a process with this exit code ended."""
    if code >= 0:
        return f"exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return f"killed by {name}, exit code {code}"


def _advice(code: int) -> str:
    """Return advice to the user about a process that ended with this exit code."""
    if code == -signal.SIGKILL:
        return "Usually memory ran out: lower --workers or --chunk-size."
    return "It may have printed the reason above; --backend serial does the same work in this process."
