"""The contract between a run and a learning algorithm.

Training, evaluation, checkpoints, tables, videos and studies know a learner by this contract alone. A new one is one
class, known by `register_algorithm`; `examples/random_search.py` is one of 80 lines.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from shes.algorithms.problem import Problem
from shes.algorithms.worker import WorkerPlan
from shes.backends.backend import Backend
from shes.es.level import LevelParameters
from shes.es.noise import NoiseTable
from shes.hierarchy.agent import AgentDesign
from shes.settings import Settings

__all__ = ["Algorithm", "AnyState", "Report"]


class AnyState(Protocol):
    """Attributes that the state of every algorithm has."""

    @property
    def seed(self) -> int:
        """Seed of every draw."""
        ...

    @property
    def generation(self) -> int:
        """Generations made so far."""
        ...

    @property
    def env_steps(self) -> int:
        """Environment steps of training so far."""
        ...


StateT = TypeVar("StateT", bound=AnyState)


@dataclass(frozen=True, kw_only=True)
class Report(Generic[StateT]):
    """One generation of a learner."""

    state: StateT
    """The state after it."""
    columns: Mapping[str, Any]
    """Its row of `progress.csv`, by column, after `generation`, `env_steps`, `wall_time_s` and `env_steps_per_s`.

    The same columns in every generation. Those that end in `_s` are times, which no two runs share. The progress line
    shows `X_return_mean` beside `X_return_max`.
    """
    log: Sequence[str] = ()
    """Lines for the log, such as warnings of the simulator."""


class Algorithm(ABC, Generic[StateT]):
    """A learner. Made once for every run, evaluation or agent, from the problem."""

    level_names: ClassVar[tuple[str, ...]] = ("policy",)
    """Names of the levels of its agents; the level that acts every step comes last.

    The names mean something: `controller` sets goals, `primitive` reaches them, `policy` knows none.
    """

    rooms: ClassVar[Mapping[str, type[Settings]]] = {}
    """Its settings: rooms, dataclasses by name. Each setting becomes a flag of `shes train`, a line of its help, an
    argument of `shes.train` and an entry of `config.json`; `problem.settings.ROOM.NAME` is its value."""

    def __init__(self, problem: Problem, design: AgentDesign) -> None:
        """Take `problem`, and the `design` of this learner's agents. A subclass is made from the problem alone.

        What this learner cannot do with the problem is refused here: a run has no folder yet.
        """
        self.problem = problem
        self.design = design
        """Networks and goal handling of its agents."""

    @cached_property
    def table(self) -> NoiseTable:
        """The shared table of normals, from which workers draw perturbations by their place.

        Made when it is first asked for: an agent that only acts needs none.
        """
        return self.problem.noise_table(self.design)

    @abstractmethod
    def start(self, seed: int) -> StateT:
        """Return the state before the first generation. Every draw comes from (seed, purpose, generation)."""

    @abstractmethod
    def run(self, state: StateT, backend: Backend) -> Generator[Report[StateT], None, None]:
        """Yield a report after every generation, for ever, from `state` on, with work done by `backend`.

        What it yields depends on `state` alone: a run that was killed goes on from the last state that was saved.
        """

    @abstractmethod
    def to_arrays(self, state: StateT) -> dict[str, np.ndarray]:
        """Return `state` as arrays by name, without Python objects, `seed`, `generation` and `env_steps` among them."""

    @abstractmethod
    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> StateT:
        """Return the state that `to_arrays` took apart; a missing name is a KeyError, a wrong value a ValueError."""

    @abstractmethod
    def parameters(self, state: StateT) -> tuple[LevelParameters, ...]:
        """Return what an agent of `state` acts with, level by level: parameters and normalisation."""

    def without_training(self, state: StateT) -> StateT:
        """Return `state` without what only going on with the training needs: as a shipped agent keeps it."""
        return state

    @property
    def episodes_in_lockstep(self) -> int:
        """Episodes of a policy that share a matmul, in evaluation as in training: part of how it rounds."""
        return 1

    def plan(self) -> WorkerPlan:
        """Return what every worker needs to know once."""
        return self.problem.plan(self.design)
