"""The only loop over environment steps: many policies in lockstep.

A worker has P lanes. A lane runs the R episodes of a task, each in its own slot: those of one member, or of several
members of a mirrored group, which share their noise. A finished episode leaves the physics and the statistics but keeps
its row in the lane's matmul, so results do not depend on which members share a worker. On the CPU, a free lane is
refilled at once. On a device, where transfers are expensive, all lanes are refilled together.

The rollout's own state is in NumPy arrays; the environment and the agent use arrays of their module `xp`. Every step
waits for the device twice: to check that actions are finite, and to find the episodes that have ended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from shes.agents.agent import AgentBatch, AgentDesign, AgentInputs
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import PolicyError
from shes.es.level import perturb
from shes.es.noise import NoiseTable
from shes.es.statistics import Moments
from shes.rollout.episodes import PARTS, EpisodeResults, EpisodeTask, Generation, Outcomes, Snapshot, empty_outcomes
from shes.rollout.exploration import Exploration
from shes.types import BoolArray, F32Array, F64Array, IntArray, to_host


class SnapshotRecorder:
    """Records states and goals of the episodes of a rollout while they run."""

    def __init__(self, batch: EpisodeBatch, agent: AgentBatch[Any], num_goals: int) -> None:
        """Record states of `batch` and, from then on, `num_goals` goals of `agent`."""
        self._batch, self._agent, self._num_goals = batch, agent, num_goals
        self._wanted: dict[int, tuple[int, ...]] = {}  # steps after which to record each row
        self._states: dict[int, dict[int, F64Array]] = {}  # by steps
        self._goals: dict[int, list[F64Array]] = {}  # of all decisions

    def begin(self, started: Mapping[int, tuple[int, EpisodeTask]]) -> None:
        """Store when to record the episodes of tasks that have `started`, by lane."""
        for lane, (_, task) in started.items():
            for slot, steps in zip(task.slots, task.snapshot_steps, strict=True):
                row = lane * self._agent.rows_per_lane + slot
                self._wanted[row], self._states[row], self._goals[row] = steps, {}, []

    def take(self, is_running: BoolArray, steps: IntArray) -> None:
        """Record states and goals at decisions, after the agents have decided and before the physics step.

        `steps` [N] are the control steps of each row so far.
        """
        due = np.flatnonzero(is_running & (steps % self._agent.design.controller_interval == 0))
        if not len(due):
            return
        wanted = np.array([row for row in due.tolist() if int(steps[row]) in self._wanted[row]], dtype=np.int64)
        for row, state in zip(wanted.tolist(), self._batch.states(wanted), strict=True):
            self._states[row][int(steps[row])] = state
        ids, goal = self._batch.xp.asarray(due), self._agent.goal
        assert goal is not None, "only an agent with goals leaves snapshots"
        for row, vector in zip(due.tolist(), to_host(goal[ids] - self._batch.position[ids]), strict=True):
            self._goals[row].append(vector)

    def of(self, row: int) -> tuple[Snapshot, ...]:
        """Return the snapshots of the episode in `row`, which has ended, but for those that were not due by then.

        Goals after the end of the episode are copies of its last goal.
        """
        goals, states, interval = self._goals[row], self._states[row], self._agent.design.controller_interval
        found = list[Snapshot]()
        for steps in filter(states.__contains__, self._wanted[row]):
            places = np.minimum(steps // interval + np.arange(self._num_goals), len(goals) - 1)
            found.append(Snapshot(state=states[steps], steps=steps, goals=np.array(goals)[places]))
        return tuple(found)


NumberedTask = tuple[int, EpisodeTask]
"""A task with its number."""


@dataclass(kw_only=True)
class _Lane:
    number: int
    task: EpisodeTask
    running: set[int]
    """Indices in `task.slots` of the episodes that have not ended."""
    results: EpisodeResults


class Rollout:
    """Runs episodes of one environment with agents of one design, in one thread."""

    def __init__(
        self,
        design: AgentDesign,
        make_batch: Callable[[int], EpisodeBatch],
        num_lanes: int,
        rows_per_lane: int,
        horizon: int,
        members_per_lane: int = 1,
    ) -> None:
        """Allocate `num_lanes` lanes of `rows_per_lane` episodes of at most `horizon` steps.

        `make_batch` returns the environment for a number of episodes N = P * R. The episodes of a lane belong to
        `members_per_lane` members, which share their noise.
        """
        self.shape = num_lanes, rows_per_lane, members_per_lane
        self.num_lanes, self.rows_per_lane, self.members_per_lane = self.shape
        self.horizon, self.design = horizon, design
        self.batch = make_batch(num_lanes * rows_per_lane)
        self.xp = self.batch.xp
        self.agent = design.agent(design, num_lanes, rows_per_lane, self.xp, shares_noise=members_per_lane > 1)
        rows = num_lanes * rows_per_lane
        self._exploration = Exploration(self.agent, horizon, self.batch.action_size)
        self._is_running: BoolArray = np.zeros(rows, dtype=np.bool_)
        self._steps: IntArray = np.zeros(rows, dtype=np.int64)
        self._intrinsic_return: F64Array = self.xp.zeros(rows)
        self._tilt: F64Array = self.xp.zeros(rows)
        self._seconds: F64Array = np.zeros(len(PARTS))

    def run(
        self,
        take: Callable[[int], Sequence[NumberedTask]],
        generation: Generation,
        table: NoiseTable,
        on_step: Callable[[], None] = lambda: None,
    ) -> Iterator[tuple[int, EpisodeResults]]:
        """Run tasks, one per lane at a time, and yield numbered results as they finish, until none is left.

        `take(n)` returns up to n further tasks; it is asked again when an episode has ended. `on_step` is called after
        steps that end no episode. A PolicyError is raised for a policy that returned NaN or infinity.
        """
        self.batch.set_way(generation.way)
        self._exploration.begin(generation)
        num_goals = generation.snapshot_goals
        self._recorder = SnapshotRecorder(self.batch, self.agent, num_goals) if num_goals else None
        self.agent.centre_on(generation.levels)
        self._lanes: list[_Lane | None] = [None] * self.num_lanes
        self._is_running[:] = False
        self._running: IntArray = np.flatnonzero(self._is_running)
        means = [self.xp.asarray(level.theta) for level in generation.levels]
        while True:
            free = [place for place, lane in enumerate(self._lanes) if lane is None]
            if free and not (self.batch.starts_together and len(free) < self.num_lanes):
                started = dict(zip(free, take(len(free)), strict=False))
                if started:
                    self._start(started, means, generation, table)
            if not len(self._running):
                return
            while not len(ended := self._step()):
                on_step()
            yield from self._finish(ended)

    def _start(
        self, started: dict[int, NumberedTask], means: list[F32Array], generation: Generation, table: NoiseTable
    ) -> None:
        """Start tasks in free lanes: perturb the policies, reset the episodes, draw their exploration noise."""
        slots: list[int] = []
        seeds: list[int] = []
        states: list[F64Array | None] = []
        for place, (number, task) in started.items():
            self._perturb(place, task, means, generation.sigma, table)
            slots += [place * self.rows_per_lane + slot for slot in task.slots]
            seeds += task.seeds
            count, sizes = len(task.slots), self.design.observation_sizes
            results = EpisodeResults(
                outcomes=empty_outcomes(len(sizes), count),
                moments=tuple(Moments.zeros(count, size) for size in sizes) if task.records_statistics else None,
                snapshots=[()] * count,
            )
            states += [None if task.start is None else task.start.state] * count
            self._lanes[place] = _Lane(number=number, task=task, running=set(range(count)), results=results)
        rows = np.array(slots)
        self._exploration.draw(started)
        self.batch.reset(rows, seeds, states if any(state is not None for state in states) else ())
        # If none is running, lanes without work start as well: steps are faster if all lanes have the same clock.
        self.agent.start(np.array(list(started)) if len(self._running) else slice(None))
        for place, (_, task) in started.items():
            if task.start is not None:
                self.agent.go_on(place, task.start.steps, task.start.goals)
        if self._recorder is not None:
            self._recorder.begin(started)
        self._intrinsic_return[self.xp.asarray(rows)] = 0
        self._tilt[self.xp.asarray(rows)] = 0
        self._steps[rows] = 0
        self._is_running[rows] = True
        self._running = np.flatnonzero(self._is_running)
        for level in self.agent.levels:
            level.is_recording = any(lane is not None and lane.task.records_statistics for lane in self._lanes)

    def _perturb(self, place: int, task: EpisodeTask, means: list[F32Array], sigma: float, table: NoiseTable) -> None:
        for level, (own, mean) in enumerate(zip(self.agent.levels, means, strict=True)):
            noise = table.slice(task.noise_index[level], len(mean))
            scales = [sigma * signs[level] for signs in task.signs]
            if self.members_per_lane > 1:
                own.theta[place] = noise
                each = np.repeat(np.array(scales, np.float32), self.rows_per_lane // self.members_per_lane)
                own.scale[place, :, 0] = self.xp.asarray(each)
            else:
                perturb(mean, noise, scales[0], own.theta[place])

    def _step(self) -> IntArray:
        """Advance every running episode by one control step, and return the rows of those that ended."""
        batch, agent = self.batch, self.agent
        start, physics_s = perf_counter(), batch.physics_s
        seen = (batch.observe(), batch.position, batch.heading)
        observed = perf_counter()
        action = agent.act(AgentInputs(*seen, batch.goal, **self._exploration.of_step()))
        if not np.isfinite(action).all():
            self._refuse(action)
        if self._recorder is not None:
            self._recorder.take(self._is_running, self._steps)
        acted = perf_counter()
        batch.step(self._running, action)
        self._steps += 1  # rows that are not running are ignored
        stepped = perf_counter()
        if self.design.has_intrinsic_reward:
            # The state of a diverged simulation is meaningless: its last step has no intrinsic reward.
            self._intrinsic_return += agent.intrinsic_reward(batch.position) * ~batch.diverged
            self._tilt = self.xp.maximum(self._tilt, self.xp.where(batch.diverged, 0, batch.tilt))
        paid = perf_counter()
        ended = self._is_running & (to_host(batch.terminated | batch.diverged) | (self._steps >= self.horizon))
        physics_s, policy_s = batch.physics_s - physics_s, acted - observed + paid - stepped
        # A device may compute the physics in the background, so the task's time is the remainder.
        self._seconds += (physics_s, policy_s, perf_counter() - start - physics_s - policy_s)
        return np.flatnonzero(ended)

    def _finish(self, rows: IntArray) -> Iterator[tuple[int, EpisodeResults]]:
        """Store the results of the episodes in `rows`, and yield the results of lanes that have finished."""
        self._is_running[rows] = False
        self._running = np.flatnonzero(self._is_running)
        outcomes, moments = self._outcomes(rows)
        for i, row in enumerate(rows.tolist()):
            place, slot = divmod(row, self.rows_per_lane)
            lane = self._lanes[place]
            assert lane is not None
            k = lane.task.slots.index(slot)
            results = lane.results
            results.outcomes[k] = outcomes[i]
            for policy, mine, summed in zip(self.design.policies, results.moments or (), moments, strict=False):
                for taken, of_all in zip(vars(mine).values(), summed, strict=True):
                    taken[k] = of_all[i]
                policy.pool(mine.total[k], mine.total_squares[k])
            has_ended_early = outcomes["has_diverged"][i] or outcomes["has_terminated"][i]
            if lane.task.kept_slot == slot and not has_ended_early:
                steps = int(self._steps[row]) + (0 if lane.task.start is None else lane.task.start.steps)
                results.snapshots[k] = (Snapshot(state=self.batch.states(rows[i : i + 1])[0], steps=steps),)
            if self._recorder is not None:
                results.snapshots[k] = self._recorder.of(row)
            lane.running.discard(k)
            if not lane.running:
                self._lanes[place] = None
                results.seconds[:] = self._seconds
                self._seconds[:] = 0
                yield lane.number, results

    def _outcomes(self, rows: IntArray) -> tuple[Outcomes, list[tuple[F64Array, ...]]]:
        """Return the outcomes of the episodes in `rows`, and the moments of each level."""
        batch, agent, ids = self.batch, self.agent, self.xp.asarray(rows)
        quantities: dict[str, Any] = {
            "environment_returns": batch.running_return,
            "score": batch.score,
            "success": batch.success,
            "goals_reached": agent.goals_reached,
            "has_diverged": batch.diverged,
            "has_terminated": batch.terminated & ~batch.truncated & ~batch.diverged,
            "fall": self.xp.maximum(batch.fallen & ~batch.diverged, self._tilt),
            "final_position": batch.position,
        }
        # A single transfer. float64 represents every count exactly.
        extra = (self._intrinsic_return, batch.reward_after_end)
        parts = [part[ids].reshape(len(rows), -1) for part in (*extra, *quantities.values())]
        found = to_host(np.concatenate([part.astype(np.float64) for part in parts], axis=1))
        ends = np.cumsum([part.shape[1] for part in parts])
        intrinsic_return, reward_after_end, *columns = np.split(found, ends[:-1], axis=1)
        outcomes = empty_outcomes(len(self.design.dims), len(rows))
        for name, column in zip(quantities, columns, strict=True):
            outcomes[name] = column.reshape(outcomes[name].shape)
        outcomes["steps"] = self._steps[rows]
        outcomes["environment_returns"] += reward_after_end[:, 0] * (self.horizon - self._steps[rows])
        outcomes["returns"] = outcomes["environment_returns"][:, None]
        if self.design.has_intrinsic_reward:
            outcomes["returns"][:, -1] = intrinsic_return[:, 0]
        recorded = (vars(own.moments).values() for own in agent.levels if own.is_recording)
        moments = [tuple(to_host(sums[ids]) for sums in each) for each in recorded]
        return outcomes, moments

    def _refuse(self, action: F32Array) -> None:
        """Raise PolicyError for a member whose policy returned NaN or infinity, unless its episode has ended."""
        rows = np.flatnonzero(self._is_running & ~np.isfinite(to_host(action)).all(axis=1))
        for row in rows.tolist():
            place, slot = divmod(row, self.rows_per_lane)
            lane = self._lanes[place]
            assert lane is not None
            levels = zip(self.design.networks, self.agent.levels, strict=True)
            seed = lane.task.seeds[lane.task.slots.index(slot)]
            which = " and ".join(name for name, level in levels if not level.is_finite(place))
            member = lane.task.member + slot // (self.rows_per_lane // self.members_per_lane)
            raise PolicyError(
                f"the policy of member {member} returned NaN or infinity at step {int(self._steps[row])}"
                f"{f' (parameters of its {which} are not finite)' if which else ''}; episode seed "
                f"{seed}. Start another run with a lower --learning-rate or --sigma."
            )
