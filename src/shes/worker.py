"""What a worker process does: hold the environments, receive a generation, run the episodes it is handed."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from shes.envs.registry import EnvironmentMaker
from shes.envs.task_options import TaskOptions
from shes.es.noise import NoiseTable
from shes.hierarchy.agent import AgentDesign
from shes.hierarchy.episodes import EpisodeResults, Generation
from shes.hierarchy.rollout import Rollout, Work

__all__ = ["RolloutWorker", "WorkerPlan", "lanes_that_fit"]

_SIMULATOR_LOG = logging.getLogger("shes.mujoco")
_MAX_LOG_LINES = 20  # of the simulator, kept with one task's results
_CACHE_BYTES = 24 * 2**20  # weights of all lanes beyond this leave the shared cache between two steps
_MIN_ROWS, _MAX_ROWS = 32, 256  # episodes in lockstep: enough to share Python's work, few enough for the caches


@dataclass(frozen=True, kw_only=True)
class WorkerPlan:
    """Everything that a worker needs to know once; sent to it when it starts."""

    env: EnvironmentMaker
    """What makes the episodes, not its name: a class of a user's script is in no registry of a worker process."""
    training: TaskOptions
    """Options of the environment in training."""
    evaluation: TaskOptions
    """Options of the environment in evaluation."""
    design: AgentDesign
    """What the agent is made of."""
    noise_table: Path
    """File of the noise table on this machine."""
    horizon: int
    """Steps after which an episode of training is over."""
    evaluation_horizon: int
    """Steps after which an episode of evaluation is over."""
    chunk_size: int
    """Members of the population in lockstep; 0 chooses. Never changes a number."""


def lanes_that_fit(parameters: int, episodes_per_policy: int) -> int:
    """Return how many policies of `parameters` numbers a worker best runs in lockstep.

    More rows share the cost of a Python step; but weights beyond the core's share of the cache are slower to use.
    """
    cached = _CACHE_BYTES // (4 * parameters)
    return max(1, -(-_MIN_ROWS // episodes_per_policy), min(cached, _MAX_ROWS // episodes_per_policy))


class _LogCollector(logging.Handler):
    """Keeps what the simulator logs, for the results of the task at hand."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if len(self.lines) < _MAX_LOG_LINES:
            self.lines.append(record.getMessage())

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Keep what the simulator logs meanwhile, and keep it from other handlers: it is reported with the results."""
        propagated, _SIMULATOR_LOG.propagate = _SIMULATOR_LOG.propagate, False
        _SIMULATOR_LOG.addHandler(self)
        try:
            yield
        finally:
            _SIMULATOR_LOG.removeHandler(self)
            _SIMULATOR_LOG.propagate = propagated


class RolloutWorker:
    """Evaluates tasks: the `Worker` of every backend."""

    def __init__(self, plan: WorkerPlan) -> None:
        """Open the noise table; environments are built when first used."""
        self.plan = plan
        self.table = NoiseTable.open_file(plan.noise_table)
        self._rollouts: dict[bool, Rollout] = {}
        self._generation: Generation | None = None
        self._collector = _LogCollector()

    def receive(self, state: Generation) -> None:
        """Take the mean policies that the next tasks perturb."""
        self._generation = state

    def run(self, work: Iterator[Work], share: int) -> Iterator[tuple[int, EpisodeResults]]:
        """Run `work`, of which about `share` tasks are this worker's; yield numbered results as they come."""
        assert self._generation is not None, "receive() comes first"
        rollout = self._rollout(self._generation, share)
        with self._collector.listening():
            for number, results in rollout.run(work, self._generation, self.table):
                lines, self._collector.lines = tuple(self._collector.lines), []
                yield number, replace(results, log=lines) if lines else results

    def _rollout(self, generation: Generation, share: int) -> Rollout:
        """Return the rollout for this generation with lanes for `share` tasks, building it where needed."""
        plan, episodes = self.plan, generation.episodes_per_policy
        chunk = plan.chunk_size or lanes_that_fit(sum(plan.design.dims), episodes)
        waves = max(1, -(-share // chunk))
        lanes = max(1, -(-share // waves))  # even waves: no last one with a few lanes alone
        rollout = self._rollouts.get(generation.is_evaluation)
        if rollout is None or (rollout.num_lanes, rollout.num_episodes) != (lanes, episodes):
            if rollout is not None:
                rollout.task.close()
            options = plan.evaluation if generation.is_evaluation else plan.training
            make = partial(plan.env.make, options=options)
            horizon = plan.evaluation_horizon if generation.is_evaluation else plan.horizon
            rollout = Rollout(plan.design, make, lanes, episodes, horizon)
            self._rollouts[generation.is_evaluation] = rollout
        return rollout
