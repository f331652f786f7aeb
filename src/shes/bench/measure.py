"""How fast SHES is on this machine, as ratios within one run: `shes bench`."""

from __future__ import annotations

import os
import statistics
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from shes.algorithms.evolution.algorithm import GenerationReport, evolve
from shes.algorithms.evolution.learners import EvolutionAlgorithm
from shes.algorithms.evolution.populations import Hyperparameters
from shes.backends.serial import SerialBackend
from shes.bench.bare_physics import record_generation
from shes.bench.random_results import RandomResults
from shes.bench.update_parts import learning_levels, time_parts, timed
from shes.envs.registry import find_environment
from shes.errors import ConfigError
from shes.es.perturbation import ManyToMany
from shes.runs.checkpoint import Best, Checkpoint, save_checkpoint
from shes.runs.config import TrainConfig
from shes.training.build import build_algorithm, build_backend, build_task

__all__ = ["bench_rollout", "bench_update"]

_REPLAY_S = 1.0


def bench_rollout(config: TrainConfig, repeats: int = 5, seconds: float = 0.0) -> dict[str, Any]:
    """Measure whole generations, on the device of `config`, against a bare `mj_step` loop on a core.

    It is the first generation of a run each time. The bare loop replays part of it, whole episodes and branches alike:
    start state and controls, with no policy, task or Python beyond the call, the limit of one core. Each generation
    lies between two replays; speeds are medians, `ratio` is the median of the pairs' ratios, over the number of
    workers. A single worker and the loop share a core: two cores of a machine shared with others may differ by a third
    for minutes.

    Args:
        config: What is measured.
        repeats: Generations at least.
        seconds: Seconds to measure at least: on a machine shared with others a median of many pairs is steadier.

    Raises:
        ConfigError: The environment is an external one, which has no bare loop.
    """
    if find_environment(config.run.env).has_own_physics:
        raise ConfigError(
            f"bench rollout compares with MuJoCo alone, on environments of our own; got {config.run.env}, whose "
            "physics is its own. Name one of `shes envs` with a world of our own, e.g. ant-gather."
        )
    algorithm = _evolution_strategy(config)
    plan, settings, state = algorithm.plan(), algorithm.hyperparameters, algorithm.start(config.run.seed)
    table = algorithm.table.on(algorithm.problem.xp)
    physics = record_generation(plan, state, settings, table.size)
    bare: list[float] = []
    whole: list[float] = []
    is_alone = config.workers.device == "cpu" and (config.workers.backend == "serial" or config.workers.count == 1)
    with (
        _on_one_core() if is_alone else nullcontext(),
        build_backend(config, plan) as backend,
        ThreadPoolExecutor(backend.num_workers) as pool,
    ):
        next(evolve(state, settings, table, backend, pool))  # builds the environments, warms the caches
        before = physics.steps_per_s(_REPLAY_S)
        start = perf_counter()
        while len(whole) < repeats or perf_counter() - start < seconds:
            report = next(evolve(state, settings, table, backend, pool))
            whole.append(report.num_steps / (report.rollout_s + report.update_s))
            after = physics.steps_per_s(_REPLAY_S)
            bare.append((before + after) / 2)  # a machine shared with others drifts: look at it on both sides
            before = after
        workers = backend.num_workers
    return {
        "env": config.run.env,
        "hidden": list(config.networks.hidden),
        "integrator": plan.training.integrator,
        "population_size": config.evolution.population_size,
        "episodes_per_policy": config.evolution.episodes_per_policy,
        "device": config.workers.device,
        "num_workers": workers,
        "generations": len(whole),
        "env_steps_per_s": statistics.median(whole),
        "bare_steps_per_s": statistics.median(bare),
        "ratio": statistics.median(w / b for w, b in zip(whole, bare, strict=True)) / workers,
    }


@contextmanager
def _on_one_core() -> Iterator[None]:
    """Keep this process, and those that it starts meanwhile, on one core, where the system can."""
    if not hasattr(os, "sched_getaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def _evolution_strategy(config: TrainConfig) -> EvolutionAlgorithm:
    """Return the learner of `config`.

    Raises:
        ConfigError: It is no evolution strategy.
    """
    algorithm = build_algorithm(config)
    if not isinstance(algorithm, EvolutionAlgorithm):
        raise ConfigError(
            f"bench measures evolution strategies, got {config.run.algorithm}. Set --algorithm shes or es."
        )
    return algorithm


def bench_update(config: TrainConfig, repeats: int = 20, seconds: float = 0.0) -> dict[str, Any]:
    """Measure, in milliseconds, what the parent does between generations, whole and by part (medians).

    Results are drawn at random, no episode is played. Where the primitive is judged by intervals, `total_ms` and the
    parts have the update from its branches too. `checkpoint_ms` is written by a thread beside the next generation's
    work and is not in `total_ms`.

    Args:
        config: What is measured.
        repeats: Updates at least.
        seconds: Seconds to measure at least.

    Raises:
        ConfigError: A device is asked for.
    """
    _refuse_device(config)
    algorithm = _evolution_strategy(config)
    table, state = algorithm.table, algorithm.start(config.run.seed)
    settings = replace(algorithm.hyperparameters, perturbation=ManyToMany())  # all that learns, in one generation
    backend = SerialBackend(partial(RandomResults, _state_size(config, settings)))
    times: dict[str, list[float]] = defaultdict(list)
    with TemporaryDirectory() as folder, ThreadPoolExecutor(min(config.workers.count, 8)) as pool:
        reports, start = evolve(state, settings, table, backend, pool), perf_counter()
        while True:
            report = next(reports)
            times["total_ms"].append(1000 * report.update_s)
            levels = learning_levels(state, report, table.size)
            time_parts(levels, table, pool, times)
            checkpoint = Checkpoint(arrays=algorithm.to_arrays(report.state), best=Best(), numbers=config.numbers())
            timed(times["checkpoint_ms"], partial(save_checkpoint, Path(folder) / "last.npz", checkpoint))
            state = report.state
            if len(times["total_ms"]) >= repeats and perf_counter() - start >= seconds:
                break
    return {
        "parameters": sum(len(each.level.theta) for each in levels),
        **_noise_vectors(report),
        **{name: statistics.median(values) for name, values in times.items()},
    }


def _refuse_device(config: TrainConfig) -> None:
    """Refuse to measure the update of a run on a device.

    Raises:
        ConfigError: `config` asks for one.
    """
    if config.workers.device != "cpu":
        raise ConfigError(
            f"bench update measures the CPU, got device {config.workers.device!r}. Leave --device away; the columns "
            "update_s and rollout_s of a run's progress.csv tell of a device."
        )


def _state_size(config: TrainConfig, settings: Hyperparameters) -> int:
    """Return the size of a whole physics state, S; 0 where no episode leaves any."""
    if settings.intervals is None:
        return 0
    task = build_task(config, 1, is_evaluation=False)
    size = task.states(np.array([0])).shape[1]
    task.close()
    return size


def _noise_vectors(report: GenerationReport) -> dict[str, int]:
    """Return how many noise vectors whole episodes have in a generation, and how many branches have."""
    found = {"noise_vectors": 0, "branch_noise_vectors": 0}
    for each in (report.population, report.branches):
        if each is not None:
            found["branch_noise_vectors" if each.is_branched else "noise_vectors"] = len(each.work.signs)
    return found
