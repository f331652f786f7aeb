"""Algorithm 1 of the SHES paper: evolve a controller and a primitive together.

Source: S. Abramowitz and G. Nitschke, "Towards Run-time Efficient Hierarchical Reinforcement Learning", IEEE CEC 2022,
Algorithm 1 and sections II-A, II-E, II-F. `# line k` marks the lines of Algorithm 1. `theta`, `sigma`, `alpha` (the
learning rate), `n` (the population size) and the noise `epsilon` are its symbols. With a single level it is S-ES
(Salimans et al. 2017). Random numbers derive from (seed, purpose, generation), so they do not depend on the workers.
"""

from __future__ import annotations

from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from time import perf_counter

from shes.algorithms.evolution.populations import (
    Hyperparameters,
    Population,
    roll_out,
    roll_out_branches,
)
from shes.algorithms.evolution.way_search import explore
from shes.backends.backend import Backend
from shes.es.level import LevelUpdate, TrainState
from shes.es.noise import NoiseTable
from shes.hierarchy.intervals import next_running
from shes.hierarchy.results import PopulationResults


@dataclass(frozen=True, kw_only=True)
class GenerationReport:
    """Result of one generation."""

    state: TrainState
    population: Population
    """The members evaluated by whole episodes; the pairs, if a primitive alone is evaluated by intervals."""
    branches: Population | None
    """The pairs of a primitive that is evaluated by intervals under a controller."""
    updates: tuple[LevelUpdate, ...]
    rollout_s: float
    """Duration of the rollouts in seconds."""
    update_s: float
    """Duration of fitness, gradients, optimizer and statistics in seconds."""

    @property
    def populations(self) -> tuple[Population, ...]:
        """The population, and the branches if any."""
        return (self.population,) if self.branches is None else (self.population, self.branches)

    @property
    def results(self) -> PopulationResults:
        """Returns, steps and flags of every episode of `population`."""
        return self.population.results

    @property
    def num_steps(self) -> int:
        """Number of environment steps of the generation's members."""
        return sum(int(each.results.steps.sum()) for each in self.populations)

    @property
    def log(self) -> list[str]:
        """Log messages of the simulators."""
        return [line for each in self.populations for line in each.results.log]

    @property
    def sources(self) -> tuple[tuple[Population, int], ...]:
        """For each level the population that its fitness comes from, and the level's index in that population."""
        sources = [(self.population, i) for i in range(len(self.updates))]
        return tuple(sources) if self.branches is None else (*sources[:-1], (self.branches, 0))


def evolve(
    state: TrainState,
    hyperparameters: Hyperparameters,
    table: NoiseTable,
    backend: Backend,
    pool: ThreadPoolExecutor | None = None,
) -> Generator[GenerationReport, None, None]:
    """Yield a report after every generation from `state` on, indefinitely. `pool` computes gradients in parallel."""
    while True:  # line 1
        start = perf_counter()
        # Not in the paper: a search by the mean primitive for a way to the target, which then guides the controllers.
        state = explore(state, hyperparameters.search, backend)
        # lines 2 and 3: n rollouts of policies perturbed by sigma * epsilon, for controller and primitive at once.
        population = roll_out(state, hyperparameters, table, backend)
        # Not in the paper: a primitive may be evaluated by intervals that branch off the states of these episodes.
        branches = roll_out_branches(state, hyperparameters, table, backend, population)
        rolled_out, results = perf_counter(), population.results
        # lines 4 and 5: theta += alpha / n * sum(f * epsilon), each level by its own fitness.
        updates = population.update(state.levels, table, pool)
        levels = population.merge_statistics(update.level for update in updates)
        if branches is not None:
            updates = (*updates[:-1], *branches.update(levels[-1:], table, pool))
            levels = (*levels[:-1], *branches.merge_statistics([updates[-1].level]))
        state = TrainState(
            seed=state.seed,
            generation=state.generation + 1,
            env_steps=state.env_steps + population.num_steps + (0 if branches is None else branches.num_steps),
            levels=levels,
            archive=state.archive,
            running=next_running(results, hyperparameters.intervals) if population.is_branched else None,
        )
        yield GenerationReport(
            state=state,
            population=population,
            branches=branches,
            updates=updates,
            rollout_s=rolled_out - start,
            update_s=perf_counter() - rolled_out,
        )
