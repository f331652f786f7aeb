"""The contract between a run and a learning algorithm.

Training, evaluation, checkpoints, tables and videos use an algorithm only through this contract. A new one is
one class, registered with `register_algorithm`; `examples/random_search.py` is an example of 80 lines.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from shes.agents.agent import AgentDesign, FlatDesign
from shes.agents.mlp import MLP
from shes.backends.backend import Backend
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import CheckpointError, ShapeError
from shes.es.level import LevelParameters
from shes.es.noise import NoiseTable
from shes.rollout.worker import EpisodeSetup, WorkerPlan
from shes.settings import Settings
from shes.types import F64Array


@dataclass(frozen=True, kw_only=True)
class Problem(EpisodeSetup):
    """An environment to learn in, with the settings of the run."""

    name: str
    settings: Any
    noise_table_size: int
    num_threads: int = 1
    """Number of threads that the parent process may use."""

    def make_task(self, *, is_evaluation: bool = False) -> EpisodeBatch:
        """Return the environment for one episode. The caller closes it."""
        return self.env.make(1, self.evaluation if is_evaluation else self.training)

    def sample(self) -> EpisodeBatch:
        """Return the environment for one episode, closed; raise ShapeError if its observation has a wrong size."""
        task = self.make_task()
        task.reset(np.array([0]), [0])
        shape = task.observe().shape
        if shape != (1, task.observation_size):
            raise ShapeError(
                f"environment {self.name!r} must observe [N, {task.observation_size}], as many values as its "
                f"observation_spec names; for 1 episode it observed {shape}. Change observation_spec or observe()."
            )
        task.close()
        return task

    def flat_design(self, hidden: tuple[int, ...]) -> FlatDesign:
        """Return the design of an agent with a single policy without goals, with these hidden layers."""
        task = self.sample()
        policy = MLP(task.observation_size, hidden, task.action_size)
        return FlatDesign(networks={"policy": policy}, control_limit=task.control_limit)


class LevelTransfer(ABC):
    """The transfer of a level between runs of algorithms that have this object in `Algorithm.transfers`.

    A setting with the name of the level gives the other run, as RUN or RUN@CHECKPOINT.
    """

    trained_by: ClassVar[str]
    """Runs that train such a level, for error messages."""
    advice: ClassVar[str]
    """Advice in the error message about a level that does not fit."""
    suggested: ClassVar[tuple[str, ...]] = ()
    """Settings that come with the level unless another value is asked for."""

    @abstractmethod
    def settings(self, source: Any, level_names: tuple[str, ...]) -> dict[str, Any]:
        """Return the settings that a level of a run with settings `source` brings to a run of levels `level_names`."""

    @abstractmethod
    def interface(self, problem: Problem) -> str:
        """Return the inputs and outputs of the level in words. Both runs must have the same."""

    def move(self, name: str, source: Any, state: Any) -> Any:
        """Return `state` with the parameters and statistics of level `name` in state `source`. Both have `levels`."""
        theirs = next(level for level in source.levels if level.name == name)
        levels = tuple(
            replace(level, theta=theirs.theta, statistics=theirs.statistics) if level.name == name else level
            for level in state.levels
        )
        return replace(state, levels=levels)


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Values by the name of a setting. Those of settings that a run does not have are ignored."""

    values: Mapping[str, Any] = field(default_factory=dict)
    """Values in every environment."""
    per_environment: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Further values by the name of the environment."""

    def of(self, env: str) -> dict[str, Any]:
        """Return the values in environment `env`."""
        return {**self.values, **self.per_environment.get(env, {})}


PRESETS: Mapping[str, Preset] = {
    # Learns visibly on a few cores: the default settings.
    "laptop": Preset(
        values={"evaluation_horizon": 500},
        per_environment={
            # The point reaches a goal in a second, not in two and a half, and its episodes cost little.
            "point-gather": {"horizon": 500, "generations": 80},
            # Cells of the point's maze are 1 m wide, those of the ant's 4 m.
            "robotics-point-maze": {"goal_distance": 1.0},
        },
    ),
    # Takes seconds: a test that does not learn.
    "smoke": Preset(
        values={"generations": 3, "horizon": 50, "hidden": (16,), "evaluation_interval": 2, "evaluation_episodes": 4}
    ),
}
"""The presets of every algorithm."""


class AnyState(Protocol):
    """Attributes of every algorithm's state."""

    @property
    def seed(self) -> int:
        """Seed of all random numbers."""
        ...

    @property
    def generation(self) -> int:
        """Number of generations so far."""
        ...

    @property
    def env_steps(self) -> int:
        """Number of environment steps of training so far."""
        ...


@dataclass(frozen=True, kw_only=True)
class Explored:
    """Places and way that a search for a way to the target has found, for a map."""

    places: F64Array
    """Places that were reached [places, 2], in whole metres."""
    way: F64Array
    """Points of the way from the start to the target [W, 2] in metres; empty if none is known."""


StateT = TypeVar("StateT", bound=AnyState)


@dataclass(frozen=True, kw_only=True)
class Report(Generic[StateT]):
    """Result of one generation."""

    state: StateT
    columns: Mapping[str, Any]
    """Its row of `progress.csv`, after `generation`, `env_steps`, `wall_time_s` and `env_steps_per_s`.

    Every generation has the same columns. Columns that end in `_s` are times and may differ between runs of equal
    numbers. The progress line shows `X_return_mean` and `X_return_max`.
    """
    log: Sequence[str] = ()
    """Log messages, for example warnings of the simulator."""


class Algorithm(ABC, Generic[StateT]):
    """A learning algorithm for one problem. A run, an evaluation and an agent each make their own.

    The first sentence of a subclass's docstring is its description in the help of `--algorithm`.
    """

    level_names: ClassVar[tuple[str, ...]] = ("policy",)
    """Names of the levels of its agents. The level that acts every step comes last.

    A `controller` sets goals, a `primitive` reaches them, and a `policy` has no goals.
    """

    without_controller: ClassVar[type[Algorithm[Any]] | None] = None
    """The class that learns instead in environments that set the goals, such as Flagrun; None for this one."""

    sections: ClassVar[Mapping[str, type[Settings]]] = {}
    """Its settings: dataclasses by the name of their section. Each setting becomes a flag of `shes train` with help, an
    argument of `shes.train` and an entry of `config.json`. `problem.settings.SECTION.NAME` is its value."""

    presets: ClassVar[Mapping[str, Preset]] = {}
    """Its own values of presets, by name, which win over `shes.algorithms.contract.PRESETS`. A name that is not among
    those is a preset of its own; `--preset` then chooses the first algorithm that has it."""

    transfers: ClassVar[Mapping[str, LevelTransfer]] = {}
    """The levels that its runs may take from other runs, by name, and how."""

    packages: ClassVar[tuple[str, ...]] = ()
    """Distributions, in addition to NumPy and MuJoCo, on whose versions its numbers depend: a run records them."""

    learns_in_main_process: ClassVar[bool] = False
    """Whether it learns in the main process, so that workers only evaluate."""

    @staticmethod
    def check_installed(name: str) -> None:
        """Raise MissingExtraError unless what training needs is installed. `name` is the algorithm's, for messages."""

    @staticmethod
    def check(settings: Any) -> None:
        """Raise ConfigError for values of its settings that do not go together; `settings.SECTION.NAME` is a value."""

    @staticmethod
    def check_effects(settings: Any, asked: Mapping[str, Any]) -> None:
        """Raise ConfigError if a setting in `asked`, which the user gave, has no effect; see also `Needs`."""

    @staticmethod
    def warnings(settings: Any) -> Sequence[str]:  # noqa: ARG004 - a subclass reads them
        """Return warnings about the settings, which are logged at the start of a run."""
        return ()

    @staticmethod
    def population(settings: Any) -> tuple[int, int]:  # noqa: ARG004 - a subclass reads them
        """Return the most policies of a generation, and the most episodes of each, which must fit the memory."""
        return 0, 1

    def __init__(self, problem: Problem, design: AgentDesign) -> None:
        """Store `problem` and the `design` of the agents. A subclass is made from the problem alone.

        A subclass raises ConfigError here if it cannot learn in this problem, before the run folder is created.
        """
        self.problem = problem
        self.design = design
        """Networks and goal handling of its agents."""

    @cached_property
    def table(self) -> NoiseTable:
        """The shared noise table. Opened on first use, because an agent that only acts needs none."""
        return NoiseTable.open(self.problem.noise_table_size, max(self.design.dims))

    @abstractmethod
    def start(self, seed: int) -> StateT:
        """Return the state before the first generation. Random numbers derive from (seed, purpose, generation)."""

    @abstractmethod
    def run(self, state: StateT, backend: Backend) -> Generator[Report[StateT], None, None]:
        """Yield a report after every generation from `state` on, indefinitely. `backend` runs the episodes.

        Reports depend on `state` alone, so that a killed run continues from the last saved state.
        """

    @abstractmethod
    def to_arrays(self, state: StateT) -> dict[str, np.ndarray]:
        """Return `state` as named arrays without Python objects, including `seed`, `generation` and `env_steps`."""

    @abstractmethod
    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> StateT:
        """Return the state that `to_arrays` converted; raise KeyError or ValueError if it is not one."""

    @abstractmethod
    def parameters(self, state: StateT) -> tuple[LevelParameters, ...]:
        """Return the parameters and the normalisation of each level of an agent in `state`."""

    def without_training(self, state: StateT) -> StateT:
        """Return `state` without the data that only further training needs, as stored in a shipped agent."""
        return state

    def kept(self, state: StateT) -> StateT:
        """Return `state` as checkpoints other than `last` store it: all of it, unless it is large."""
        return state

    def explored(self, state: StateT) -> Explored | None:
        """Return what a search for a way has found by `state`; None without such a search."""
        return None

    @property
    def episodes_in_lockstep(self) -> int:
        """Number of episodes of a policy that share a matmul, in training and evaluation. It affects rounding."""
        return 1

    def plan(self) -> WorkerPlan:
        """Return the data that every worker receives once, at its start."""
        assert self.table.path is not None
        setup = {each.name: getattr(self.problem, each.name) for each in fields(EpisodeSetup)}
        return WorkerPlan(**setup, design=self.design, noise_table=self.table.path)


def check_arrays(arrays: Mapping[str, np.ndarray], expected: Mapping[str, np.ndarray]) -> None:
    """Raise CheckpointError unless `arrays` are finite, and have the names, types and shapes of `expected`.

    An axis that has the length 0 in `expected` may have any length.
    """
    faults = {"lacks": expected.keys() - arrays.keys(), "has": arrays.keys() - expected.keys()}
    if any(faults.values()):
        found = " and ".join(f"{verb} {', '.join(sorted(names))}" for verb, names in faults.items() if names)
        raise CheckpointError(f"is not of this run: it {found}. Put back the checkpoint of this run.")
    for name, array in arrays.items():
        own = expected[name]
        is_alike = array.dtype == own.dtype or array.dtype.kind == own.dtype.kind == "U"  # texts may be longer
        lengths = zip(array.shape, own.shape, strict=False)
        if not is_alike or array.ndim != own.ndim or any(allowed not in {0, length} for length, allowed in lengths):
            raise CheckpointError(
                f"holds {name} as {array.dtype} of shape {array.shape}, where this run has {own.dtype} of shape "
                f"{own.shape}. Put back the checkpoint of this run; if an older version made it, train anew."
            )
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise CheckpointError(f"holds NaN or infinity in {name}. Take an earlier checkpoint.")
