"""The unit of work: the episodes of one perturbed policy pair, each in its slot, and what came of them.

A task is a few integers; perturbations are drawn again from the noise table where the work is done (SHES paper II-G).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from shes.es.level import LevelParameters, TrainState
from shes.types import BoolArray, F64Array, IntArray

__all__ = ["PARTS", "EpisodeResults", "EpisodeTask", "Generation", "LevelMoments", "spread"]

PARTS = ("physics", "policy", "task")
"""What a roll-out spends its time on: MuJoCo; the agent; the task's observations and rewards, and the rest."""


@dataclass(frozen=True, kw_only=True)
class Generation:
    """What every task of a generation (or of an evaluation) has in common."""

    levels: tuple[LevelParameters, ...]
    """The mean policies with their normalisation."""
    sigma: float
    """Standard deviation of the perturbations."""
    episodes_per_policy: int
    """Rows of every policy's matmul (E)."""
    is_evaluation: bool
    """Whether the episodes are evaluation's: its reset noise and targets, no exploration noise."""
    has_frozen_control: bool = False
    """Whether the level that acts is frozen: no noise of any kind is put on it then."""

    @classmethod
    def of_training(cls, state: TrainState, sigma: float, episodes: int, learns: Sequence[bool]) -> Generation:
        """Return what the tasks of training after `state` have in common; `learns` says which levels do."""
        return cls(
            levels=LevelParameters.of_all(state.levels),
            sigma=sigma,
            episodes_per_policy=episodes,
            is_evaluation=False,
            has_frozen_control=not learns[-1],
        )


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
    goals_reached: IntArray
    """Goals that the primitive reached [K]."""
    final_position: F64Array
    """Where the robot was at the end [K, 2], in metres."""
    environment_returns: F64Array
    """Summed reward of the environment [K]."""
    moments: tuple[LevelMoments, ...] | None
    """Sums of the observations of each level, if asked for."""
    seconds: F64Array = field(default_factory=lambda: np.zeros(len(PARTS)))
    """What the worker spent on each of `PARTS` since the result before this one."""
    log: tuple[str, ...] = ()
    """What the simulator had to say meanwhile."""


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
