"""The construction of a run's parts from its settings, and the checks that they fit this machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from shes.agents.agent import AgentDesign
from shes.algorithms.contract import Algorithm, Problem
from shes.backends.backend import Backend
from shes.backends.named_backends import BACKENDS
from shes.envs.external_task import ExternalEnvironment
from shes.envs.named_environments import EnvironmentMaker, find_environment
from shes.envs.tasks.task import SimulatorFactory, TaskOptions
from shes.errors import ConfigError
from shes.es.noise import DEFAULT_TABLE_SIZE
from shes.machine import free_memory
from shes.rollout.episodes import empty_outcomes
from shes.rollout.worker import RolloutWorker, WorkerPlan, lanes_that_fit
from shes.runs.checkpoint import restore
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder
from shes.settings import setting_fields
from shes.sim.simulator import CpuSimulator
from shes.sim.warp import WarpSimulator
from shes.sim.warp_device import is_out_of_memory

EVALUATION_RESET_NOISE = 0.1
"""Reset noise of evaluation episodes, whatever that of training is; see `TaskOptions.reset_noise`."""
_WORKER_BYTES = 45_000_000  # that a worker process shares with no other: 36 to 42 MB measured
_ROW_BYTES = 10_000  # of a simulation, its task and its agent, without noise: up to 8.6 kB measured
_TASK_BYTES = 400  # of a task in the parent process, per episode: 200 to 400 measured


def build_environment(config: TrainConfig) -> EnvironmentMaker:
    """Return the environment of `config`."""
    return find_environment(config.run.env).with_options(config.values)


def build_options(config: TrainConfig, *, is_evaluation: bool) -> TaskOptions:
    """Return the options of the environment for training or evaluation."""
    noise = EVALUATION_RESET_NOISE if is_evaluation else config.environment.reset_noise
    return replace(config.environment, reset_noise=noise, evaluation=is_evaluation)


def build_algorithm(config: TrainConfig) -> Algorithm[Any]:
    """Return the algorithm of `config`; raise ShesError if it cannot learn in this environment with these settings."""
    workers = config.workers
    problem = Problem(
        name=config.run.env,
        env=build_environment(config),
        training=build_options(config, is_evaluation=False),
        evaluation=build_options(config, is_evaluation=True),
        horizon=config.episodes.horizon,
        evaluation_horizon=config.evaluation_steps,
        settings=config,
        noise_table_size=config.values.get("noise_table_size", DEFAULT_TABLE_SIZE),
        num_threads=workers.count,
        chunk_size=workers.chunk_size,
        device=workers.device,
        simulator=_simulator(config),
    )
    return cast("Callable[[Problem], Algorithm[Any]]", config.algorithm)(problem)  # as `register_algorithm` checks


def _simulator(config: TrainConfig) -> SimulatorFactory:
    options = {name: config.values[name] for name in ("device", "nconmax", "njmax", "deterministic")}
    return CpuSimulator if config.workers.device == "cpu" else partial(WarpSimulator, **options)


@dataclass(frozen=True, kw_only=True)
class OpenedRun:
    """A run with the state of its algorithm in a checkpoint."""

    folder: RunFolder
    config: TrainConfig
    algorithm: Algorithm[Any]
    state: Any


def open_run(run: Path | str, checkpoint: str = "best", **execution: Any) -> OpenedRun:
    """Read a checkpoint of a run, with `execution` settings in place of its own; for the rest see `load`."""
    folder = RunFolder.open(run)
    config = folder.read_config().having(**execution)
    algorithm = build_algorithm(config)
    loaded = folder.load(checkpoint)
    state = restore(loaded, algorithm.from_arrays, folder.checkpoint_path(checkpoint))
    return OpenedRun(folder=folder, config=config, algorithm=algorithm, state=state)


def build_backend(config: TrainConfig, plan: WorkerPlan, max_workers: int | None = None) -> Backend:
    """Return the started backend of a run, with at most `max_workers`. A device has one worker, in this process."""
    cls: Any = BACKENDS.find(config.workers.backend if config.workers.device == "cpu" else "serial")
    options = cls.Options.of(config.values)
    count = config.workers.num_workers or cls.all_workers()
    count = count if max_workers is None else min(count, max_workers)
    own = {name: getattr(options, name) for name in setting_fields(cls.Options)}
    return cls(partial(RolloutWorker, plan), count, **own)


def check_device(config: TrainConfig) -> None:
    """Check that the device of `config` exists and can simulate its world."""
    workers = config.workers
    if workers.device == "cpu":
        return
    try:
        build_environment(config).make(1, build_options(config, is_evaluation=False), _simulator(config)).close()
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        raise ConfigError(
            f"device {workers.device} has too little memory for a single episode ({error}). Find out what else "
            "uses it, lower --nconmax or --njmax, or use --device cpu."
        ) from error


def most_episodes(config: TrainConfig, *, is_evaluation: bool = False) -> int:
    """Return the largest number of episodes at a time, and so of workers, of a run, or of an evaluation alone."""
    policies, episodes = config.algorithm.population(config)
    return max(0 if is_evaluation else policies * episodes, config.evaluation.evaluation_episodes)


def check_limits(config: TrainConfig, design: AgentDesign, *, is_evaluation: bool = False) -> None:
    """Raise ConfigError unless the arrays and processes of a run, or of an evaluation alone, fit the memory."""
    has_processes = config.workers.device == "cpu" and config.workers.backend == "processes"
    workers = config.workers.count if has_processes else 0
    need, free = _memory(config, design, workers, is_evaluation=is_evaluation), free_memory()
    if need > free:
        sizes = "--episodes" if is_evaluation else "--population-size, --evaluation-episodes, --horizon, --hidden"
        raise ConfigError(
            f"this takes {need / 1e9:,.1f} GB of memory, but {free / 1e9:,.1f} GB are free. Lower --chunk-size or "
            f"--workers, which change no result, or {sizes}; or use a larger machine."
        )


def _memory(config: TrainConfig, design: AgentDesign, workers: int, *, is_evaluation: bool) -> int:
    """Return the bytes of memory that agents of `design` take, in this process and in `workers` others."""
    policies, rows = config.algorithm.population(config)
    at_a_time = most_episodes(config, is_evaluation=is_evaluation)
    workers = min(workers, at_a_time)
    env = build_environment(config)
    instance_bytes = env.measured_bytes() if isinstance(env, ExternalEnvironment) else None

    def rollout(policies: int, horizon: int) -> int:
        """Return the bytes of a worker's arrays for its share of `policies`, in lockstep, with exploration noise."""
        share = -(-policies // max(1, workers))
        fitting = lanes_that_fit(sum(design.dims), rows, are_external=instance_bytes is not None)
        lanes = min(share, config.workers.chunk_size or fitting)
        decisions = -(-horizon // design.controller_interval)
        noise = 4 * (horizon * design.policies[-1].sizes[-1] + decisions * design.decision_size)
        return lanes * (8 * sum(design.dims) + rows * (_ROW_BYTES + noise + (instance_bytes or 0)))

    rollouts = rollout(0 if is_evaluation else policies, config.episodes.horizon)
    rollouts += rollout(-(-config.evaluation.evaluation_episodes // rows), config.evaluation_steps)
    parent = at_a_time * (empty_outcomes(len(design.dims), 1).nbytes + _TASK_BYTES)
    return parent + (workers * (_WORKER_BYTES + rollouts) if workers else rollouts)
