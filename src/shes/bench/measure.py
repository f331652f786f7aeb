"""Benchmarks of this machine, relative to MuJoCo alone: `shes bench`."""

from __future__ import annotations

import statistics
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from shes.backends.serial import SerialBackend
from shes.bench.bare_physics import record_generation
from shes.bench.evolution import GenerationReport, Hyperparameters, evolution_strategy, evolve
from shes.bench.random_results import RandomResults
from shes.bench.update_parts import learning_levels, time_parts, timed
from shes.cores import on_one_core
from shes.envs.registry import find_environment
from shes.errors import ConfigError
from shes.es.perturbation import ManyToMany
from shes.runs.build import build_backend, build_task
from shes.runs.checkpoint import Best, Checkpoint, save_checkpoint
from shes.runs.config import TrainConfig

_REPLAY_S = 1.0


def bench_rollout(config: TrainConfig, repeats: int = 5, seconds: float = 0.0) -> dict[str, Any]:
    """Measure the speed of whole generations on the device of `config`, relative to a bare `mj_step` loop on one core.

    Every generation is the first of a run. The bare loop replays the start states and controls of part of it,
    without policy or task: the limit of one core. A replay precedes and follows each generation; speeds are
    medians, and `ratio` is the median of the ratios divided by the number of workers. A single worker runs on the
    core of the loop, because on a shared machine the speeds of two cores may differ by a third. There are at least
    `repeats` generations, for `seconds` or longer.

    Raises:
        ConfigError: The environment has its own physics, or the algorithm is not an evolution strategy.
    """
    if find_environment(config.run.env).has_own_physics:
        raise ConfigError(
            f"bench rollout compares with MuJoCo alone, but {config.run.env} has its own physics. Name one of SHES's "
            "environments, e.g. ant-gather."
        )
    algorithm = evolution_strategy(config)
    plan, settings, state = algorithm.plan(), algorithm.hyperparameters, algorithm.start(config.run.seed)
    table = algorithm.table.on(algorithm.problem.xp)
    physics = record_generation(plan, state, settings, table.size)
    bare: list[float] = []
    whole: list[float] = []
    is_alone = config.workers.device == "cpu" and (config.workers.backend == "serial" or config.workers.count == 1)
    with (
        on_one_core() if is_alone else nullcontext(),
        build_backend(config, plan) as backend,
        ThreadPoolExecutor(backend.num_workers) as pool,
    ):
        next(evolve(state, settings, table, backend, pool))  # builds the environments and warms the caches
        before = physics.steps_per_s(_REPLAY_S)
        start = perf_counter()
        while len(whole) < repeats or perf_counter() - start < seconds:
            report = next(evolve(state, settings, table, backend, pool))
            whole.append(report.num_steps / (report.rollout_s + report.update_s))
            after = physics.steps_per_s(_REPLAY_S)
            bare.append((before + after) / 2)  # the speed of a shared machine drifts
            before = after
        workers = backend.num_workers
    return {
        "env": config.run.env,
        "hidden": list(config.values["hidden"]),
        "integrator": plan.training.integrator,
        "population_size": config.values["population_size"],
        "episodes_per_policy": config.values["episodes_per_policy"],
        "device": config.workers.device,
        "num_workers": workers,
        "generations": len(whole),
        "env_steps_per_s": statistics.median(whole),
        "bare_steps_per_s": statistics.median(bare),
        "ratio": statistics.median(w / b for w, b in zip(whole, bare, strict=True)) / workers,
    }


def bench_update(config: TrainConfig, repeats: int = 20, seconds: float = 0.0) -> dict[str, Any]:
    """Measure the parent's work between generations, in total and by part: medians in milliseconds.

    Results are random; no episode is played. With `--primitive-estimate interval`, `total_ms` and the parts include
    the update from branches. The checkpoint is written in a thread beside the next generation: `checkpoint_ms` is
    not part of `total_ms`. There are at least `repeats` updates, for `seconds` or longer.

    Raises:
        ConfigError: The device is not the CPU, or the algorithm is not an evolution strategy.
    """
    if config.workers.device != "cpu":
        raise ConfigError(
            f"bench update measures the CPU, got device {config.workers.device!r}. Omit --device; the columns "
            "update_s and rollout_s of a run's progress.csv have the times of a device."
        )
    algorithm = evolution_strategy(config)
    table, state = algorithm.table, algorithm.start(config.run.seed)
    settings = replace(algorithm.hyperparameters, perturbation=ManyToMany())  # so that all levels learn in a generation
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


def _state_size(config: TrainConfig, settings: Hyperparameters) -> int:
    """Return the size of a physics state, S; 0 if episodes leave no snapshots."""
    if settings.intervals is None:
        return 0
    task = build_task(config, 1, is_evaluation=False)
    size = task.states(np.array([0])).shape[1]
    task.close()
    return size


def _noise_vectors(report: GenerationReport) -> dict[str, int]:
    """Return the numbers of noise vectors of whole episodes and of branches in a generation."""
    found = {"noise_vectors": 0, "branch_noise_vectors": 0}
    for each in (report.population, report.branches):
        if each is not None:
            found["branch_noise_vectors" if each.is_branched else "noise_vectors"] = len(each.work.signs)
    return found
