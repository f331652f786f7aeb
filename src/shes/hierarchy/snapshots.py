"""Snapshots that whole episodes leave of themselves: the states and goals that branches of the primitive begin with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shes.arrays import to_host
from shes.envs.episode_batch import EpisodeBatch
from shes.hierarchy.agent import AgentBatch
from shes.hierarchy.episodes import EpisodeTask, Snapshot
from shes.types import BoolArray, F64Array, IntArray

__all__ = ["Notes"]


class Notes:
    """What a rollout writes down of its episodes while they run, for their snapshots."""

    def __init__(self, batch: EpisodeBatch, agent: AgentBatch[Any], num_goals: int) -> None:
        """Note the states of `batch` and `num_goals` goals of `agent`: of a decision and of those after it."""
        self._batch, self._agent, self._num_goals = batch, agent, num_goals
        self._interval = agent.design.controller_interval
        rows = batch.num_episodes
        self._wanted: IntArray = np.full(rows, -1)  # steps after which each row's snapshot is wanted; -1 for none
        self._noted: IntArray = np.zeros(rows, dtype=np.int64)  # goals noted so far
        self._goals: F64Array = np.zeros((rows, num_goals, 2))
        self._states: dict[int, F64Array] = {}

    def begin(self, started: Mapping[int, tuple[int, EpisodeTask]]) -> None:
        """Note what is wanted of the tasks that have `started`, by lane: nothing of the mean policies' episodes."""
        for lane, (_, task) in started.items():
            wanted = task.noted_steps or (-1,) * len(task.slots)
            for slot, steps in zip(task.slots, wanted, strict=True):
                row = lane * self._agent.rows_per_lane + slot
                self._wanted[row], self._noted[row] = steps, 0

    def take(self, is_running: BoolArray, steps: IntArray) -> None:
        """Note the states and goals that are due, after agents have decided and before the physics goes on.

        Args:
            is_running: Which rows run [N].
            steps: Control steps that each row has made [N].
        """
        due = np.flatnonzero(is_running & (steps == self._wanted + self._noted * self._interval))
        due = due[self._noted[due] < self._num_goals]
        if not len(due):
            return
        first = due[self._noted[due] == 0]
        if len(first):
            self._states.update(zip(first.tolist(), self._batch.states(first), strict=True))
        ids, goal = self._batch.xp.asarray(due), self._agent.goal
        assert goal is not None, "only an agent with goals leaves snapshots"
        self._goals[due, self._noted[due]] = to_host(goal[ids] - self._batch.position[ids])
        self._noted[due] += 1

    def of(self, row: int) -> Snapshot | None:
        """Return the snapshot of the episode in `row`, which has ended; none if it ended before it was due.

        Goals that it did not live to see are the last one that it saw.
        """
        if row not in self._states:
            return None
        seen = int(self._noted[row])
        goals = self._goals[row].copy()
        goals[seen:] = goals[seen - 1]
        return Snapshot(state=self._states.pop(row), steps=int(self._wanted[row]), goals=goals)
