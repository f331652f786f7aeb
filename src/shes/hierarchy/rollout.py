"""The only loop over environment steps: many policies in lockstep, refilled as they finish.

A worker has P lanes; a lane runs the R episodes of a task, each in its own slot: those of one member of the population,
or of a group's members, whose policies are the mean plus and minus the same noise. A finished episode leaves the
physics and the statistics but keeps its row of the lane's matmul, so no result depends on which members share a worker
(design, One generation). Lanes are refilled as they become free; on a device, where an idle lane
costs as much as a busy one and a transfer more than either, when all are.

Who runs, and for how long, is known here in NumPy's arrays; what is computed of episodes is the task's and the agent's,
in those of their module `xp`. Every step waits for a device twice: are the actions finite, and who has ended?
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from shes.arrays import to_host
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import PolicyError
from shes.es.level import perturb
from shes.es.noise import NoiseTable
from shes.hierarchy.agent import AgentDesign
from shes.hierarchy.episodes import (
    PARTS,
    EpisodeResults,
    EpisodeTask,
    Generation,
    LevelMoments,
    Outcomes,
    Snapshot,
    empty_outcomes,
)
from shes.hierarchy.exploration import Exploration
from shes.hierarchy.snapshots import Notes
from shes.types import BoolArray, F32Array, F64Array, IntArray

__all__ = ["Rollout"]

NumberedTask = tuple[int, EpisodeTask]
"""A task with its number in the order of results."""


@dataclass(kw_only=True)
class _Lane:
    """A task at work."""

    number: int
    task: EpisodeTask
    running: set[int]
    """Places in `task.slots` of the episodes that have not ended."""
    results: EpisodeResults


class Rollout:
    """Runs episodes of one environment for one agent design on one thread."""

    def __init__(
        self,
        design: AgentDesign,
        make_task: Callable[[int], EpisodeBatch],
        num_lanes: int,
        rows_per_lane: int,
        horizon: int,
        members_per_lane: int = 1,
    ) -> None:
        """Make room for `num_lanes` tasks of `rows_per_lane` episodes of at most `horizon` steps.

        `make_task` returns the environment for a number of episodes N = P * R; the R episodes of a lane are those of
        `members_per_lane` members, which share their noise.
        """
        self.rows_per_lane, self.horizon, self.members_per_lane = rows_per_lane, horizon, members_per_lane
        self.design = design
        self.task = make_task(num_lanes * rows_per_lane)
        self.xp = self.task.xp
        self.agent = design.make(num_lanes, rows_per_lane, self.xp, shares_noise=members_per_lane > 1)
        self._lanes: list[_Lane | None] = [None] * num_lanes
        rows = num_lanes * rows_per_lane
        self._exploration = Exploration(self.agent, horizon, self.task.action_size)
        self._is_running: BoolArray = np.zeros(rows, dtype=np.bool_)
        self._running: IntArray = np.zeros(0, dtype=np.int64)
        self._steps: IntArray = np.zeros(rows, dtype=np.int64)
        self._intrinsic_return: F64Array = self.xp.zeros(rows)
        self._seconds: F64Array = np.zeros(len(PARTS))
        self._notes: Notes | None = None

    @property
    def num_lanes(self) -> int:
        """Tasks at work at a time, P."""
        return len(self._lanes)

    def run(
        self, work: Iterator[NumberedTask], generation: Generation, table: NoiseTable
    ) -> Iterator[tuple[int, EpisodeResults]]:
        """Run `work` to its end, a task per lane at a time; yield numbered results as they come.

        Raises:
            PolicyError: A policy returned NaN or infinity.
        """
        self._exploration.begin(generation)
        self._notes = self._make_notes(generation.goals_noted)
        self.agent.normalise_by(generation.levels)
        if self.agent.shares_noise:
            self.agent.centre_on(generation.levels)
        self._lanes = [None] * self.num_lanes
        self._is_running[:] = False
        self._running = np.flatnonzero(self._is_running)
        means = [self.xp.asarray(level.theta) for level in generation.levels]
        is_exhausted = False
        while True:
            free = [place for place, lane in enumerate(self._lanes) if lane is None]
            if not is_exhausted and free and not (self.task.starts_together and len(free) < self.num_lanes):
                started = dict(zip(free, work, strict=False))
                is_exhausted = len(started) < len(free)
                if started:
                    self._start(started, means, generation, table)
            if not len(self._running):
                return
            yield from self._until_one_ends()

    def _make_notes(self, num_goals: int) -> Notes | None:
        """Return what notes snapshots with `num_goals` goals, if any are wanted."""
        return Notes(self.task, self.agent, num_goals) if num_goals else None

    def _start(
        self, started: dict[int, NumberedTask], means: list[F32Array], generation: Generation, table: NoiseTable
    ) -> None:
        """Put tasks into free lanes: perturb the policies, reset the episodes, draw their exploration noise."""
        slots: list[int] = []
        seeds: list[int] = []
        for place, (number, task) in started.items():
            self._perturb(place, task, means, generation.sigma, table)
            slots += [place * self.rows_per_lane + slot for slot in task.slots]
            seeds += task.seeds
            if self._exploration.is_on:
                self._exploration.draw(place, task)
            results = _empty_results(task, self.design.observation_sizes)
            self._lanes[place] = _Lane(number=number, task=task, running=set(range(len(task.slots))), results=results)
        rows = np.array(slots)
        _begin(self.task, rows, seeds, [task for _, task in started.values()])
        # Lanes without work keep the others' time: then what all decide together is quicker.
        self.agent.start(np.array(list(started)) if len(self._running) else slice(None))
        for place, (_, task) in started.items():
            if task.start is not None:
                self.agent.go_on(place, task.start.steps, task.start.goals)
        if self._notes is not None:
            self._notes.begin(started)
        if self._exploration.is_on:
            self._exploration.upload()
        self._intrinsic_return[self.xp.asarray(rows)] = 0
        self._steps[rows] = 0
        self._is_running[rows] = True
        self._running = np.flatnonzero(self._is_running)
        self.agent.is_recording = any(lane is not None and lane.task.records_statistics for lane in self._lanes)

    def _perturb(self, place: int, task: EpisodeTask, means: list[F32Array], sigma: float, table: NoiseTable) -> None:
        """Give lane `place` the policies of a task."""
        agent = self.agent
        for level, mean in enumerate(means):
            noise = table.slice(task.noise_index[level], len(mean))
            scales = [sigma * signs[level] for signs in task.signs]
            if agent.shares_noise:
                agent.theta[level][place] = noise
                each = np.repeat(np.array(scales, np.float32), self.rows_per_lane // self.members_per_lane)
                agent.scale[level][place, :, 0] = self.xp.asarray(each)
            else:
                perturb(mean, noise, scales[0], agent.theta[level][place])

    def _until_one_ends(self) -> Iterator[tuple[int, EpisodeResults]]:
        """Advance every running episode until one of them has ended; yield the tasks that this finished."""
        ended = np.zeros(0, dtype=np.int64)
        while not len(ended):
            ended = self._step()
        yield from self._finish(ended)

    def _step(self) -> IntArray:
        """Advance every running episode by one control step; return the rows of those that this ended."""
        task, agent = self.task, self.agent
        start, physics_s = perf_counter(), task.physics_s
        seen = (task.observe(), task.position, task.heading)
        observed = perf_counter()
        action = agent.act(*seen, goal=task.goal, **self._exploration.of_step())
        if not np.isfinite(action).all():
            self._refuse(action)
        if self._notes is not None:
            self._notes.take(self._is_running, self._steps)
        acted = perf_counter()
        task.step(self._running, action)
        self._steps += 1  # of those that do not run it is not asked
        stepped = perf_counter()
        if self.design.intrinsic_level is not None:
            # What a diverged simulation is worth is not known: its last step pays nothing.
            self._intrinsic_return += agent.intrinsic_reward(task.position) * ~task.diverged
        paid = perf_counter()
        ended = self._is_running & (to_host(task.terminated | task.diverged) | (self._steps >= self.horizon))
        physics_s, policy_s = task.physics_s - physics_s, acted - observed + paid - stepped
        # A device computes the physics while the rest is prepared: what is left of the time is the task's.
        self._seconds += (physics_s, policy_s, perf_counter() - start - physics_s - policy_s)
        return np.flatnonzero(ended)

    def _finish(self, rows: IntArray) -> Iterator[tuple[int, EpisodeResults]]:
        """Take the results of the episodes in `rows`; yield the lanes in which none is left."""
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
            for mine, summed in zip(results.moments or (), moments, strict=False):
                for taken, of_all in zip((mine.count, mine.total, mine.total_squares), summed, strict=True):
                    taken[k] = of_all[i]
            if lane.task.kept_slot == slot:
                has_ended_early = outcomes["has_diverged"][i] or outcomes["has_terminated"][i]
                results.snapshots[k] = None if has_ended_early else self._snapshot(row, lane.task)
            if self._notes is not None:
                results.snapshots[k] = self._notes.of(row)
            lane.running.discard(k)
            if not lane.running:
                self._lanes[place] = None
                results.seconds[:] = self._seconds
                self._seconds[:] = 0
                yield lane.number, results

    def _snapshot(self, row: int, task: EpisodeTask) -> Snapshot:
        """Return what another episode needs to go on where the one in `row` has ended."""
        before = 0 if task.start is None else task.start.steps
        state = self.task.states(np.array([row]))[0]
        return Snapshot(state=state, steps=before + int(self._steps[row]))

    def _outcomes(self, rows: IntArray) -> tuple[Outcomes, list[tuple[F64Array, ...]]]:
        """Return the outcomes of the episodes in `rows` and the moments of each level, in one transfer each."""
        task, agent, ids = self.task, self.agent, self.xp.asarray(rows)
        quantities: dict[str, Any] = {
            "environment_returns": task.running_return,
            "score": task.score,
            "success": task.success,
            "goals_reached": agent.goals_reached,
            "has_diverged": task.diverged,
            "has_terminated": task.terminated & ~task.diverged,
            "has_fallen": task.fallen & ~task.diverged,
            "final_position": task.position,
        }
        # float64 holds every count that there is exactly.
        parts = [part[ids].reshape(len(rows), -1) for part in (self._intrinsic_return, *quantities.values())]
        found = to_host(np.concatenate([part.astype(np.float64) for part in parts], axis=1))
        ends = np.cumsum([part.shape[1] for part in parts])
        intrinsic_return, *columns = np.split(found, ends[:-1], axis=1)
        outcomes = empty_outcomes(len(self.design.dims), len(rows))
        for name, column in zip(quantities, columns, strict=True):
            outcomes[name] = column.reshape(outcomes[name].shape)
        outcomes["steps"] = self._steps[rows]
        outcomes["returns"] = outcomes["environment_returns"][:, None]
        if self.design.intrinsic_level is not None:
            outcomes["returns"][:, self.design.intrinsic_level] = intrinsic_return[:, 0]
        moments = [
            tuple(to_host(sums[ids]) for sums in (each.count, each.total, each.total_squares))
            for each in (agent.moments if agent.is_recording else ())
        ]
        return outcomes, moments

    def _refuse(self, action: F32Array) -> None:
        """Say whose policy returned what is not finite; one without work cannot be the reason."""
        rows = np.flatnonzero(~np.isfinite(to_host(action)).all(axis=1))
        for row in sorted(rows.tolist(), key=lambda row: not self._is_running[row]):  # idle rows of a lane come last
            lane = self._lanes[row // self.rows_per_lane]
            if lane is None:
                continue
            place, slot = divmod(row, self.rows_per_lane)
            seed = lane.task.seeds[lane.task.slots.index(slot)] if slot in lane.task.slots else lane.task.seeds[0]
            bad = [not bool(np.isfinite(theta).all()) for theta in self.agent.parameters(place)]
            which = " and ".join(name for name, is_bad in zip(self.design.level_names, bad, strict=True) if is_bad)
            member = lane.task.member + slot // (self.rows_per_lane // self.members_per_lane)
            raise PolicyError(
                f"the policy of member {member} returned NaN or infinity at step {int(self._steps[row])}"
                f"{f' (parameters of its {which} are not finite)' if which else ''}; episode seed "
                f"{seed}. Start another run with a lower --learning-rate or --sigma."
            )


def _begin(batch: EpisodeBatch, rows: IntArray, seeds: list[int], tasks: list[EpisodeTask]) -> None:
    """Reset the episodes of `tasks`, which take `rows` of `batch` one after another, or put them where they start."""
    starts = [None if task.start is None else task.start.state for task in tasks for _ in task.slots]
    if any(state is not None for state in starts):
        batch.reset(rows, seeds, starts)
    else:
        batch.reset(rows, seeds)


def _empty_results(task: EpisodeTask, sizes: tuple[int, ...]) -> EpisodeResults:
    """Return results to be filled for the episodes of `task`, whose levels observe `sizes` values."""
    k = len(task.slots)
    moments = tuple(
        LevelMoments(count=np.zeros(k, np.int64), total=np.zeros((k, size)), total_squares=np.zeros((k, size)))
        for size in sizes
    )
    return EpisodeResults(
        outcomes=empty_outcomes(len(sizes), k),
        moments=moments if task.records_statistics else None,
        snapshots=[None] * k,
    )
