"""The unit of work: the episodes of members of the population that share a noise vector, and what came of them.

A task is a few integers; perturbations are drawn again from the noise table where the work is done (SHES paper II-G).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from shes.es.level import LevelParameters, TrainState
from shes.types import F64Array, IntArray

__all__ = [
    "PARTS",
    "ByEpisode",
    "EpisodeResults",
    "EpisodeTask",
    "Generation",
    "LevelMoments",
    "Outcomes",
    "Snapshot",
    "empty_outcomes",
    "spread",
]

PARTS = ("physics", "policy", "task")
"""What a rollout spends its time on: MuJoCo; the agent; the task's observations and rewards, and the rest."""


Outcomes: TypeAlias = NDArray[np.void]
"""A structured array: one element an episode, with the fields of `empty_outcomes`."""


def empty_outcomes(num_levels: int, *shape: int) -> Outcomes:
    """Return zeros for episodes of `shape`: all that is kept of an episode. `Rollout` fills in each field by its name.

    A field is aligned: sums over it then round as those of an array of its own.
    """
    fields = [
        ("returns", np.float64, (num_levels,)),  # summed reward of each level
        ("environment_returns", np.float64),  # summed reward of the environment
        ("score", np.float64),  # test score of the task
        ("success", np.bool_),  # whether the task counts as solved
        ("steps", np.int64),  # environment steps; 0 for an episode that was not asked for
        ("has_terminated", np.bool_),  # whether the task's own rule ended the episode
        ("has_fallen", np.bool_),  # whether the robot's fall ended the episode
        ("has_diverged", np.bool_),  # whether the physics blew up
        ("goals_reached", np.int64),  # goals that the primitive reached
        ("final_position", np.float64, (2,)),  # where the robot was at the end, in metres
    ]
    return np.zeros(shape, np.dtype(fields, align=True))


class ByEpisode:
    """Has `outcomes`, each field of which is an attribute: `results.score` is `results.outcomes["score"]`."""

    outcomes: Outcomes

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name.startswith("_") or name == "outcomes" or name not in (self.outcomes.dtype.names or ()):
            raise AttributeError(f"{type(self).__name__} has no {name!r}")
        return self.outcomes[name]

    @property
    def returns(self) -> F64Array:
        """Summed reward of each level [L, ...]."""
        return np.moveaxis(self.outcomes["returns"], -1, 0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """An episode at a decision: what another one needs to go on from there."""

    state: F64Array | None
    """Whole physics state [S], the solver's warm start included; None stands for a reset."""
    steps: int
    """Control steps since the reset."""
    goals: F64Array = field(default_factory=lambda: np.zeros((0, 2)))
    """This decision's goal and those of the next ones [J, 2]: from where the robot was when each was set, in metres.

    Empty where the environment sets the goals.
    """


@dataclass(frozen=True, kw_only=True)
class Generation:
    """What every task of a generation (or of an evaluation) has in common."""

    levels: tuple[LevelParameters, ...]
    """The mean policies with their normalisation."""
    sigma: float
    """Standard deviation of the perturbations."""
    episodes_per_policy: int
    """Episodes of every member (E)."""
    is_evaluation: bool
    """Whether the episodes are evaluation's: its reset noise and targets, no exploration noise."""
    members_per_lane: int = 1
    """Members of the population that share a noise vector, and one matmul (M')."""
    has_frozen_control: bool = False
    """Whether the level that acts is frozen: no noise of any kind is put on it then."""
    branch_steps: int = 0
    """Control steps of a branch, where the primitive is judged by intervals; 0 for whole episodes."""
    goals_noted: int = 0
    """Goals of a snapshot that whole episodes leave; 0 if they leave none."""

    @property
    def kind(self) -> str:
        """What its episodes are: `evaluation`, `branch` or `training`."""
        return "evaluation" if self.is_evaluation else "branch" if self.branch_steps else "training"

    @property
    def rows_per_lane(self) -> int:
        """Rows of every matmul, R = M' * E: part of what decides how it rounds."""
        return self.members_per_lane * self.episodes_per_policy

    @classmethod
    def of_training(
        cls,
        state: TrainState,
        sigma: float,
        episodes: int,
        learns: Sequence[bool],
        members_per_lane: int,
        goals_noted: int = 0,
    ) -> Generation:
        """Return what the tasks of training after `state` have in common; `learns` says which levels they perturb."""
        return cls(
            levels=LevelParameters.of_all(state.levels),
            sigma=sigma,
            episodes_per_policy=episodes,
            is_evaluation=False,
            has_frozen_control=not learns[-1],
            members_per_lane=members_per_lane,
            goals_noted=goals_noted,
        )


@dataclass(frozen=True, kw_only=True)
class EpisodeTask:
    """Some or all of the R = M' * E episodes of M' members of the population that share their noise."""

    member: int
    """Number of the first of these members."""
    noise_index: tuple[int, ...]
    """Start of the noise slice of each level."""
    signs: tuple[tuple[int, ...], ...]
    """Sign of each level's perturbation, for each of the M' members; 0 leaves the mean policy."""
    slots: tuple[int, ...]
    """Which of the R rows of the matmul these episodes take: a member's E are neighbours."""
    seeds: tuple[int, ...]
    """Seed of each episode."""
    records_statistics: bool = True
    """Whether the observations of these episodes are summed."""
    start: Snapshot | None = None
    """Where these episodes begin; at a reset if None."""
    kept_slot: int | None = None
    """Of whose end a snapshot is wanted, if it ends at the time limit."""
    noted_steps: tuple[int, ...] = ()
    """After how many control steps of each episode a snapshot is wanted; an episode that ends before leaves none."""


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
class EpisodeResults(ByEpisode):
    """What came of the K episodes of a task, in the order of its slots."""

    outcomes: Outcomes
    """What came of each episode [K]."""
    moments: tuple[LevelMoments, ...] | None
    """Sums of the observations of each level, if asked for."""
    snapshots: list[Snapshot | None] = field(default_factory=list)
    """What each episode left [K]; empty if nothing was asked for."""
    seconds: F64Array = field(default_factory=lambda: np.zeros(len(PARTS)))
    """What the worker spent on each of `PARTS` since the result before this one."""
    log: tuple[str, ...] = ()
    """What the simulator had to say meanwhile."""


def spread(tasks: list[EpisodeTask], num_workers: int) -> list[EpisodeTask]:
    """Return the same episodes in the same order, with the last tasks cut into single episodes.

    Whole tasks go around as often as every worker can have one; the rest is too few for all workers and is handed
    out by episodes. A single episode costs the whole task's matmul, so this is done only where workers would idle.
    """
    whole = len(tasks) - len(tasks) % num_workers
    singles = [
        replace(task, slots=(slot,), seeds=(seed,), noted_steps=task.noted_steps[i : i + 1])
        for task in tasks[whole:]
        for i, (slot, seed) in enumerate(zip(task.slots, task.seeds, strict=True))
    ]
    return tasks[:whole] + singles
