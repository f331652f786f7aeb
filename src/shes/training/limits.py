"""The limits of this machine: what a run will allocate is compared with the free memory before anything is made."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from shes.algorithms.worker import lanes_that_fit
from shes.cores import num_cores
from shes.envs.external.environment import ExternalEnvironment
from shes.envs.registry import find_environment
from shes.errors import ConfigError
from shes.free_space import free_memory
from shes.hierarchy.agent import AgentDesign
from shes.hierarchy.episodes import empty_outcomes
from shes.runs.config import TrainConfig
from shes.settings import flag

_WORKER_BYTES = 45_000_000  # that a worker process shares with no other: 36 to 42 MB measured
_ROW_BYTES = 10_000  # of a simulation, its task and its agent, without noise: up to 8.6 kB measured
_MOST = 2**62  # larger than any value that fits
_TASK_BYTES = 400  # of a task in the parent process, per episode: 200 to 400 measured


def max_workers() -> int:
    """Return the largest number of worker processes that are started on this machine."""
    return max(64, 16 * num_cores())


@dataclass(frozen=True, kw_only=True)
class Workload:
    """The numbers that decide how much memory a run, or an evaluation, takes."""

    population_size: int
    """Policies in a generation; see `Algorithm.population`."""
    episodes_per_policy: int
    """Largest number of episodes of a policy."""
    horizon: int
    evaluation_episodes: int
    evaluation_horizon: int
    chunk_size: int
    num_workers: int
    """Worker processes on this machine; 0 if the work is done in this one, or on a device."""
    instance_bytes: int | None = None
    """Bytes of an instance of an external environment, one for every episode in lockstep; None for other ones."""

    @classmethod
    def of(cls, config: TrainConfig, *, is_evaluation: bool = False) -> Workload:
        """Return the workload of a run with the settings of `config`, or of an evaluation alone."""
        policies, episodes = config.algorithm.population(config)
        env = find_environment(config.run.env)
        has_processes = config.workers.device == "cpu" and config.workers.backend == "processes"
        return cls(
            population_size=0 if is_evaluation else policies,
            episodes_per_policy=episodes,
            horizon=config.episodes.horizon,
            evaluation_episodes=config.evaluation.evaluation_episodes,
            evaluation_horizon=config.evaluation_steps,
            chunk_size=config.workers.chunk_size,
            num_workers=config.workers.count if has_processes else 0,
            instance_bytes=env.measured_bytes() if isinstance(env, ExternalEnvironment) else None,
        )

    @property
    def most_episodes(self) -> int:
        """Largest number of episodes at a time. More workers than that would be idle."""
        return max(self.population_size * self.episodes_per_policy, self.evaluation_episodes)

    def memory(self, design: AgentDesign) -> int:
        """Return the bytes of memory that agents of `design` take, in all processes."""
        parent = self.most_episodes * (empty_outcomes(len(design.dims), 1).nbytes + _TASK_BYTES)
        blocks = -(-self.evaluation_episodes // self.episodes_per_policy)
        rollouts = self._rollout(design, self.population_size, self.horizon)
        rollouts += self._rollout(design, blocks, self.evaluation_horizon)
        workers = min(self.num_workers, self.most_episodes)
        return parent + (workers * (_WORKER_BYTES + rollouts) if workers else rollouts)

    def _rollout(self, design: AgentDesign, policies: int, horizon: int) -> int:
        """Return the bytes of a worker's arrays for its share of `policies`, in lockstep, with exploration noise."""
        rows = self.episodes_per_policy
        share = -(-policies // max(1, self.num_workers))
        are_external = self.instance_bytes is not None
        lanes = min(share, self.chunk_size or lanes_that_fit(sum(design.dims), rows, are_external=are_external))
        decisions = -(-horizon // design.controller_interval)
        noise = 4 * (horizon * design.policies[-1].sizes[-1] + decisions * design.decision_size)
        return lanes * (8 * sum(design.dims) + rows * (_ROW_BYTES + noise + (self.instance_bytes or 0)))


_SIZES = ("population_size", "episodes_per_policy", "evaluation_episodes", "horizon", "evaluation_horizon")


def check_limits(workload: Workload, design: AgentDesign, names: Mapping[str, str] = MappingProxyType({})) -> None:
    """Raise ConfigError, with the largest value that fits, unless the arrays and processes of a run fit this machine.

    `names` are other names that the user gives some of the settings.
    """
    if workload.num_workers > max_workers():
        raise ConfigError(
            f"num_workers is {workload.num_workers:,}, but this machine has {num_cores()} cores: more than "
            f"{max_workers()} worker processes are not started. Set --workers {max_workers()} or less; 0 is one for "
            "every core."
        )
    need, free = workload.memory(design), free_memory()
    if need <= free:
        return
    needs = f"takes {need / 1e9:,.1f} GB of memory, but {free / 1e9:,.1f} GB are free"
    fits = {name: _largest_fit(workload, name, design, free) for name in (*_SIZES, "chunk_size", "num_workers")}
    shares = {name: fit / max(1, getattr(workload, name)) for name, fit in fits.items()}
    # Prefer chunk_size, which does not affect results, then the smallest reduction.
    least = "chunk_size" if fits["chunk_size"] else max(shares, key=lambda name: shares[name])
    if fits[least]:
        shown, value = names.get(least, least), getattr(workload, least)
        its_flag = "--workers" if least == "num_workers" else flag(shown)
        raise ConfigError(f"{shown} is {value:,}, which {needs}. Set {its_flag} {fits[least]} or less.")
    raise ConfigError(f"the run {needs}. Lower {', '.join(map(flag, (*_SIZES, 'hidden')))}, or use a larger machine.")


def _largest_fit(workload: Workload, name: str, design: AgentDesign, free: int) -> int:
    """Return the largest value of `name` that fits `free` bytes, rounded down to two digits; 0 if none does."""
    values, names = range(1, min(getattr(workload, name), _MOST)), [name]
    if name == "horizon" and workload.horizon == workload.evaluation_horizon:
        names.append("evaluation_horizon")  # follows it, unless it is set
    fit = bisect_right(values, free, key=lambda value: replace(workload, **dict.fromkeys(names, value)).memory(design))
    step = 10 ** max(0, len(str(fit)) - 2)
    return fit // step * step
