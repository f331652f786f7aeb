"""Speed-up of a generation by more cores: measured here, projected to a cluster. Source: SHES paper, Figure 6.

`python benchmarks/speedup.py --workers 2 --out speedup.csv`, on an idle machine: SHES and S-ES on Ant Gather at the
paper's size, 40 minutes on two cores; `--policies 200` takes a fifth of it. Every row is written
at once. What the projection to n cores assumes:

- Episodes are those of the measured generation. Every worker runs an equal share of them, at once if the caches allow.
- A core of the cluster runs a share as fast as a core here does alone: neighbours cost it no memory bandwidth.
- The slowest of all workers takes as long as the slowest of a few shares that are run here, and nobody waits for
  another: each worker asks for its share once, without the division of the last tasks that backends do.
- The main process handles one message after another, each in the processor time that it takes here for a result.
- The policies are sent once to each node of 24 cores, from node to node along a tree. A message takes 50 µs, and its
  bytes at 10 Gbit/s.
- The update takes as long as here. Tables, checkpoints and evaluations are not part of a generation.

Measured speed-ups are relative to the mean speed of the first and the last core, each measured alone; projected ones to
the first core, on which the shares run. `measured` and `projected` rows of the same number of cores show how good the
projection is.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from functools import partial
from math import ceil, log2
from pathlib import Path
from statistics import harmonic_mean
from time import perf_counter, process_time
from typing import Any

from shes.backends.backend import Backend, SerialBackend
from shes.cli.bench import evolution_strategy
from shes.errors import ConfigError
from shes.evolution.algorithm import GenerationReport, evolve
from shes.evolution.estimates import Draws
from shes.evolution.state import TrainState
from shes.evolution.strategies import EvolutionAlgorithm
from shes.machine import core_numbers, on_one_core
from shes.rollout.episodes import EpisodeTask
from shes.rollout.roll_out import roll_out_tasks
from shes.rollout.worker import RolloutWorker
from shes.runs.build import build_backend
from shes.runs.config import TrainConfig
from shes.runs.make_config import make_config
from shes.runs.tables import csv_text

CORES = (24, 48, 96, 120, 240, 360, 480, 600, 1000)
"""Numbers of cores of a projection; the paper's are 48, 240 and 600."""
SAMPLES = 5
"""Shares of a generation that are run for each number of cores."""
LATENCY_S, BYTES_PER_S, CORES_PER_NODE = 50e-6, 10e9 / 8, 24

Row = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """A generation on some workers."""

    report: GenerationReport
    message_s: float
    """Processor time of the main process for each result."""

    @property
    def seconds(self) -> tuple[float, float]:
        """Seconds of the rollouts and of the update."""
        return self.report.rollout_s, self.report.update_s


def measure_speedup(
    config: TrainConfig, workers: Sequence[int] = (1, 2), cores: Sequence[int] = CORES, samples: int = SAMPLES
) -> Iterator[Row]:
    """Yield times of a generation of `config` measured on numbers of `workers`, projected ones, and speed-ups."""
    if config.workers.device != "cpu":
        raise ConfigError(f"speedup.py measures the CPU, got device {config.workers.device!r}. Omit --device.")
    algorithm, here = evolution_strategy(config), core_numbers()[: max(workers)]
    alone = [measure(config, algorithm, 1, core) for core in sorted({here[0], here[-1]})]
    mean_rollout_s, mean_update_s = (harmonic_mean(each) for each in zip(*(one.seconds for one in alone), strict=True))
    mean_s = mean_rollout_s + mean_update_s
    yield from (row("alone", 1, *one.seconds, mean_s) for one in alone)
    yield row("measured", 1, mean_rollout_s, mean_update_s, mean_s)
    last, several = alone[0], sorted({*workers} - {1})
    for n in several:
        last = measure(config, algorithm, n)
        yield row("measured", n, *last.seconds, mean_s)
    update_s, base_s = last.report.update_s, sum(alone[0].seconds)
    with on_one_core(core_numbers()[0]), SerialBackend(partial(RolloutWorker, algorithm.plan())) as worker:
        for n in (*several, *cores):
            stages = last.report.populations
            spent = draw_s(algorithm) + sum(rollout_s(worker, work, n, last.message_s, samples) for work in stages)
            yield row("projected", n, spent, update_s, base_s)


def row(kind: str, cores: int, rollout_s: float, update_s: float, one_core_s: float) -> Row:
    """Return a row of the table; `one_core_s` is the time of a generation on one core."""
    speedup = one_core_s / (rollout_s + update_s)
    times = {"generation_s": rollout_s + update_s, "rollout_s": rollout_s, "update_s": update_s}
    return {"kind": kind, "cores": cores, **times, "speedup": speedup, "efficiency": speedup / cores}


def measure(
    config: TrainConfig, algorithm: EvolutionAlgorithm, num_workers: int, core: int | None = None
) -> Measurement:
    """Return the first generation on `num_workers` workers, which stay on `core` if it is given."""
    config, costs, state = config.having(num_workers=num_workers), list[float](), algorithm.start(config.run.seed)
    with ExitStack() as stack:
        with nullcontext() if core is None else on_one_core(core):
            backend = stack.enter_context(build_backend(config, algorithm.plan()))
        pool = stack.enter_context(ThreadPoolExecutor(min(num_workers, 8)))
        work = first_draws(algorithm, state)
        warm_up = [task.part(0, 1) for task in work.tasks[:num_workers]]
        roll_out_tasks(warm_up, work.generation, backend)  # until all workers have started
        backend.map = metered(backend.map, costs)  # type: ignore[method-assign]
        report = next(evolve(state, algorithm.hyperparameters, algorithm.table, backend, pool))
    return Measurement(report=report, message_s=costs[0])


def metered(run: Callable[..., Iterator[Any]], costs: list[float]) -> Callable[..., Iterator[Any]]:
    """Return the `map` of a backend; it appends the processor time of this process for each result to `costs`."""

    def metered_map(tasks: Sequence[EpisodeTask]) -> Iterator[Any]:
        start = process_time()
        yield from run(tasks)
        costs.append((process_time() - start) / len(tasks))

    return metered_map


def first_draws(algorithm: EvolutionAlgorithm, state: TrainState) -> Draws:
    """Return the first population of the generation that follows `state`."""
    settings = algorithm.hyperparameters
    return settings.estimates[0](state, settings, algorithm.table.size, ())


def draw_s(algorithm: EvolutionAlgorithm) -> float:
    """Return the seconds in which the main process draws the tasks of a generation."""
    start = perf_counter()
    first_draws(algorithm, algorithm.start(0))
    return perf_counter() - start


def rollout_s(worker: Backend, work: Draws, num_workers: int, message_s: float, samples: int) -> float:
    """Return the projected seconds of the rollouts of `work` on `num_workers` cores; `worker` runs shares of it."""
    num_episodes = sum(len(task.slots) for task in work.tasks)
    size = ceil(num_episodes / num_workers)
    num_shares = ceil(num_episodes / size)
    starts = sorted({size * (i * num_shares // samples) for i in range(samples)})
    roll_out_tasks(share(work.tasks, 0, size), work.generation, worker)  # creates the environments
    times = []
    for first in starts:
        begin = perf_counter()
        roll_out_tasks(share(work.tasks, first, size), work.generation, worker)
        times.append(perf_counter() - begin)
    state_bytes = len(pickle.dumps(work.generation, pickle.HIGHEST_PROTOCOL))
    num_results = max(len(work.tasks), num_shares)  # a share of less than a task has a result of its own
    return project(max(times), num_results, message_s, state_bytes, num_workers)


def share(tasks: Sequence[EpisodeTask], first: int, size: int) -> list[EpisodeTask]:
    """Return tasks of `size` successive episodes of `tasks`, from episode `first` on; fewer at the end."""
    found, start = list[EpisodeTask](), 0
    for task in tasks:
        low, high = max(first - start, 0), min(first + size - start, len(task.slots))
        if low < high:
            found.append(task.part(low, high))
        start += len(task.slots)
    return found


def project(share_s: float, num_results: int, message_s: float, state_bytes: int, num_workers: int) -> float:
    """Return the seconds of rollouts whose slowest worker needs `share_s`, by the assumptions above."""
    nodes = ceil(num_workers / CORES_PER_NODE)
    broadcast_s = ceil(log2(nodes + 1)) * (LATENCY_S + state_bytes / BYTES_PER_S)
    asking_s = 2 * LATENCY_S + num_workers * message_s  # until the last worker has its share
    return broadcast_s + max(asking_s + share_s, num_results * message_s) + LATENCY_S + message_s


def main() -> None:
    """Measure, project, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="CSV file for the table")
    parser.add_argument("--env", default="ant-gather")
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--integrator", default="euler")
    parser.add_argument("--algorithms", nargs="+", choices=("shes", "es"), default=("shes", "es"))
    parser.add_argument("--policies", type=int, help="population size; default: the preset's")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="numbers of workers measured")
    parser.add_argument("--cores", type=int, nargs="+", default=CORES, help="numbers of cores of the projection")
    asked = parser.parse_args()
    rows: list[Row] = []
    for algorithm in asked.algorithms:
        own: dict[str, Any] = {"algorithm": algorithm, "integrator": asked.integrator}
        if asked.policies:
            own["population_size"] = asked.policies
        config = make_config(asked.env, asked.preset, own)
        for each in measure_speedup(config, asked.workers, asked.cores):
            words = f"{algorithm}, {each['cores']} cores {each['kind']}"
            print(f"{words:30} {each['generation_s']:9.2f} s, speed-up {each['speedup']:6.1f}", flush=True)
            rows.append({"env": asked.env, "algorithm": algorithm, **each})
            if asked.out:
                asked.out.write_text(csv_text([list(rows[0]), *(list(each.values()) for each in rows)]))


if __name__ == "__main__":
    main()
