"""Goals of HIRO: a change of the robot's own coordinates, relative to its current state.

G coordinates of a goal. With specification and robot of the HIRO paper they are the 15 of the ant's qpos.

Source: Nachum et al. 2018, section 3.2 and appendix C.1; its published code.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shes.envs.episode_batch import EpisodeBatch
from shes.types import F64Array, FloatArray

_OTHER_RANGES: dict[str, tuple[float, ...]] = {"ant": (0.5, 1.0, 1.0, 1.0, 1.0, *(0.5, 0.3) * 4)}
"""Half ranges of the coordinates after x and y: height, quaternion, then hip and ankle of each leg."""


@dataclass(frozen=True)
class GoalSpace:
    """The coordinates of a goal."""

    half_range: tuple[float, ...]
    """Largest goal in each coordinate [G], in metres and radians."""
    columns: tuple[int, ...] | None
    """Indices of the coordinates in the observation; None for the position of an environment that observes none."""

    @classmethod
    def of(cls, task: EpisodeBatch, goal_distance: float) -> GoalSpace:
        """Return the goals of the robot of `task`; raise ConfigError if its position is unknown."""
        task.check_position()
        if task.robot is None:
            return cls((goal_distance,) * 2, None)
        half_range = (goal_distance, goal_distance, *_OTHER_RANGES.get(task.robot.name, ()))
        return cls(half_range, tuple(task.proprioception[: len(half_range)].tolist()))

    @property
    def size(self) -> int:
        """Number of coordinates, G."""
        return len(self.half_range)

    def coordinates(self, observation: F64Array, position: F64Array) -> F64Array:
        """Return the coordinates [N, G] of robots with these observations [N, O] and positions [N, 2], a copy."""
        return position.copy() if self.columns is None else observation[:, list(self.columns)]


def primitive_columns(task: EpisodeBatch) -> list[int]:
    """Return the indices in the observation of what a primitive sees: the robot without its x and y, and the time.

    Deviation: x and y are left out; in HIRO they are zero.
    """
    hidden = {*task.position_columns.tolist()}
    time = [i for i, name in enumerate(task.observation_names) if name == "time"]
    return [i for i in (*task.proprioception.tolist(), *time) if i not in hidden]


def goal_transition(goal: F64Array, before: F64Array, after: F64Array) -> F64Array:
    """Return h(s, g, s') = s + g - s' [..., G]: the same goal, seen from the coordinates after a step."""
    return before + goal - after


def primitive_reward(left: F64Array) -> F64Array:
    """Return the primitive's reward [...] for a step after which the goal `left` [..., G] is left: minus its length."""
    return -np.sqrt(np.vecdot(left, left))


def candidates(
    goal: FloatArray, moved: FloatArray, half_range: Sequence[float], count: int, rng: np.random.Generator
) -> FloatArray:
    """Return the goals [B, count, G] among which the off-policy correction chooses.

    They are the original `goal` [B, G], the change of the coordinates `moved` [B, G] in the interval, and goals drawn
    around that change with half the half range as standard deviation, all clipped to the range.
    """
    limit = np.asarray(half_range)
    drawn = moved[:, None] + rng.standard_normal((len(goal), max(count - 2, 0), len(limit))) * (0.5 * limit)
    found = np.concatenate([goal[:, None], moved[:, None], drawn], axis=1)[:, :count]
    return np.clip(found, -limit, limit)
