"""Workers that sleep for as long as measured episodes take, and exchange real messages with the real parent.

`python -m shes.bench.sleepers LIFELINE PARENT FD ...` is a node of them, with one in a thread for every socket:
hundreds of processes that import MuJoCo would not fit into the memory of a small machine. As in a cluster, the state is
sent once to a node.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from threading import Event, Thread
from typing import ClassVar

import numpy as np

from shes.backends.backend import WorkerFactory
from shes.backends.job import State
from shes.backends.process import SocketWorker
from shes.backends.process_worker import die_with_parent
from shes.backends.processes import ProcessesBackend
from shes.backends.remote_worker import RemoteWorker
from shes.backends.serving import ONE_THREAD, serve
from shes.backends.work import TaskSource
from shes.bench.lockstep import Lockstep, StepCost
from shes.bench.random_results import RandomResults
from shes.errors import WorkerError
from shes.hierarchy.episodes import EpisodeResults, EpisodeTask, Generation
from shes.types import IntArray


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

    _results: ClassVar = RandomResults(0)
    _has_state: ClassVar = Event()

    def __init__(self, sleep: Sleep) -> None:
        self._sleep = sleep

    def receive(self, state: Generation | None) -> None:
        """Store the generation for all workers of the node; None if another worker of the node receives it."""
        if state is not None:
            self._results.receive(state)
            self._has_state.set()

    def run(self, work: TaskSource, share: int) -> Iterator[tuple[int, EpisodeResults]]:
        """Sleep for the tasks of `work`, and yield numbered results."""
        self._has_state.wait()
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
    """The processes backend with sleeping workers, in threads of a few processes, which stand for nodes."""

    def __init__(self, factory: WorkerFactory, num_workers: int, *, per_node: int) -> None:
        """Start `num_workers` workers, `per_node` in each process."""
        self._per_node = per_node
        self._nodes: list[subprocess.Popen[bytes]] = []
        self._sockets: list[tuple[socket.socket, bool]] = []
        self._first_of_nodes: set[RemoteWorker] = set()
        self._pipe: list[int] = []  # of which only this process holds the end for writing: the nodes' lifeline
        super().__init__(factory, num_workers)

    def close(self) -> None:
        """End every worker and every node."""
        super().close()
        for node in self._nodes:
            node.kill()
            node.wait()
        self._nodes.clear()
        self._first_of_nodes.clear()
        while self._pipe:
            os.close(self._pipe.pop())

    def start_missing(self) -> None:
        """Start the nodes before the first workers."""
        if not self._nodes:
            self._pipe = list(os.pipe())
            firsts = range(0, self.num_workers, self._per_node)
            self._sockets = [own for first in firsts for own in self._start_node(first)]
        super().start_missing()

    def start_worker(self) -> SocketWorker:
        """Connect to the next worker of the nodes; raise WorkerError if one is to be replaced."""
        if not self._sockets:
            raise WorkerError("a process of sleeping workers died; none is replaced. Measure again.")
        own, is_first = self._sockets.pop(0)
        worker = SocketWorker(own, self._factory, None)
        if is_first:
            self._first_of_nodes.add(worker)
        return worker

    def send_state(self, worker: RemoteWorker, state: State) -> None:
        """Send `state` to the first worker of each node."""
        if worker in self._first_of_nodes:
            super().send_state(worker, state)
        else:
            worker.note_state(state)
            worker.send("state", state.number, pickle.dumps(None))

    def _start_node(self, first: int) -> list[tuple[socket.socket, bool]]:
        """Start the node of the workers from `first` on; return their sockets, and whether it is its first one."""
        pairs = [socket.socketpair() for _ in range(min(self._per_node, self.num_workers - first))]
        numbers = [theirs.fileno() for _, theirs in pairs]
        lifeline = self._pipe[0]
        arguments = map(str, (lifeline, os.getpid(), *numbers))
        command = [sys.executable, "-P", "-m", "shes.bench.sleepers", *arguments]
        environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": self._import_path}
        # The node inherits the mask: a Ctrl-C in a terminal reaches it even before it can ignore it.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            node = subprocess.Popen(command, pass_fds=(lifeline, *numbers), env=environment, stdin=subprocess.DEVNULL)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        self._nodes.append(node)
        for _, theirs in pairs:
            theirs.close()
        return [(own, i == 0) for i, (own, _) in enumerate(pairs)]


def _serve(descriptor: int) -> None:
    with Connection(descriptor) as connection:
        serve(connection, connection.recv_bytes())


def main() -> None:
    """Serve as a worker for each socket given on the command line, and die with the parent."""
    lifeline, parent, *descriptors = map(int, sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group: the parent decides
    die_with_parent(lifeline, parent)
    threads = [Thread(target=_serve, args=(descriptor,)) for descriptor in descriptors]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


if __name__ == "__main__":
    main()
