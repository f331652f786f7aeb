"""Evolution strategies as algorithms of a run: SHES, S-ES, and the primitive alone."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from shes.agents.agent import AgentDesign
from shes.algorithms.contract import Algorithm, Explored, LevelTransfer, Preset, Report
from shes.algorithms.problem import Problem
from shes.backends.backend import Backend
from shes.errors import CheckpointError
from shes.es.level import LevelParameters
from shes.evolution.algorithm import evolve
from shes.evolution.checks import check_effects, check_together, warnings
from shes.evolution.columns import columns
from shes.evolution.designs import (
    branch_design,
    flat_design,
    goal_design,
)
from shes.evolution.evolution_settings import PRIMITIVE_SECTIONS, SES_SECTIONS, SHES_SECTIONS
from shes.evolution.hyperparameters import make_hyperparameters, make_state, population, steps_per_generation
from shes.evolution.level_transfers import PRIMITIVE_TRANSFER, SHES_TRANSFERS
from shes.evolution.presets import SES_PRESETS, SHES_PRESETS
from shes.evolution.state import TrainState, check_arrays, check_headers, from_arrays, to_arrays
from shes.rollout.worker import WorkerPlan
from shes.settings import Settings
from shes.types import ArrayHeader

_MAX_THREADS = 8  # of the gradient; with more, memory bandwidth is the limit


class EvolutionAlgorithm(Algorithm[TrainState]):
    """Algorithm 1 of the SHES paper, or S-ES with one level."""

    make_design: ClassVar[Callable[[Problem], AgentDesign]]
    """Returns the design of its agents."""

    check = staticmethod(check_together)
    check_effects = staticmethod(check_effects)
    steps_per_generation = staticmethod(steps_per_generation)
    population = staticmethod(population)

    def __init__(self, problem: Problem) -> None:
        """Create the agents' design and the hyperparameters.

        Raises:
            ConfigError: The settings do not fit the environment.
            ShapeError: The observation does not have the size of the observation spec.
        """
        super().__init__(problem, type(self).make_design(problem))
        self.hyperparameters = make_hyperparameters(problem)

    def start(self, seed: int) -> TrainState:
        """Return the state before the first generation, without transferred parameters."""
        state, search = make_state(self.problem.settings, self.design, seed), self.hyperparameters.search
        return state if search is None else replace(state, archive=search.start)

    def run(self, state: TrainState, backend: Backend) -> Generator[Report[TrainState], None, None]:
        """Yield a report after every generation from `state` on, indefinitely."""
        table, threads = self.table.on(self.problem.xp), min(self.problem.num_threads, _MAX_THREADS)
        with ThreadPoolExecutor(threads, thread_name_prefix="shes-gradient") as pool:
            archive = state.archive
            for report in evolve(state, self.hyperparameters, table, backend, pool):
                found = report.state.archive
                news = [] if found is None or archive is None else found.news(archive)
                archive = found
                yield Report(state=report.state, columns=columns(report), log=[*report.log, *news])

    def to_arrays(self, state: TrainState) -> dict[str, np.ndarray]:
        """Return `state` as named arrays."""
        return to_arrays(state)

    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> TrainState:
        """Return the state that `to_arrays` converted; raise CheckpointError unless it is one of this run."""
        levels = [str(name) for name in np.atleast_1d(arrays["levels"])]
        self._check_levels(levels, has_all=levels == list(self.level_names))
        check_arrays(arrays, self.start(0))
        return from_arrays(arrays)

    def check_headers(self, headers: Mapping[str, ArrayHeader]) -> None:
        """Raise CheckpointError unless names, shapes and types of arrays are those of a state of this run."""
        levels = [name.removesuffix("/theta") for name in headers if name.endswith("/theta")]
        self._check_levels(levels, has_all=set(levels) <= set(self.level_names))
        check_headers(headers, self.start(0))
        self._check_running(headers)

    def _check_running(self, headers: Mapping[str, ArrayHeader]) -> None:
        """Raise CheckpointError unless there is a state of this robot for each pair, if any episodes are running."""
        intervals = self.hyperparameters.intervals
        if intervals is None or "running/states" not in headers:
            return
        task = self.problem.make_task()
        size = task.states(np.array([0])).shape[1]
        task.close()
        expected = {"running/states": (intervals.num_pairs, size), "running/steps": (intervals.num_pairs,)}
        for name, shape in expected.items():
            if headers[name].shape != shape:
                raise CheckpointError(
                    f"holds {name} of shape {headers[name].shape}, where this run has {shape}. "
                    "Put back the checkpoint of this run."
                )

    def _check_levels(self, levels: Sequence[str], *, has_all: bool) -> None:
        """Raise CheckpointError unless this run has all `levels` of a checkpoint."""
        if not has_all:
            raise CheckpointError(
                f"has the levels {', '.join(levels)}, but a run of {self.problem.name} has "
                f"{', '.join(self.level_names)} now. Use the version that wrote it (config.json of the run names it)."
            )

    def parameters(self, state: TrainState) -> tuple[LevelParameters, ...]:
        """Return the parameters and the normalisation of the mean policies."""
        return LevelParameters.of_all(state.levels)

    def explored(self, state: TrainState) -> Explored | None:
        """Return the places that the search for a way has reached, and the way; None without a search."""
        archive = state.archive
        if archive is None:
            return None
        return Explored(
            places=np.unique(archive.positions[archive.nodes, :2].round(), axis=0),
            way=archive.way[:, :2],
        )

    def without_training(self, state: TrainState) -> TrainState:
        """Return `state` without running episodes and states of the search, and with reset optimizers."""
        levels = tuple(
            replace(level, optimizer=rule.optimizer.start(len(level.theta)))
            for level, rule in zip(state.levels, self.hyperparameters.updates, strict=True)
        )
        archive = None if state.archive is None else state.archive.over()
        return replace(state, levels=levels, running=None, archive=archive)

    def warnings(self) -> list[str]:
        """Return warnings about branches longer than episodes, and schedules that do not end."""
        return warnings(self.problem.settings)

    @property
    def episodes_in_lockstep(self) -> int:
        """Number of episodes of a policy that share a matmul: its episodes per generation."""
        return self.problem.settings.evolution.episodes_per_policy

    def plan(self) -> WorkerPlan:
        """Return the data that every worker receives once, at its start."""
        return self.problem.plan(self.design, branch_design(self.problem.settings, self.design))


class PrimitiveES(EvolutionAlgorithm):
    """Evolves a primitive alone, in environments that set the goals. Source: SHES paper, section II-D."""

    level_names: ClassVar[tuple[str, ...]] = ("primitive",)
    sections: ClassVar[Mapping[str, type[Settings]]] = PRIMITIVE_SECTIONS
    presets: ClassVar[Mapping[str, Preset]] = SHES_PRESETS
    transfers: ClassVar[Mapping[str, LevelTransfer]] = PRIMITIVE_TRANSFER
    make_design = staticmethod(goal_design)


class SHES(EvolutionAlgorithm):
    """Evolves controller and primitive. Source: SHES paper."""

    level_names: ClassVar[tuple[str, ...]] = ("controller", "primitive")
    without_controller: ClassVar[type[Algorithm[Any]] | None] = PrimitiveES
    sections: ClassVar[Mapping[str, type[Settings]]] = SHES_SECTIONS
    presets: ClassVar[Mapping[str, Preset]] = SHES_PRESETS
    transfers: ClassVar[Mapping[str, LevelTransfer]] = SHES_TRANSFERS
    make_design = staticmethod(goal_design)


class SES(EvolutionAlgorithm):
    """Evolves one policy without goals, S-ES. Source: Salimans et al. 2017."""

    level_names: ClassVar[tuple[str, ...]] = ("policy",)
    sections: ClassVar[Mapping[str, type[Settings]]] = SES_SECTIONS
    presets: ClassVar[Mapping[str, Preset]] = SES_PRESETS
    make_design = staticmethod(flat_design)
