"""Roll out episode tasks on a backend, and collect the results of a whole population."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shes.backends.backend import Backend
from shes.es.statistics import ObservationStatistics
from shes.rollout.episodes import PARTS, EpisodeResults, EpisodeTask, Generation, Outcomes, Snapshot, empty_outcomes
from shes.types import BoolArray, F64Array

_LANE_COST = 0.05  # of a part, in episodes per episode of the whole task: its matmul has the rows of all of them


def roll_out_tasks(tasks: Sequence[EpisodeTask], generation: Generation, backend: Backend) -> PopulationResults:
    """Return the results of `tasks`, which share `generation`, computed by the workers of `backend`."""
    backend.broadcast(generation)
    episodes = generation.episodes_per_policy
    members = 1 + max(task.member + max(task.slots) // episodes for task in tasks)
    results = PopulationResults(
        outcomes=empty_outcomes(len(generation.levels), members, episodes),
        statistics=[ObservationStatistics.empty(len(level.mean)) for level in generation.levels],
    )
    parts = divide(tasks, backend.num_workers)
    for part, result in zip(parts, backend.map(parts), strict=True):
        results.add(part, result)
    return results


def divide(tasks: Sequence[EpisodeTask], num_workers: int) -> Sequence[EpisodeTask]:
    """Return `tasks`, each cut into as many parts as makes the longest share of `num_workers` workers shortest.

    1000 members with 5 episodes each, in mirrored groups of four, are 250 tasks of 20 episodes: 600 workers do them in
    500 parts of 10. Results do not depend on it.
    """
    size = max((len(task.slots) for task in tasks), default=0)

    def longest_share(count: int) -> float:
        return -(-len(tasks) * count // num_workers) * (-(-size // count) + _LANE_COST * size)

    count = min(range(1, size + 1), key=longest_share, default=1)
    borders = ((task, [i * len(task.slots) // count for i in range(count + 1)]) for task in tasks)
    return [task.part(*cut) for task, cuts in borders for cut in pairwise(cuts) if cut[0] < cut[1]]


def lower_diverged(values: F64Array, has_diverged: BoolArray) -> F64Array:
    """Return `values` of episodes, of any shape, with those of diverged ones lowered to the minimum of the others."""
    if not has_diverged.any() or has_diverged.all():
        return values
    return np.where(has_diverged, np.minimum(values, values[~has_diverged].min()), values)


@dataclass(frozen=True, kw_only=True)
class PopulationResults:
    """Results of a population of n members with E episodes each.

    The fields of `outcomes` are attributes: `results.score` is `results.outcomes["score"]`.
    """

    outcomes: Outcomes
    """Outcome of each episode [n, E]; final positions are [n, E, 2]."""
    statistics: list[ObservationStatistics] = field(default_factory=list)
    """Statistics of each level's observations in these episodes."""
    seconds: F64Array = field(default_factory=lambda: np.zeros(len(PARTS)))
    """Seconds spent on each of `PARTS`, summed over workers."""
    log: list[str] = field(default_factory=list)
    snapshots: dict[tuple[int, int], tuple[Snapshot, ...]] = field(default_factory=dict)
    """Snapshots by member and episode, in the order of the tasks; episodes without any are left out."""

    def __getattr__(self, name: str) -> NDArray[Any]:
        if name.startswith("_") or name == "outcomes" or name not in (self.outcomes.dtype.names or ()):
            raise AttributeError(f"{type(self).__name__} has no {name!r}")
        return self.outcomes[name]

    @property
    def returns(self) -> F64Array:
        """Return of each level [L, n, E]."""
        return np.moveaxis(self.outcomes["returns"], -1, 0)

    @property
    def fitness(self) -> F64Array:
        """Fitness of every member at each level [L, n]: its mean return.

        A diverged episode counts as the worst of the others, so that divergence is never rewarded.
        """
        returns = [lower_diverged(row, self.has_diverged) for row in np.ascontiguousarray(self.returns)]
        return np.stack(returns).mean(axis=2)

    def add(self, task: EpisodeTask, result: EpisodeResults) -> None:
        """Add the result of `task`. The order of the calls affects the rounding of the statistics."""
        episodes = self.outcomes.shape[1]
        place = np.divmod(task.member * episodes + np.array(task.slots), episodes)
        self.outcomes[place] = result.outcomes
        self.seconds[:] += result.seconds
        self.log.extend(result.log)
        for member, episode, snapshots in zip(*place, result.snapshots, strict=False):
            if snapshots:
                self.snapshots[int(member), int(episode)] = snapshots
        for level, new in enumerate(result.moments or ()):
            for count, *sums in zip(new.count.tolist(), new.total, new.total_squares, strict=True):
                self.statistics[level] = self.statistics[level].merge(count, *sums)
