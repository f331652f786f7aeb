"""The tasks of workers: a task is the episodes of members that share their noise vectors. Its results are per episode.

The unit of work is an episode in its slot; workers may share a task. A task is a few integers: the worker reads the
perturbations from its own noise table (SHES paper II-G).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from shes.es.level import LevelParameters
from shes.es.statistics import Moments
from shes.types import F64Array

PARTS = ("physics", "policy", "task")
"""Parts of a rollout that are timed: MuJoCo; the agent; the task's observations and rewards, and the rest."""

Decisions: TypeAlias = Literal["zero", "random", "wander"] | float
"""Decisions of a controller that has learned nothing: outputs of zero, a random direction each, directions that often
stay about the same, or one in radians."""

NEW_DIRECTION = 0.3
"""Probability of a new direction at a decision of one that wanders."""
TURN_RAD = 0.3
"""Standard deviation of its turn at the other decisions, in radians."""


def wander(rng: np.random.Generator, decisions: int, number: int) -> F64Array:
    """Return the directions [decisions, number] in radians of `number` robots that wander: at random, but steadily."""
    turns, is_new = rng.normal(0, TURN_RAD, (decisions, number)), rng.random((decisions, number)) < NEW_DIRECTION
    is_new[:1] = True
    angles = np.where(is_new, rng.uniform(-np.pi, np.pi, (decisions, number)), turns)
    for i in range(1, decisions):
        angles[i] += np.where(is_new[i], 0.0, angles[i - 1])
    return angles


Outcomes: TypeAlias = NDArray[np.void]
"""A structured array with one element per episode and the fields of `empty_outcomes`."""


def empty_outcomes(num_levels: int, *shape: int) -> Outcomes:
    """Return zeros for episodes of `shape`, with all fields that are kept of an episode.

    Fields are aligned, so that sums over a field round as those over a separate array.
    """
    fields = [
        ("returns", np.float64, (num_levels,)),  # undiscounted return of each level
        ("environment_returns", np.float64),  # undiscounted, with `reward_after_end` up to the horizon
        ("score", np.float64),  # test score of the task
        ("success", np.bool_),  # whether the task counts as solved
        ("steps", np.int64),  # environment steps; 0 for an episode that was not run
        ("has_terminated", np.bool_),  # whether a terminal state of the task ended the episode
        ("has_diverged", np.bool_),  # whether the physics diverged
        ("fall", np.float64),  # 1 if a fall of the robot ended the episode, else its greatest `EpisodeBatch.tilt`
        ("goals_reached", np.int64),  # number of goals that the primitive reached
        ("final_position", np.float64, (2,)),  # of the robot, in metres
    ]
    return np.zeros(shape, np.dtype(fields, align=True))


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """State of an episode at a decision, from which another one can continue."""

    state: F64Array | None
    """Full physics state [S], including the solver's warm start; None for a reset."""
    steps: int
    """Number of control steps since the reset."""
    goals: F64Array = field(default_factory=lambda: np.zeros((0, 2)))
    """Goals of this decision and the following ones [J, 2], relative to the robot at the time each was set, in metres.

    Empty if the environment sets the goals.
    """


@dataclass(frozen=True, kw_only=True)
class Generation:
    """Data that all tasks of a generation, or of an evaluation, share."""

    levels: tuple[LevelParameters, ...]
    """Mean parameters and normalisation of each level."""
    sigma: float
    """Standard deviation of the perturbations."""
    episodes_per_policy: int
    """Number of episodes per member (E)."""
    kind: Literal["training", "branch", "exploration", "evaluation"] = "training"
    """Kind of the episodes: whole ones, branches of them, walks of a search, or an evaluation, which has its own reset
    noise and targets. Exploration noise belongs to `training` alone."""
    members_per_lane: int = 1
    """Number of members that share noise vectors and a matmul (M')."""
    has_frozen_control: bool = False
    """Whether the acting level is frozen. It then has no exploration noise."""
    branch_steps: int = 0
    """Number of control steps in a branch; 0 for whole episodes."""
    snapshot_goals: int = 0
    """Number of goals in the snapshots of whole episodes; 0 for no snapshots."""
    decisions: Decisions | None = None
    """Added to the outputs of the deciding level, whose parameters in `levels` are then 0; None for its own outputs."""
    way: F64Array | None = None
    """Waypoints [points, X] to the target in metres; None without a way."""

    @property
    def rows_per_lane(self) -> int:
        """Number of rows of every matmul, R = M' * E. It affects rounding."""
        return self.members_per_lane * self.episodes_per_policy


@dataclass(frozen=True, kw_only=True)
class EpisodeTask:
    """Some or all of the R = M' * E episodes of M' members that share their noise."""

    member: int
    """Index of the first of these members."""
    noise_index: tuple[int, ...]
    """Start of the noise slice of each level."""
    signs: tuple[tuple[int, ...], ...]
    """Sign of each level's perturbation, for each of the M' members; 0 for no perturbation."""
    slots: tuple[int, ...]
    """Rows of the matmul, among R, for these episodes. Those of a member are neighbours."""
    seeds: tuple[int, ...]
    records_statistics: bool = True
    """Whether the observations of these episodes enter the statistics."""
    start: Snapshot | None = None
    """Initial state of these episodes; None for a reset."""
    kept_slot: int | None = None
    """Slot of the episode whose end is kept as a snapshot, if it ends at the time limit."""
    snapshot_steps: tuple[tuple[int, ...], ...] = ()
    """Numbers of control steps before the snapshots of each episode. It has those before its end."""

    def part(self, start: int, stop: int) -> EpisodeTask:
        """Return the task of episodes `start` to `stop`, in the same slots. It costs the matmul of the whole task."""
        cut = slice(start, stop)
        return replace(self, slots=self.slots[cut], seeds=self.seeds[cut], snapshot_steps=self.snapshot_steps[cut])


@dataclass(frozen=True, kw_only=True)
class EpisodeResults:
    """Results of the K episodes of a task, in the order of its slots."""

    outcomes: Outcomes
    """Outcome of each episode [K]."""
    moments: tuple[Moments, ...] | None
    """Moments of the observations of each level, if recorded."""
    snapshots: list[tuple[Snapshot, ...]] = field(default_factory=list)
    """Snapshots of each episode [K]."""
    seconds: F64Array = field(default_factory=lambda: np.zeros(len(PARTS)))
    """Seconds that the worker spent on each of `PARTS` since its previous result."""
    log: tuple[str, ...] = ()
