"""Recording of snapshots in whole episodes: the states and goals from which branches of the primitive start."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shes.agents.agent import AgentBatch
from shes.envs.episode_batch import EpisodeBatch
from shes.rollout.episodes import EpisodeTask, Snapshot
from shes.types import BoolArray, F64Array, IntArray, to_host


class SnapshotRecorder:
    """Records states and goals of the episodes of a rollout while they run."""

    def __init__(self, batch: EpisodeBatch, agent: AgentBatch[Any], num_goals: int) -> None:
        """Record states of `batch` and, from then on, `num_goals` goals of `agent`."""
        self._batch, self._agent, self._num_goals = batch, agent, num_goals
        self._interval = agent.design.controller_interval
        rows = batch.num_episodes
        self._wanted: IntArray = np.full(rows, -1)  # steps after which to record each row; -1 for never
        self._recorded: IntArray = np.zeros(rows, dtype=np.int64)  # goals recorded so far
        self._goals: F64Array = np.zeros((rows, num_goals, 2))
        self._states: dict[int, F64Array] = {}

    def begin(self, started: Mapping[int, tuple[int, EpisodeTask]]) -> None:
        """Store when to record the episodes of tasks that have `started`, by lane."""
        for lane, (_, task) in started.items():
            wanted = task.snapshot_steps or (-1,) * len(task.slots)
            for slot, steps in zip(task.slots, wanted, strict=True):
                row = lane * self._agent.rows_per_lane + slot
                self._wanted[row], self._recorded[row] = steps, 0

    def take(self, is_running: BoolArray, steps: IntArray) -> None:
        """Record the states and goals that are due, after the agents have decided and before the physics step.

        `steps` [N] are the control steps of each row so far.
        """
        due = np.flatnonzero(is_running & (steps == self._wanted + self._recorded * self._interval))
        due = due[self._recorded[due] < self._num_goals]
        if not len(due):
            return
        first = due[self._recorded[due] == 0]
        if len(first):
            self._states.update(zip(first.tolist(), self._batch.states(first), strict=True))
        ids, goal = self._batch.xp.asarray(due), self._agent.goal
        assert goal is not None, "only an agent with goals leaves snapshots"
        self._goals[due, self._recorded[due]] = to_host(goal[ids] - self._batch.position[ids])
        self._recorded[due] += 1

    def of(self, row: int) -> Snapshot | None:
        """Return the snapshot of the episode in `row`, which has ended; None if it ended before the snapshot was due.

        Goals after the end of the episode are copies of its last goal.
        """
        if row not in self._states:
            return None
        seen = int(self._recorded[row])
        goals = self._goals[row].copy()
        goals[seen:] = goals[seen - 1]
        return Snapshot(state=self._states.pop(row), steps=int(self._wanted[row]), goals=goals)
