"""Workers that sleep for as long as measured episodes take, and exchange real messages with the real parent.

`python -m shes.bench.sleepers FD ...` hosts one in a thread for every socket: hundreds of processes that import MuJoCo
would not fit into the memory of a small machine.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from threading import Thread

import numpy as np

from shes.backends.backend import WorkerFactory
from shes.backends.process import SocketWorker
from shes.backends.processes import ProcessesBackend
from shes.backends.serving import ONE_THREAD, serve
from shes.backends.work import TaskSource
from shes.bench.lockstep import Lockstep, StepCost
from shes.bench.random_results import RandomResults
from shes.hierarchy.episodes import EpisodeResults, EpisodeTask, Generation
from shes.types import IntArray

_THREADS = 50  # of a host process


@dataclass(frozen=True, kw_only=True)
class Sleep:
    """How long tasks take: the measured times of a generation."""

    cost: StepCost
    steps: IntArray
    """Steps of every episode, in the order of the members."""
    episodes_per_policy: int
    rounds: dict[int, tuple[int, int]]
    """How many episodes run in lockstep, and how many suffice, for a share."""

    def lengths(self, task: EpisodeTask) -> list[int]:
        """Return the steps of each episode of a task."""
        return self.steps[task.member * self.episodes_per_policy + np.array(task.slots)].tolist()


class Sleeper:
    """A `Worker` that sleeps instead of running episodes, and returns random results of the real size."""

    def __init__(self, sleep: Sleep) -> None:
        self._sleep = sleep
        self._results = RandomResults(0)
        self._generation: Generation | None = None

    def receive(self, state: Generation) -> None:
        """Keep the generation of the next tasks."""
        self._generation = state
        self._results.receive(state)

    def run(self, work: TaskSource, share: int) -> Iterator[tuple[int, EpisodeResults]]:
        """Sleep for the tasks of `work`, and yield numbered results."""
        rows, enough = self._sleep.rounds.get(share, (share, share))
        lockstep, tasks = Lockstep(cost=self._sleep.cost, rows=rows), dict[int, EpisodeTask]()
        is_over, due = False, time.monotonic()
        while True:
            if (room := lockstep.room) and not is_over:
                taken = work.take(room, min(room, enough))
                is_over = not taken
                for number, task in taken:
                    tasks[number] = task
                    lockstep.add(number, self._sleep.lengths(task))
                due = time.monotonic()
            if lockstep.is_idle:
                return
            seconds, finished = lockstep.advance()
            due += seconds
            time.sleep(max(0.0, due - time.monotonic()))
            for number in finished:
                yield number, self._results.of(tasks.pop(number))


class SleepersBackend(ProcessesBackend):
    """The processes backend with sleeping workers, in threads of a few processes."""

    def __init__(self, factory: WorkerFactory, num_workers: int) -> None:
        self._hosts: list[subprocess.Popen[bytes]] = []
        self._sockets: list[socket.socket] = []
        super().__init__(factory, num_workers)

    def close(self) -> None:
        """End every worker and every host."""
        super().close()
        for host in self._hosts:
            host.kill()
            host.wait()
        self._hosts.clear()

    def start_missing(self) -> None:
        """Start the hosts before the first workers."""
        if not self._hosts:
            self._sockets = [own for first in range(0, self.num_workers, _THREADS) for own in self._start_host(first)]
        super().start_missing()

    def start_worker(self) -> SocketWorker:
        """Connect to the next worker of the hosts."""
        return SocketWorker(self._sockets.pop(), self._factory, None)

    def _start_host(self, first: int) -> list[socket.socket]:
        """Start the host of the workers from `first` on; return their sockets."""
        pairs = [socket.socketpair() for _ in range(min(_THREADS, self.num_workers - first))]
        numbers = [theirs.fileno() for _, theirs in pairs]
        command = [sys.executable, "-P", "-m", "shes.bench.sleepers", *map(str, numbers)]
        environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": self._import_path}
        self._hosts.append(subprocess.Popen(command, pass_fds=numbers, env=environment, stdin=subprocess.DEVNULL))
        for _, theirs in pairs:
            theirs.close()
        return [own for own, _ in pairs]


def _serve(descriptor: int) -> None:
    with Connection(descriptor) as connection:
        serve(connection, connection.recv_bytes())


def main() -> None:
    """Host a worker for each socket given on the command line."""
    threads = [Thread(target=_serve, args=(int(word),)) for word in sys.argv[1:]]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


if __name__ == "__main__":
    main()
