"""How fast SHES is on this machine, as ratios within one run: `shes bench`."""

from __future__ import annotations

import os
import statistics
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import mujoco
import numpy as np

from shes.algorithms.evolution.algorithm import evolve, generation_work
from shes.algorithms.evolution.worker import WorkerPlan
from shes.envs.registry import find_environment, make_task
from shes.envs.tasks.task import FRAME_SKIP, Task
from shes.errors import ConfigError
from shes.es.gradient import group_weights, weighted_noise_sum
from shes.es.level import LevelState, draw_noise_index, update_level
from shes.es.perturbation import ManyToMany
from shes.hierarchy.rollout import Rollout
from shes.runs.checkpoint import Best, Checkpoint, save_checkpoint
from shes.runs.config import TrainConfig
from shes.runs.device import array_module
from shes.training.build import (
    build_backend,
    build_design,
    build_plan,
    build_settings,
    build_state,
    open_noise_table,
)
from shes.types import F64Array, FloatArray, IntArray

__all__ = ["bench_rollout", "bench_update"]

_REPLAY_S = 1.0
_REPLAYED = 24  # episodes of the generation that the bare loop replays

Episode = tuple[F64Array, F64Array, list[F64Array]]
"""Start qpos, start qvel, and the controls of every step."""


def bench_rollout(config: TrainConfig, repeats: int = 5, seconds: float = 0.0) -> dict[str, Any]:
    """Measure whole generations, on the device of `config`, against a bare `mj_step` loop on a core.

    The bare loop replays episodes of the same generation, start state and controls, with no policy, task or Python
    beyond the call: the limit of one core. Each generation lies between two replays; speeds are medians, `ratio` is
    the median of the pairs' ratios, over the number of workers. A single worker and the loop share a core: two cores of
    a machine shared with others may differ by a third for minutes.

    Args:
        config: What is measured.
        repeats: Generations at least.
        seconds: Seconds to measure at least: on a machine shared with others a median of many pairs is steadier.

    Raises:
        ConfigError: The environment is an external one, which has no bare loop.
    """
    if find_environment(config.env).has_own_physics:
        raise ConfigError(
            f"bench rollout compares with MuJoCo alone, on environments of our own; got {config.env}, whose "
            "physics is its own. Name one of `shes envs` with a world of our own, e.g. ant-gather."
        )
    design = build_design(config)
    table = open_noise_table(config, design).on(array_module(config.device))
    plan = build_plan(config, design, table)
    episodes = _record_episodes(config, plan)
    bare: list[float] = []
    whole: list[float] = []
    is_alone = config.device == "cpu" and (config.backend == "serial" or config.workers == 1)
    with (
        _on_one_core() if is_alone else nullcontext(),
        build_backend(config, plan) as backend,
        ThreadPoolExecutor(backend.num_workers) as pool,
    ):
        settings, state = build_settings(config), build_state(config, design)
        next(evolve(state, settings, table, backend, pool))  # builds the environments, warms the caches
        before = _replay(episodes)
        start = perf_counter()
        while len(whole) < repeats or perf_counter() - start < seconds:
            report = next(evolve(state, settings, table, backend, pool))
            whole.append(report.num_steps / (report.rollout_s + report.update_s))
            after = _replay(episodes)
            bare.append((before + after) / 2)  # a machine shared with others drifts: look at it on both sides
            before = after
        workers = backend.num_workers
    return {
        "env": config.env,
        "hidden": list(config.hidden),
        "integrator": plan.training.integrator,
        "population_size": config.population_size,
        "episodes_per_policy": config.episodes_per_policy,
        "device": config.device,
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


class _Recorder:
    """Stands before a task's reset and step and keeps what they are given."""

    def __init__(self, task: Task) -> None:
        self.model = task.sim.model
        self.episodes: list[Episode] = []
        self._running: dict[int, Episode] = {}
        self._task, self._reset, self._step = task, task.reset, task.step
        task.reset, task.step = self.reset, self.step  # type: ignore[method-assign]

    def reset(self, ids: IntArray, seeds: Any, states: Any = ()) -> None:
        self._reset(ids, seeds, states)
        for i in ids.tolist():
            self._running[i] = (self._task.sim.qpos[i].copy(), self._task.sim.qvel[i].copy(), [])
            self.episodes.append(self._running[i])

    def step(self, ids: IntArray, action: FloatArray) -> None:
        for i in ids.tolist():
            self._running[i][2].append(action[i].astype(np.float64))
        self._step(ids, action)


def _record_episodes(config: TrainConfig, plan: WorkerPlan) -> tuple[mujoco.MjModel, list[Episode]]:
    """Return the model and the first episodes of the first generation."""
    state, settings = build_state(config, plan.design), build_settings(config)
    table = open_noise_table(config, plan.design)
    work = generation_work(state, settings, table.size)
    tasks, generation = work.tasks, work.generation
    lanes, rows = max(1, _REPLAYED // generation.rows), generation.rows
    task = make_task(config.env, lanes * rows, plan.training)
    recorder = _Recorder(task)
    horizon = generation.branch_steps or config.horizon
    rollout = Rollout(plan.design, lambda _: task, lanes, rows, horizon, generation.members_per_lane)
    for _ in rollout.run(iter(enumerate(tasks[:lanes])), generation, table):
        pass
    return recorder.model, recorder.episodes


def _replay(recorded: tuple[mujoco.MjModel, list[Episode]]) -> float:
    """Return the control steps per second of `mj_step` alone on recorded episodes, for a second or more."""
    model, episodes = recorded
    data = mujoco.MjData(model)
    steps = 0
    start = perf_counter()
    while (elapsed := perf_counter() - start) < _REPLAY_S or not steps:
        for qpos, qvel, controls in episodes:
            mujoco.mj_resetData(model, data)
            data.qpos[:], data.qvel[:] = qpos, qvel
            for control in controls:
                data.ctrl[:] = control
                mujoco.mj_step(model, data, nstep=FRAME_SKIP)
            steps += len(controls)
    return steps / elapsed


def bench_update(config: TrainConfig, repeats: int = 20, seconds: float = 0.0) -> dict[str, Any]:
    """Measure, in milliseconds, what the parent does between generations, whole and by part (medians).

    `checkpoint_ms` is written by a thread beside the next generation's work and is not in `total_ms`.

    Args:
        config: What is measured.
        repeats: Updates at least.
        seconds: Seconds to measure at least.

    Raises:
        ConfigError: A device is asked for.
    """
    if config.device != "cpu":
        raise ConfigError(
            f"bench update measures the CPU, got device {config.device!r}. Leave --device away; the columns update_s "
            "and rollout_s of a run's progress.csv tell of a device."
        )
    design = build_design(config)
    table = open_noise_table(config, design)
    state = build_state(config, design)
    settings = replace(build_settings(config), perturbation=ManyToMany())  # all that learns, in one generation
    signs = settings.perturbation.signs(0, settings.population_size, settings.mirrored, settings.learns)
    learning = [i for i, learns in enumerate(settings.learns) if learns]
    dims = tuple(design.dims[i] for i in learning)
    rng = np.random.default_rng(0)
    fitness = rng.standard_normal((len(learning), config.population_size))
    times: dict[str, list[float]] = {}

    def timed(name: str, work: Callable[[], Any]) -> Any:
        start = perf_counter()
        result = work()
        times.setdefault(name, []).append(1000 * (perf_counter() - start))
        return result

    with TemporaryDirectory() as folder, ThreadPoolExecutor(min(config.workers, 8)) as pool:
        start = perf_counter()
        for generation in count():
            if generation >= repeats and perf_counter() - start >= seconds:
                break
            index = draw_noise_index(0, generation, len(signs), dims, table.size)  # other slices every time

            def whole(index: IntArray = index) -> tuple[LevelState, ...]:
                levels = list(state.levels)
                for k, i in enumerate(learning):
                    rule, statistics = settings.updates[i], levels[i].statistics
                    shaped = rule.shaping(fitness[k])
                    update = update_level(
                        levels[i], shaped, signs[:, :, i], index[k], table, rule, config.learning_rate, pool
                    )
                    merged = statistics.merge(1, statistics.total, statistics.total)
                    levels[i] = replace(update.level, statistics=merged)
                return tuple(levels)

            levels = timed("total_ms", whole)
            index = draw_noise_index(1, generation, len(signs), dims, table.size)
            shaped = timed("rank_ms", lambda: [settings.updates[0].shaping(row) for row in fitness])
            weights = [group_weights(row, signs[:, :, i]) for row, i in zip(shaped, learning, strict=True)]
            gradients = timed(
                "gradient_ms",
                lambda index=index, weights=weights: [
                    weighted_noise_sum(table, index[k], weights[k], dim, pool) for k, dim in enumerate(dims)
                ],
            )
            timed(
                "optimizer_ms",
                lambda gradients=gradients: [
                    settings.updates[i].optimizer.step(gradient, state.levels[i].optimizer, config.learning_rate)
                    for gradient, i in zip(gradients, learning, strict=True)
                ],
            )
            checkpoint = Checkpoint(state=replace(state, levels=levels), best=Best(), numbers=config.numbers())
            timed("checkpoint_ms", partial(save_checkpoint, Path(folder) / "last.npz", checkpoint))
    return {
        "parameters": sum(dims),
        "noise_vectors": len(signs),
        **{name: statistics.median(values) for name, values in times.items()},
    }
