"""Measured cost of a generation: the steps of its episodes, their times in lockstep, and the parent's work."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import cycle, islice
from time import perf_counter, process_time

import numpy as np

from shes.algorithms.worker import RolloutWorker
from shes.backends.division import Division
from shes.backends.job import Job
from shes.backends.work import TaskList
from shes.bench.evolution import EvolutionAlgorithm, GenerationReport, Population, generation_work
from shes.bench.lockstep import StepCost
from shes.bench.random_results import RandomResults
from shes.bench.simulation import Costs, GenerationTimes, Network, simulate
from shes.bench.sleepers import Sleep, Sleeper, SleepersBackend
from shes.es.level import TrainState
from shes.hierarchy.episodes import EpisodeTask, Generation
from shes.hierarchy.results import PopulationResults

_ROWS = (1, 2, 3, 5, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 640)
"""Numbers of episodes in lockstep whose steps are timed, if a worker runs so many."""
_PROBES, _PROBE_WORKERS = 1000, 10  # messages and workers by which the parent's work is measured


@dataclass(frozen=True, kw_only=True)
class Stage:
    """The tasks of one `map` call of a generation, with what they cost."""

    tasks: Sequence[EpisodeTask]
    generation: Generation
    sleep: Sleep
    worker: RolloutWorker
    costs: Costs

    @property
    def num_episodes(self) -> int:
        """Number of episodes."""
        return sum(task.num_units for task in self.tasks)

    def simulate(self, num_workers: int, network: Network) -> GenerationTimes:
        """Return the times on `num_workers` workers."""
        rounds = partial(self.worker.rounds, self.generation)
        return simulate(self.tasks, self.sleep.lengths, rounds, self.sleep.cost, self.costs, network, num_workers)

    def sleep_on(self, num_workers: int) -> Sleep:
        """Return what sleeping workers need to know if there are `num_workers`."""
        share = Division([task.num_units for task in self.tasks], num_workers).share
        return replace(self.sleep, rounds={share: self.worker.rounds(self.generation, share)})


def measure_stages(
    algorithm: EvolutionAlgorithm, state: TrainState, report: GenerationReport, update_s: float
) -> list[Stage]:
    """Return the stages of the generation after `state`, whose `report` is given; the update belongs to the last one.

    The draw of the tasks belongs to each, although branches cost less.
    """
    worker = RolloutWorker(algorithm.plan())
    draw_s = _seconds(lambda: generation_work(state, algorithm.hyperparameters, algorithm.table.size))
    stages = []
    for population in report.populations:
        work, is_last = population.work, population is report.populations[-1]
        steps = population.results.steps.ravel()
        cost = measure_steps(worker, population)
        sleep = Sleep(cost=cost, steps=steps, episodes_per_policy=work.generation.episodes_per_policy, rounds={})
        costs = _measure_parent(work.tasks, work.generation, sleep)
        costs = replace(costs, draw_s=costs.draw_s + draw_s, update_s=update_s if is_last else 0.0)
        stages.append(Stage(tasks=work.tasks, generation=work.generation, sleep=sleep, worker=worker, costs=costs))
    return stages


def measure_steps(worker: RolloutWorker, population: Population) -> StepCost:
    """Return the seconds of a step for several numbers of episodes in lockstep, on one core."""
    tasks, generation = population.work.tasks, population.work.generation
    total = sum(task.num_units for task in tasks)
    most, _ = worker.rounds(generation, total)
    rows = sorted({*(number for number in _ROWS if number < most), most})
    worker.receive(generation)
    seconds, saved = [], []
    for number in rows:
        given = Job(tasks, None, 1).give(number, number)
        list(worker.run(TaskList(given[:1]), number))  # creates the environments
        start = perf_counter()
        results = [result for _, result in worker.run(TaskList(given), number)]
        elapsed = perf_counter() - start
        steps = np.concatenate([result.steps for result in results])
        row_s = sum(float(result.seconds[0]) for result in results) / steps.sum()
        saved.append(row_s)
        seconds.append((elapsed + row_s * (steps.max() - steps).sum()) / steps.max())
    return StepCost(rows=np.array(rows), seconds=np.array(seconds), row_s=saved[-1])


def _measure_parent(tasks: Sequence[EpisodeTask], generation: Generation, sleep: Sleep) -> Costs:
    """Return the costs of messages, in seconds of processor time of the parent, and their sizes."""
    singles = [task.part(0, 1) for task in tasks]
    many = list(islice(cycle(singles), _PROBES))
    few = many[:_PROBE_WORKERS]
    at_once = StepCost(rows=np.array([1]), seconds=np.zeros(1), row_s=0.0)

    def seconds_of_many(rows: int) -> tuple[float, float, float]:
        """Return the seconds of `many` tasks, `rows` in each message, of `few`, and of these with a new state."""
        rounds = dict.fromkeys((1, -(-_PROBES // _PROBE_WORKERS)), (rows, rows))
        sleeper = partial(Sleeper, replace(sleep, cost=at_once, rounds=rounds))
        with SleepersBackend(sleeper, _PROBE_WORKERS, per_node=1) as backend:

            def collect(asked: Sequence[EpisodeTask]) -> None:
                results = PopulationResults.of_tasks(tasks, generation)
                for task, result in zip(asked, backend.map(asked), strict=True):
                    results.add(task, result)

            def begin_anew() -> None:
                backend.broadcast(generation)
                collect(few)

            begin_anew()  # until all workers have started
            return _processor_s(lambda: collect(many)), _processor_s(lambda: collect(few)), _processor_s(begin_anew)

    rows = 5
    in_rows, *_ = seconds_of_many(rows)
    one_by_one, alone, anew = seconds_of_many(1)
    # A run of one task is four messages: the worker begins, asks, brings its result with a second question, is done.
    each_s = (one_by_one - alone) / (_PROBES - _PROBE_WORKERS)
    want_s = min(max((one_by_one - in_rows) / _PROBES / (1 - 1 / rows), 0.0), each_s)
    begin_s = (alone / _PROBE_WORKERS - want_s - each_s) / 2
    draw_s = _seconds(lambda: pickle.dumps(generation, pickle.HIGHEST_PROTOCOL))
    results = RandomResults(0)
    results.receive(generation)
    return Costs(
        draw_s=draw_s,
        copy_s=max((anew - alone - draw_s) / _PROBE_WORKERS, 0.0),
        begin_s=max(begin_s, 0.0),
        want_s=want_s,
        result_s=each_s - want_s,
        update_s=0.0,
        state_bytes=len(pickle.dumps(generation, pickle.HIGHEST_PROTOCOL)),
        task_bytes=len(pickle.dumps((0, tasks[0]), pickle.HIGHEST_PROTOCOL)),
        result_bytes=len(pickle.dumps(results.of(tasks[0]), pickle.HIGHEST_PROTOCOL)),
    )


def _processor_s(work: Callable[[], object]) -> float:
    """Return the least processor time of this process in three calls of `work`."""
    times = []
    for _ in range(3):
        start = process_time()
        work()
        times.append(process_time() - start)
    return min(times)


def _seconds(work: Callable[[], object]) -> float:
    """Return the shortest of three durations of `work`."""
    times = []
    for _ in range(3):
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return min(times)
