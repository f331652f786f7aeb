"""Algorithm 1 of the SHES paper: evolve a controller and a primitive together.

Source: S. Abramowitz and G. Nitschke, "Towards Run-time Efficient Hierarchical Reinforcement Learning", IEEE CEC 2022,
Algorithm 1 and sections II-A, II-E, II-F. `# line k` marks the lines of Algorithm 1; `theta`, `sigma`, `alpha` (the
learning rate), `n` (the population size) and the noise `epsilon` are its symbols. With one level in the state it is
S-ES (Salimans et al. 2017). Every random number comes from (seed, purpose, generation): nothing here depends on how
many workers there are, or on which one does what.
"""

from __future__ import annotations

from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter

from shes.algorithms.evolution.populations import Population, Settings, generation_work, roll_out, roll_out_branches
from shes.backends.backend import Backend
from shes.es.level import LevelUpdate, TrainState
from shes.es.noise import NoiseTable
from shes.hierarchy.fitness import advance_novelty
from shes.hierarchy.intervals import next_running
from shes.hierarchy.results import PopulationResults

__all__ = ["GenerationReport", "Settings", "evolve", "generation_work"]


@dataclass(frozen=True, kw_only=True)
class GenerationReport:
    """One generation: the state after it, and what it saw."""

    state: TrainState
    """The state after the update."""
    population: Population
    """The members judged by whole episodes; where a primitive alone is judged by intervals, its pairs."""
    branches: Population | None
    """The pairs of a primitive that is judged by intervals beside a controller."""
    updates: tuple[LevelUpdate, ...]
    """What there is to know of the update of each level."""
    rollout_s: float
    """Seconds until the last result."""
    update_s: float
    """Seconds of fitness, gradients, optimizer and statistics."""

    @property
    def results(self) -> PopulationResults:
        """Returns, steps and flags of every episode of `population`."""
        return self.population.members

    @property
    def num_steps(self) -> int:
        """Environment steps of the generation's members."""
        return sum(int(each.members.steps.sum()) for each in (self.population, self.branches) if each is not None)

    @property
    def log(self) -> list[str]:
        """Return the log lines of the simulators."""
        return [line for each in (self.population, self.branches) if each is not None for line in each.results.log]

    @property
    def sources(self) -> tuple[tuple[Population, int], ...]:
        """The population that each level's fitness comes from, and the level's number in it."""
        first = [(self.population, i) for i in range(len(self.updates))]
        return tuple(first) if self.branches is None else (*first[:-1], (self.branches, 0))


def evolve(
    state: TrainState, settings: Settings, table: NoiseTable, backend: Backend, pool: ThreadPoolExecutor | None = None
) -> Generator[GenerationReport, None, None]:
    """Yield a report after every generation, for ever, from `state` on. `pool` shares the gradient's columns."""
    while True:  # line 1
        start = perf_counter()
        # lines 2 and 3: n roll-outs of policies perturbed by sigma * epsilon, for controller and primitive at once.
        population = roll_out(state, settings, table, backend)
        # Not in the paper: a primitive may be judged by intervals that branch off the states of these episodes.
        branches = roll_out_branches(state, settings, table, backend, population)
        rolled_out, results = perf_counter(), population.results
        novelty = advance_novelty(state.novelty, settings.novelty, results, settings.population_size)
        # lines 4 and 5: theta += alpha / n * sum(f * epsilon), each level by its own fitness.
        updates = population.update(state.levels, table, pool, novelty, settings.novelty_neighbours)
        levels = population.merge_statistics(update.level for update in updates)
        if branches is not None:
            updates = (*updates[:-1], *branches.update(levels[-1:], table, pool))
            levels = (*levels[:-1], *branches.merge_statistics([updates[-1].level]))
        state = TrainState(
            seed=state.seed,
            generation=state.generation + 1,
            env_steps=state.env_steps + sum(each.num_steps for each in (population, branches) if each is not None),
            levels=levels,
            novelty=novelty,
            running=next_running(results, settings.intervals) if population.is_branched else None,
        )
        yield GenerationReport(
            state=state,
            population=population,
            branches=branches,
            updates=updates,
            rollout_s=rolled_out - start,
            update_s=perf_counter() - rolled_out,
        )
