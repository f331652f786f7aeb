"""The construction of a run's parts from its settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from shes.algorithms.contract import Algorithm
from shes.algorithms.problem import Problem
from shes.backends.backend import Backend
from shes.backends.named_backends import BACKENDS
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.named_environments import Environment, EnvironmentMaker, find_environment
from shes.envs.tasks.task_options import TaskOptions
from shes.errors import ConfigError
from shes.es.noise import DEFAULT_TABLE_SIZE
from shes.rollout.worker import RolloutWorker, WorkerPlan, simulator_factory
from shes.runs.checkpoint import restore
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder
from shes.runs.run_settings import algorithm_of
from shes.settings import setting_fields
from shes.sim.warp_device import is_out_of_memory

EVALUATION_RESET_NOISE = 0.1
"""Reset noise of evaluation episodes, whatever that of training is; see `TaskOptions.reset_noise`."""


def build_environment(config: TrainConfig) -> EnvironmentMaker:
    """Return the environment of `config`."""
    env = find_environment(config.run.env)
    return env.with_body_options(config.body) if isinstance(env, Environment) and "body" in config else env


def build_options(config: TrainConfig, *, is_evaluation: bool) -> TaskOptions:
    """Return the options of the environment for training or evaluation."""
    noise = EVALUATION_RESET_NOISE if is_evaluation else config.environment.reset_noise
    return replace(config.environment, reset_noise=noise, evaluation=is_evaluation)


def build_task(config: TrainConfig, num_episodes: int, *, is_evaluation: bool) -> EpisodeBatch:
    """Return a batch of `num_episodes` episodes of the environment of `config`."""
    env = build_environment(config)
    return env.make(num_episodes, build_options(config, is_evaluation=is_evaluation))


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
        nconmax=workers.nconmax,
        njmax=workers.njmax,
    )
    construct = cast("Callable[[Problem], Algorithm[Any]]", algorithm_of(config.run))  # as `register_algorithm` checks
    return construct(problem)


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
    loaded = folder.load(checkpoint, algorithm.check_headers)
    state = restore(loaded, algorithm.from_arrays, folder.checkpoint_path(checkpoint))
    return OpenedRun(folder=folder, config=config, algorithm=algorithm, state=state)


def check_device(config: TrainConfig) -> None:
    """Check that the device of `config` exists and can simulate its world.

    Raises:
        MissingExtraError: It needs a package that is not installed.
        ConfigError: There is no such GPU or driver, the world needs the CPU, or there is no memory for one episode.
    """
    workers = config.workers
    if workers.device == "cpu":
        return
    env = build_environment(config)
    simulator = simulator_factory(workers.device, workers.nconmax, workers.njmax)
    try:
        env.make(1, build_options(config, is_evaluation=False), simulator).close()
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        raise ConfigError(
            f"device {workers.device} has too little memory for a single episode ({error}). Find out what else "
            "uses it, lower --nconmax or --njmax, or use --device cpu."
        ) from error


def build_backend(config: TrainConfig, plan: WorkerPlan, max_workers: int | None = None) -> Backend:
    """Return the started backend of `config`, with at most `max_workers` workers.

    A device has one worker, in this process.
    """
    factory = partial(RolloutWorker, plan)
    cls: Any = BACKENDS.find(config.workers.backend if config.workers.device == "cpu" else "serial")
    options = cls.Options.of(config.values)
    count = config.workers.num_workers or cls.all_workers()
    count = count if max_workers is None else min(count, max_workers)
    return cls(factory, count, **{name: getattr(options, name) for name in setting_fields(cls.Options)})
