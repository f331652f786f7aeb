"""Evolution strategies as algorithms of a run: SHES, S-ES, and the primitive alone.

`docs/reference/columns.md` explains the columns of their tables.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from shes.agents.agent import AgentDesign
from shes.algorithms.contract import Algorithm, Explored, LevelTransfer, Preset, Problem, Report, check_arrays
from shes.backends.backend import Backend
from shes.es.level import LevelParameters, LevelState, LevelUpdate, select_fitness
from shes.evolution import hyperparameters
from shes.evolution.algorithm import GenerationReport, evolve
from shes.evolution.designs import PRIMITIVE_TRANSFER, SHES_TRANSFERS, branch_design, flat_design, goal_design
from shes.evolution.estimates import Population
from shes.evolution.evolution_settings import PRIMITIVE_SECTIONS, SES_PRESETS, SES_SECTIONS, SHES_PRESETS, SHES_SECTIONS
from shes.evolution.state import TrainState, arrays_like, from_arrays, to_arrays
from shes.rollout.episodes import PARTS
from shes.rollout.worker import WorkerPlan
from shes.settings import Settings
from shes.sim.warp_device import WarpDevice
from shes.streams import Purpose, stream

_MAX_THREADS = 8  # of the gradient; with more, memory bandwidth is the limit


class EvolutionAlgorithm(Algorithm[TrainState]):
    """Algorithm 1 of the SHES paper, or S-ES with one level."""

    make_design: ClassVar[Callable[[Problem], AgentDesign]]
    """Returns the design of its agents."""

    check = staticmethod(hyperparameters.check_together)
    check_effects = staticmethod(hyperparameters.check_effects)
    population = staticmethod(hyperparameters.population)
    warnings = staticmethod(hyperparameters.warnings)

    def __init__(self, problem: Problem) -> None:
        """Create design and hyperparameters; raise ConfigError if the settings do not fit the environment."""
        super().__init__(problem, type(self).make_design(problem))
        self.hyperparameters = hyperparameters.make_hyperparameters(problem)

    def start(self, seed: int) -> TrainState:
        """Return the state before the first generation, without transferred parameters."""
        networks, search, levels = self.problem.settings.networks, self.hyperparameters.search, list[LevelState]()
        parts = zip(self.design.networks.items(), self.hyperparameters.updates, strict=True)
        for number, ((name, policy), rule) in enumerate(parts):
            rng = stream(seed, Purpose.INITIAL_PARAMETERS, number)
            theta = policy.initial(rng, networks.biases, networks.output_weights)
            levels.append(LevelState.start(name, theta, rule.optimizer, policy.sizes[0]))
        return TrainState(seed=seed, levels=tuple(levels), archive=None if search is None else search.start)

    def run(self, state: TrainState, backend: Backend) -> Generator[Report[TrainState], None, None]:
        """Yield a report after every generation from `state` on, indefinitely."""
        device, threads = self.problem.device, min(self.problem.num_threads, _MAX_THREADS)
        table = self.table if device == "cpu" else self.table.on(WarpDevice(device).xp)
        with ThreadPoolExecutor(threads, thread_name_prefix="shes-gradient") as pool:
            for report in evolve(state, self.hyperparameters, table, backend, pool):
                before, archive, state = state.archive, report.state.archive, report.state
                log = [line for each in report.populations for line in each.results.log]
                if archive is not None and before is not None:
                    log += archive.news(before)
                yield Report(state=report.state, columns=columns(report), log=log)

    def to_arrays(self, state: TrainState) -> dict[str, np.ndarray]:
        """Return `state` as named arrays."""
        return to_arrays(state)

    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> TrainState:
        """Return the state that `to_arrays` converted; raise CheckpointError unless it is one of this run."""
        check_arrays(arrays, arrays_like(arrays, self.start(0)))
        return from_arrays(arrays)

    def parameters(self, state: TrainState) -> tuple[LevelParameters, ...]:
        """Return the parameters and the normalisation of the mean policies."""
        return tuple(LevelParameters.of(level.theta, level.statistics) for level in state.levels)

    def explored(self, state: TrainState) -> Explored | None:
        """Return the places that the search for a way has reached, and the way; None without a search."""
        archive = state.archive
        if archive is None:
            return None
        places = np.unique(archive.positions[archive.nodes, :2].round(), axis=0)
        return Explored(places=places, way=archive.way[:, :2])

    def without_training(self, state: TrainState) -> TrainState:
        """Return `state` without running episodes and states of the search, and with reset optimizers."""
        levels = tuple(
            replace(level, optimizer=rule.optimizer.start(len(level.theta)))
            for level, rule in zip(state.levels, self.hyperparameters.updates, strict=True)
        )
        archive = state.archive
        archive = archive and replace(archive, states=archive.states[:0], starts=archive.starts[:0])
        return replace(state, levels=levels, running=None, archive=archive)

    @property
    def episodes_in_lockstep(self) -> int:
        """Number of episodes of a policy that share a matmul: its episodes per generation."""
        return self.hyperparameters.evolution.episodes_per_policy

    def plan(self) -> WorkerPlan:
        """Return the data that every worker receives once, at its start."""
        return replace(super().plan(), branch_design=branch_design(self.problem.settings, self.design))


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


def columns(report: GenerationReport) -> dict[str, Any]:
    """Return the row of `progress.csv`. Times of `PARTS` are summed over the workers; what does not exist is NaN."""
    episodes, *pairs = report.populations
    results, levels, archive = episodes.results, report.state.levels, report.state.archive
    row: dict[str, Any] = {}
    for level, (source, i) in zip(levels, report.sources, strict=True):
        fitness = source.results.fitness[i]
        row |= {f"{level.name}_return_mean": float(fitness.mean()), f"{level.name}_return_max": float(fitness.max())}
    row |= {
        "score_mean": float(results.score.mean()),
        "success_rate": float(results.success.mean()),
        "episode_steps_mean": float(results.steps.mean()),
        "terminated_rate": float(results.has_terminated.mean()),
        "diverged_rate": float(results.has_diverged.mean()),
        "diverged_episodes": int(results.has_diverged.sum()),
        "episodes_per_policy": results.score.shape[1],
        "sigma": episodes.generation.sigma,
        "learning_rate": episodes.learning_rate,
    }
    if any(level.name == "primitive" for level in levels):
        row["goals_reached_mean"] = float(results.goals_reached.mean())
    for level, update, source in zip(levels, report.updates, report.sources, strict=True):
        row |= {f"{level.name}_{name}": value for name, value in _of_update(level, update, *source).items()}
    if archive is not None:
        way_steps = archive.way_steps or float("nan")
        row |= {"exploration_steps": archive.env_steps, "cells": len(archive.cells), "way_steps": way_steps}
    for each in pairs:
        row |= {
            "branch_steps_mean": float(each.results.steps.mean()),
            "branch_terminated_rate": float(each.results.has_terminated.mean()),
            "primitive_sigma": each.generation.sigma,
            "primitive_learning_rate": each.learning_rate,
        }
    row |= {"rollout_s": round(report.rollout_s, 4), "update_s": round(report.update_s, 4)}
    seconds = np.sum([each.results.seconds for each in report.populations], axis=0)
    return row | {f"{part}_s": round(float(s), 4) for part, s in zip(PARTS, seconds, strict=True)}


def _of_update(level: LevelState, update: LevelUpdate, source: Population, i: int) -> dict[str, float]:
    """Return the columns of the update of a level, which has the place `i` in the population `source`."""
    signs = source.signs[:, :, i]
    fitness = select_fitness(source.results.fitness[i], signs)
    counts = np.unique(fitness, return_counts=True)[1]
    starts = np.sort(source.noise_index[i][signs.any(axis=1)])
    touches = np.diff(starts) < len(level.theta)
    overlapping = np.concatenate([touches, [False]]) | np.concatenate([[False], touches])
    return {
        "noise_distinct": len(np.unique(starts)),
        "noise_overlapping": int(overlapping.sum()),
        "rank_ties": float(counts[counts > 1].sum() / len(fitness)) if len(fitness) else float("nan"),
        "gradient_norm": update.gradient_norm,
        "halves_cosine": update.halves_cosine,
        "update_ratio": update.update_ratio,
        "theta_norm": float(np.linalg.norm(level.theta.astype(np.float64))),
    }
