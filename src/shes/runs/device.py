"""The checks that a run fits this machine: settings of its device, number of workers, memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shes.agents.agent import AgentDesign
from shes.envs.external_task import ExternalEnvironment
from shes.envs.named_environments import find_environment
from shes.errors import ConfigError
from shes.machine import free_memory, num_cores
from shes.rollout.episodes import empty_outcomes
from shes.rollout.worker import lanes_that_fit
from shes.runs.config import TrainConfig

_WORKER_BYTES = 45_000_000  # that a worker process shares with no other: 36 to 42 MB measured
_ROW_BYTES = 10_000  # of a simulation, its task and its agent, without noise: up to 8.6 kB measured
_TASK_BYTES = 400  # of a task in the parent process, per episode: 200 to 400 measured


def check_asked_device(config: TrainConfig, asked: Mapping[str, Any]) -> None:
    """Raise ConfigError if a setting in `asked` has no effect on the device of `config`.

    Other settings of `config` may be left from another device, for a run that returns to it.
    """
    device = config.workers.device
    if device == "cpu":
        for name in ("nconmax", "njmax"):
            if asked.get(name) is not None:
                raise ConfigError(
                    f"{name} is {asked[name]!r}, but the CPU's physics has no fixed buffers. "
                    f"Set --device, or omit --{name}."
                )
        return
    backend, workers = asked.get("backend", "serial"), asked.get("num_workers", 0)
    for name, value, is_idle in (("backend", backend, backend != "serial"), ("num_workers", workers, workers > 1)):
        if is_idle:
            raise ConfigError(
                f"{name} is {value!r}, but one process serves device {device}. "
                f"Omit {config.setting(name).flag}, or set --device cpu."
            )


def max_workers() -> int:
    """Return the largest number of worker processes that are started on this machine."""
    return max(64, 16 * num_cores())


def most_episodes(config: TrainConfig, *, is_evaluation: bool = False) -> int:
    """Return the largest number of episodes at a time of a run, or of an evaluation alone.

    More workers than that would be idle.
    """
    policies, episodes = config.algorithm.population(config)
    return max(0 if is_evaluation else policies * episodes, config.evaluation.evaluation_episodes)


def check_limits(config: TrainConfig, design: AgentDesign, *, is_evaluation: bool = False) -> None:
    """Raise ConfigError unless the arrays and processes of a run, or of an evaluation alone, fit this machine."""
    workers = _num_processes(config)
    if workers > max_workers():
        raise ConfigError(
            f"num_workers is {workers:,}, but this machine has {num_cores()} cores: more than {max_workers()} worker "
            f"processes are not started. Set --workers {max_workers()} or less; 0 is one for every core."
        )
    need, free = _memory(config, design, is_evaluation=is_evaluation), free_memory()
    if need > free:
        sizes = "--episodes" if is_evaluation else "--population-size, --evaluation-episodes, --horizon, --hidden"
        raise ConfigError(
            f"this takes {need / 1e9:,.1f} GB of memory, but {free / 1e9:,.1f} GB are free. Lower --chunk-size or "
            f"--workers, which change no result, or {sizes}; or use a larger machine."
        )


def _num_processes(config: TrainConfig) -> int:
    """Return the number of worker processes on this machine; 0 if this process, or a device, does the work."""
    has_processes = config.workers.device == "cpu" and config.workers.backend == "processes"
    return config.workers.count if has_processes else 0


def _memory(config: TrainConfig, design: AgentDesign, *, is_evaluation: bool) -> int:
    """Return the bytes of memory that agents of `design` take, in all processes."""
    policies, rows = config.algorithm.population(config)
    at_a_time = most_episodes(config, is_evaluation=is_evaluation)
    workers = min(_num_processes(config), at_a_time)
    env = find_environment(config.run.env)
    instance_bytes = env.measured_bytes() if isinstance(env, ExternalEnvironment) else None

    def rollout(policies: int, horizon: int) -> int:
        """Return the bytes of a worker's arrays for its share of `policies`, in lockstep, with exploration noise."""
        share = -(-policies // max(1, workers))
        fitting = lanes_that_fit(sum(design.dims), rows, are_external=instance_bytes is not None)
        lanes = min(share, config.workers.chunk_size or fitting)
        decisions = -(-horizon // design.controller_interval)
        noise = 4 * (horizon * design.policies[-1].sizes[-1] + decisions * design.decision_size)
        return lanes * (8 * sum(design.dims) + rows * (_ROW_BYTES + noise + (instance_bytes or 0)))

    blocks = -(-config.evaluation.evaluation_episodes // rows)
    rollouts = rollout(0 if is_evaluation else policies, config.episodes.horizon)
    rollouts += rollout(blocks, config.evaluation_steps)
    parent = at_a_time * (empty_outcomes(len(design.dims), 1).nbytes + _TASK_BYTES)
    return parent + (workers * (_WORKER_BYTES + rollouts) if workers else rollouts)
