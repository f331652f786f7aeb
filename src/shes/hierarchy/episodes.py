"""The unit of work: the episodes of one perturbed policy pair, each in its slot, and what came of them.

A task is a few integers; perturbations are drawn again from the noise table where the work is done (SHES paper II-G).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from shes.es.level import LevelParameters, LevelState
from shes.types import BoolArray, F64Array, IntArray

__all__ = ["EpisodeResults", "EpisodeTask", "Generation", "LevelMoments", "PopulationResults", "spread"]


@dataclass(frozen=True, kw_only=True)
class Generation:
    """What every task of a generation (or of an evaluation) has in common."""

    levels: tuple[LevelParameters, ...]
    """The mean policies with their normalisation."""
    sigma: float
    """Standard deviation of the perturbations."""
    is_evaluation: bool
    """Whether the episodes are evaluation's: its reset noise and targets, no exploration noise."""


@dataclass(frozen=True, kw_only=True)
class EpisodeTask:
    """Some or all of the E episodes of one member of the population."""

    member: int
    """Number of the member, for messages."""
    noise_index: tuple[int, ...]
    """Start of the noise slice of each level."""
    signs: tuple[int, ...]
    """Sign of each level's perturbation; 0 leaves the mean policy."""
    slots: tuple[int, ...]
    """Which of the E rows of the policy's matmul these episodes take."""
    seeds: tuple[int, ...]
    """Seed of each episode."""
    records_statistics: bool = True
    """Whether the observations of these episodes are summed."""


@dataclass(frozen=True, kw_only=True)
class LevelMoments:
    """Sums of the observations of one level in K episodes."""

    count: IntArray
    """Observations [K]."""
    total: F64Array
    """Their sum [K, O]."""
    total_squares: F64Array
    """Sum of their squares [K, O]."""


@dataclass(frozen=True, kw_only=True)
class EpisodeResults:
    """What came of the K episodes of a task, in the order of its slots."""

    returns: F64Array
    """Summed reward of each level [L, K]."""
    score: F64Array
    """Test score of the task [K]."""
    success: BoolArray
    """Whether the task counts as solved [K]."""
    steps: IntArray
    """Environment steps [K]."""
    has_terminated: BoolArray
    """Whether the task's own rule ended the episode [K]."""
    has_diverged: BoolArray
    """Whether the physics blew up [K]."""
    moments: tuple[LevelMoments, ...] | None
    """Sums of the observations of each level, if asked for."""
    log: tuple[str, ...] = ()
    """What the simulator had to say meanwhile."""


@dataclass(frozen=True, kw_only=True)
class PopulationResults:
    """What came of the episodes of a whole population of n members with E episodes each."""

    returns: F64Array
    """Summed reward of each level [L, n, E]."""
    score: F64Array
    """Test score of the task [n, E]."""
    success: BoolArray
    """Whether the task counts as solved [n, E]."""
    steps: IntArray
    """Environment steps [n, E]; 0 for an episode that was not asked for."""
    has_terminated: BoolArray
    """Whether the task's own rule ended the episode [n, E]."""
    has_diverged: BoolArray
    """Whether the physics blew up [n, E]."""
    moments: list[LevelMoments] = field(default_factory=list)
    """Sums of the observations of each level so far, over episodes (K = 1); empty before the first."""
    log: list[str] = field(default_factory=list)
    """What the simulators had to say."""

    @classmethod
    def empty(cls, num_levels: int, members: int, episodes: int) -> PopulationResults:
        """Return results to be filled by `add`."""
        shape = (members, episodes)
        return cls(
            returns=np.zeros((num_levels, *shape)),
            score=np.zeros(shape),
            success=np.zeros(shape, np.bool_),
            steps=np.zeros(shape, np.int64),
            has_terminated=np.zeros(shape, np.bool_),
            has_diverged=np.zeros(shape, np.bool_),
        )

    @property
    def fitness(self) -> F64Array:
        """Fitness of every member at each level [L, n]: its mean return."""
        return self.returns.mean(axis=2)

    def add(self, task: EpisodeTask, result: EpisodeResults) -> None:
        """Enter the result of `task`. The order of these calls is that in which sums of observations are rounded."""
        place = (task.member, list(task.slots))
        self.returns[:, task.member, place[1]] = result.returns
        self.score[place], self.success[place] = result.score, result.success
        self.steps[place] = result.steps
        self.has_terminated[place], self.has_diverged[place] = result.has_terminated, result.has_diverged
        self.log.extend(result.log)
        if result.moments is None:
            return
        if not self.moments:
            self.moments.extend(
                LevelMoments(count=m.count[:1] * 0, total=m.total[0] * 0, total_squares=m.total_squares[0] * 0)
                for m in result.moments
            )
        for mine, new in zip(self.moments, result.moments, strict=True):
            mine.count[0] += new.count.sum()
            for k in range(len(new.count)):
                mine.total[:] += new.total[k]
                mine.total_squares[:] += new.total_squares[k]

    def merge_statistics(self, levels: tuple[LevelState, ...]) -> tuple[LevelState, ...]:
        """Return `levels` with these observations in their statistics."""
        if not self.moments:
            return levels
        return tuple(
            replace(level, statistics=level.statistics.merge(int(m.count[0]), m.total, m.total_squares))
            for level, m in zip(levels, self.moments, strict=True)
        )


def spread(tasks: list[EpisodeTask], num_workers: int) -> list[EpisodeTask]:
    """Return the same episodes in the same order, with the last policies cut into single episodes.

    Whole policies go around as often as every worker can have one; the rest is too few for all workers and is handed
    out by episodes. A single episode costs the whole policy's matmul, so this is done only where workers would idle.
    """
    whole = len(tasks) - len(tasks) % num_workers
    singles = [
        replace(task, slots=(slot,), seeds=(seed,))
        for task in tasks[whole:]
        for slot, seed in zip(task.slots, task.seeds, strict=True)
    ]
    return tasks[:whole] + singles
