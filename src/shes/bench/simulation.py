"""A generation on any number of workers, in simulated time: the backends' own division of tasks, and measured costs.

A parent process answers one message after the other. Messages take the time of the network. Workers run episodes in
lockstep (`shes.bench.lockstep`).
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from itertools import count
from math import ceil, log2
from typing import Any

from shes.backends.job import Job
from shes.backends.serving import KEPT_S
from shes.bench.lockstep import Lockstep, StepCost


@dataclass(frozen=True, kw_only=True)
class Network:
    """The connections between the parent and its workers."""

    latency_s: float
    bytes_per_s: float
    cores_per_node: int = 24
    """Cores that share one copy of the state, which travels from node to node; 0 if the parent sends one to each."""

    def broadcast_s(self, size: int, num_workers: int) -> float:
        """Return how long `size` bytes take to all workers, from node to node along a tree."""
        if not self.cores_per_node:
            return self.latency_s
        nodes = ceil(num_workers / self.cores_per_node)
        return ceil(log2(nodes + 1)) * (self.latency_s + size / self.bytes_per_s)

    def message_s(self, size: int) -> float:
        """Return how long a message of `size` bytes takes."""
        return self.latency_s + size / self.bytes_per_s


@dataclass(frozen=True, kw_only=True)
class Costs:
    """Measured costs of a generation other than its episodes."""

    draw_s: float
    """Seconds in which the parent draws the tasks and pickles the state."""
    copy_s: float
    """Seconds in which the parent sends a copy of the state."""
    begin_s: float
    """Seconds in which the parent tells a worker to begin, and as much again when it notes that the worker is done."""
    want_s: float
    """Seconds in which the parent answers a request for tasks."""
    result_s: float
    """Seconds in which the parent gives a task and stores its result."""
    update_s: float
    """Seconds from the last result to the next generation."""
    state_bytes: int
    task_bytes: int
    result_bytes: int


@dataclass(frozen=True, kw_only=True)
class GenerationTimes:
    """Seconds of a generation, or of a part of it."""

    start_s: float
    """Until the last worker has its first tasks; NaN if not measured."""
    rollout_s: float
    """Until the last result, the start included."""
    update_s: float
    busy_s: float
    """Seconds of episodes, summed over workers."""

    def __add__(self, other: GenerationTimes) -> GenerationTimes:
        """Return the times of one part after the other."""
        return GenerationTimes(
            **{each.name: getattr(self, each.name) + getattr(other, each.name) for each in fields(self)}
        )


def simulate(
    tasks: Sequence[Any],
    lengths: Callable[[Any], Sequence[int]],
    rounds: Callable[[int], tuple[int, int]],
    cost: StepCost,
    costs: Costs,
    network: Network,
    num_workers: int,
) -> GenerationTimes:
    """Return the times of a generation.

    Args:
        tasks: Its tasks, as the parent gives them to its backend.
        lengths: Returns the steps of each episode of a task or part.
        rounds: Returns how many episodes of a share run in lockstep, and how many suffice; see `RolloutWorker.rounds`.
        cost: Seconds of a step.
        costs: Everything else.
        network: The connections.
        num_workers: Number of workers.
    """
    return _Simulation(Job(tasks, None, num_workers), lengths, costs, network).run(cost, rounds, num_workers)


@dataclass(kw_only=True)
class _Worker:
    lockstep: Lockstep
    is_expected: bool = True
    is_over: bool = False
    kept: list[int] = field(default_factory=list)
    """Numbers of the results that go with its next message."""
    sent_s: float = 0.0
    """When it sent its last message."""


class _Simulation:
    """The events of one generation. The parent handles messages in the order in which they arrive."""

    def __init__(self, job: Job, lengths: Callable[[Any], Sequence[int]], costs: Costs, network: Network) -> None:
        self._job, self._lengths, self._costs, self._network = job, lengths, costs, network
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._order = count()  # of events at the same time
        self._parent_s = costs.draw_s  # until when the parent is busy
        self._start_s = self._end_s = self._busy_s = 0.0
        self._enough = 1

    def run(self, cost: StepCost, rounds: Callable[[int], tuple[int, int]], num_workers: int) -> GenerationTimes:
        """Return the times of the generation on `num_workers` workers."""
        division = self._job.division
        rows, self._enough = rounds(division.share)
        state_s = self._network.broadcast_s(self._costs.state_bytes, num_workers)
        begin_s = self._costs.begin_s + (0.0 if self._network.cores_per_node else self._costs.copy_s)
        for _ in range(num_workers):
            if division.wants_worker:
                division.expect()
                begun_s = self._handle(0.0, begin_s)
                self._ask(_Worker(lockstep=Lockstep(cost=cost, rows=rows)), begun_s + state_s)
        while self._events:
            time_s, _, event = heapq.heappop(self._events)
            event(time_s)
        return GenerationTimes(
            start_s=self._start_s, rollout_s=self._end_s, update_s=self._costs.update_s, busy_s=self._busy_s
        )

    def _at(self, time_s: float, event: Callable[[float], None]) -> None:
        heapq.heappush(self._events, (time_s, next(self._order), event))

    def _handle(self, time_s: float, seconds: float) -> float:
        """Return when the parent has handled a message that arrives at `time_s`."""
        self._parent_s = max(self._parent_s, time_s) + seconds
        return self._parent_s

    def _send(self, worker: _Worker, time_s: float, then: Callable[[float], None] | None = None) -> None:
        """Send the results that a worker keeps; at their arrival `then` follows, by default nothing."""
        kept, worker.kept, worker.sent_s = worker.kept, [], time_s
        size = len(kept) * self._costs.result_bytes

        def arrive(arrived_s: float) -> None:
            if kept:
                self._end_s = self._handle(arrived_s, len(kept) * self._costs.result_s)
            for number in kept:
                self._job.add(number, None)
            if then is not None:
                then(arrived_s)

        self._at(time_s + self._network.message_s(size), arrive)

    def _ask(self, worker: _Worker, time_s: float) -> None:
        """Send a request for tasks at `time_s`."""
        self._send(worker, time_s, partial(self._answer, worker))

    def _answer(self, worker: _Worker, time_s: float) -> None:
        done_s = self._handle(time_s, self._costs.want_s)
        room = worker.lockstep.room
        given = self._job.give(room, min(room, self._enough))
        received_s = done_s + self._network.message_s(len(given) * self._costs.task_bytes)
        if worker.is_expected:
            worker.is_expected = False
            self._job.division.meet()
            self._start_s = max(self._start_s, received_s)
        self._at(received_s, partial(self._begin, worker, given))

    def _begin(self, worker: _Worker, given: Sequence[tuple[int, Any]], time_s: float) -> None:
        worker.is_over = not given
        for number, task in given:
            worker.lockstep.add(number, self._lengths(task))
        self._advance(worker, time_s)

    def _advance(self, worker: _Worker, time_s: float) -> None:
        if worker.lockstep.is_idle:
            self._send(worker, time_s, self._end)
            return
        seconds, finished = worker.lockstep.advance()
        self._busy_s += seconds
        self._at(time_s + seconds, partial(self._finish, worker, finished))

    def _finish(self, worker: _Worker, finished: Sequence[int], time_s: float) -> None:
        worker.kept += finished
        if worker.lockstep.room and not worker.is_over:
            self._ask(worker, time_s)
            return
        if worker.kept and time_s >= worker.sent_s + KEPT_S:
            self._send(worker, time_s)
        self._advance(worker, time_s)

    def _end(self, time_s: float) -> None:
        """Note that a worker is done."""
        self._end_s = self._handle(time_s, self._costs.begin_s)
