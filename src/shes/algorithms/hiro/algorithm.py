"""HIRO and flat TD3 as algorithms of a run.

A generation is whole episodes, of at least `generation_steps` environment steps, so that nothing of an episode outlives
it. A step of experience is followed by the updates that are due for it: one of the acting level per environment step,
and one of the controller per `controller_update_interval` steps, whatever the number of environments. The first
generation acts at random and updates nothing.

Source: Nachum et al. 2018, Algorithm 1; Fujimoto et al. 2018.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from shes.algorithms.contract import Algorithm, Report
from shes.algorithms.hiro.agent import HiroDesign
from shes.algorithms.hiro.collector import Actor, Collector
from shes.algorithms.hiro.columns import columns
from shes.algorithms.hiro.designs import (
    check_memory,
    check_num_envs,
    check_restoring,
    flat_design,
    flat_levels,
    hiro_design,
    hiro_levels,
)
from shes.algorithms.hiro.hiro_collector import HiroCollector
from shes.algorithms.hiro.levels import LearnerState, Level, within
from shes.algorithms.hiro.presets import HIRO_PRESETS
from shes.algorithms.hiro.sections import HIRO_SECTIONS, TD3_SECTIONS
from shes.algorithms.presets import Preset
from shes.algorithms.problem import Problem
from shes.algorithms.worker import WorkerPlan
from shes.backends.backend import Backend
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import CheckpointError, DivergenceError, MissingExtraError
from shes.es.level import LevelParameters
from shes.es.streams import Purpose, stream
from shes.hierarchy.agent import AgentDesign
from shes.settings import Settings
from shes.types import ArrayHeader


@dataclass(frozen=True, kw_only=True)
class TD3State:
    """State of a run between generations."""

    seed: int
    generation: int
    env_steps: int
    learners: tuple[LearnerState, ...]
    """State of each level, controller first."""


class TD3(Algorithm[TD3State]):
    """Trains one policy without goals by gradients. Source: Fujimoto et al. 2018."""

    sections: ClassVar[Mapping[str, type[Settings]]] = TD3_SECTIONS
    presets: ClassVar[Mapping[str, Preset]] = HIRO_PRESETS
    packages: ClassVar[tuple[str, ...]] = ("jax", "optax")
    shares_memory: ClassVar[bool] = True  # that of the replay buffers
    make_design: ClassVar[Callable[[Problem], AgentDesign]] = staticmethod(flat_design)
    """Returns the design of its agents."""
    make_levels: ClassVar[Callable[[Problem, Any], tuple[Level, ...]]] = staticmethod(flat_levels)
    """Returns what is fixed about its levels."""

    @staticmethod
    def steps_per_generation(settings: Any) -> int:
        """Return the environment steps of a generation, without the rest of the episodes that are then running."""
        return settings.learner.generation_steps

    @staticmethod
    def check_installed(name: str) -> None:
        """Check that JAX and Optax are installed; see the base class."""
        import_learning(name)

    def __init__(self, problem: Problem) -> None:
        """Create the design of the agents and the levels.

        Raises:
            ConfigError: It cannot learn in this environment.
            ShapeError: The observation does not have the size of the observation spec.
        """
        check_num_envs(problem)
        super().__init__(problem, type(self).make_design(problem))
        self.settings = problem.settings.learner
        self.levels = type(self).make_levels(problem, self.design)

    def start(self, seed: int) -> TD3State:
        """Return the state before the first generation.

        Raises:
            MissingExtraError: JAX or Optax is not installed.
            ConfigError: The replay buffers do not fit the memory.
        """
        import_learning(self.problem.settings.run.algorithm)
        check_memory(self.levels, self.settings.replay_size)
        rngs = (stream(seed, Purpose.INITIAL_PARAMETERS, 0, number) for number in range(len(self.levels)))
        learners = tuple(level.start(rng) for level, rng in zip(self.levels, rngs, strict=True))
        return TD3State(seed=seed, generation=0, env_steps=0, learners=learners)

    def run(self, state: TD3State, backend: Backend) -> Generator[Report[TD3State], None, None]:
        """Yield a report after every generation from `state` on, indefinitely. `backend` is not used.

        Raises:
            MissingExtraError: JAX or Optax is not installed.
            DivergenceError: A loss or a parameter is NaN or infinite.
        """
        batch = self.problem.env.make(self.settings.num_envs, self.problem.training)
        try:
            actors = {level.name: Actor(level, self.design.input_clip) for level in self.levels}
            collector = self.make_collector(batch, actors)
            while True:
                report = self._generation(state, collector, actors)
                state = report.state
                yield report
        finally:
            batch.close()

    def _generation(self, state: TD3State, collector: Collector, actors: Mapping[str, Actor]) -> Report[TD3State]:
        """Return the report of the generation that follows `state`."""
        own, start = self.settings, perf_counter()
        learners = self.make_learners(state)
        is_random = state.env_steps < own.warmup_steps
        num_steps = own.warmup_steps - state.env_steps if is_random else own.generation_steps
        exploring, drawing = (
            stream(state.seed, purpose, state.generation) for purpose in (Purpose.EXPLORATION, Purpose.REPLAY)
        )
        for name, actor in actors.items():
            actor.is_random = is_random
            actor.use(learners[name].parameters)
        env_steps = state.env_steps
        for transitions in collector.run(num_steps, _episode_seeds(state), exploring):
            for name, rows in transitions.items():
                learners[name].add(rows)
            before, env_steps = env_steps, state.env_steps + collector.summary.num_steps
            for name, count in () if is_random else self.updates_due(before, env_steps):
                if learners[name].can_learn:
                    learners[name].update(count, drawing)
                    parameters = learners[name].parameters
                    if not np.isfinite(parameters.theta).all():
                        raise _diverged(name, learners[name].num_updates)
                    actors[name].use(parameters)
        finished = {name: learner.finish(normalises=own.normalise_inputs) for name, learner in learners.items()}
        for name, (level, losses) in finished.items():
            _check_finite(name, level, losses)
        state = TD3State(
            seed=state.seed,
            generation=state.generation + 1,
            env_steps=env_steps,
            learners=tuple(level for level, _ in finished.values()),
        )
        row = columns(finished, collector.summary, perf_counter() - start)
        return Report(state=state, columns=row)

    def make_collector(self, batch: EpisodeBatch, actors: Mapping[str, Actor]) -> Collector:
        """Return the collector of experience in `batch`."""
        return Collector(batch, actors, self.problem.horizon, **self._rewards())

    def make_learners(self, state: TD3State) -> dict[str, Any]:
        """Return the learner of each level by name."""
        learning = import_learning(self.problem.settings.run.algorithm)
        (level,), (own,) = self.levels, state.learners
        return {level.name: learning.LevelLearner(level, own, *self._learning())}

    def _rewards(self) -> dict[str, Any]:
        """Return the collector's arguments for rewards and terminal states, by name."""
        return {"bootstraps": self.settings.bootstrap_terminal, "reward_scale": self.settings.reward_scale}

    def _learning(self) -> tuple[float, int, float]:
        """Return the discount, the batch size and the clip of a learner."""
        return self.settings.discount, self.settings.batch_size, self.design.input_clip

    def updates_due(self, before: int, now: int) -> Iterator[tuple[str, int]]:
        """Yield the level and the number of the updates that are due for the environment steps `before` to `now`."""
        interval = self.settings.update_interval
        for _ in range(now // interval - before // interval):
            yield self.levels[-1].name, interval

    def to_arrays(self, state: TD3State) -> dict[str, np.ndarray]:
        """Return `state` as named arrays. Those of the replay buffers are views."""
        counts = {name: np.array(getattr(state, name)) for name in _COUNTS}
        levels = zip(self.level_names, state.learners, strict=True)
        return counts | {f"{name}/{key}": array for name, own in levels for key, array in own.to_arrays().items()}

    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> TD3State:
        """Return the state that `to_arrays` converted."""
        learners = tuple(level.from_arrays(within(level.name, arrays)) for level in self.levels)
        return TD3State(**{name: int(arrays[name]) for name in _COUNTS}, learners=learners)

    def check_headers(self, headers: Mapping[str, ArrayHeader]) -> None:
        """Raise CheckpointError unless names, shapes and types of arrays are those of a state of this run, and fit."""
        try:
            for level in self.levels:
                level.check(within(level.name, headers))
        except (KeyError, ValueError) as error:
            fault = f"lacks {error.args[0]}" if isinstance(error, KeyError) else str(error)
            raise CheckpointError(f"is not of this run: {fault}. Put back the checkpoint of this run.") from error
        check_restoring(headers)

    def parameters(self, state: TD3State) -> tuple[LevelParameters, ...]:
        """Return the parameters and the normalisation of the actors."""
        return tuple(level.parameters for level in state.learners)

    def without_training(self, state: TD3State) -> TD3State:
        """Return `state` with empty replay buffers."""
        return replace(state, learners=tuple(level.without_replay() for level in state.learners))

    def kept(self, state: TD3State) -> TD3State:
        """Return `state` with empty replay buffers, which `last` alone holds."""
        return self.without_training(state)

    def plan(self) -> WorkerPlan:
        """Return the data that every worker receives once. The noise table is small, because nothing reads it."""
        return replace(self.problem, noise_table_size=2 * max(self.design.dims)).plan(self.design)


class HIRO(TD3):
    """Trains controller and primitive by gradients. Source: Nachum et al. 2018.

    Two levels of TD3 learn from one stream of experience, with the off-policy correction.
    """

    level_names: ClassVar[tuple[str, ...]] = ("controller", "primitive")
    sections: ClassVar[Mapping[str, type[Settings]]] = HIRO_SECTIONS
    make_design = staticmethod(hiro_design)
    make_levels = staticmethod(hiro_levels)
    design: HiroDesign

    def make_collector(self, batch: EpisodeBatch, actors: Mapping[str, Actor]) -> Collector:
        """Return the collector of experience in `batch`."""
        return HiroCollector(batch, actors, self.problem.horizon, self.design, **self._rewards())

    def make_learners(self, state: TD3State) -> dict[str, Any]:
        """Return the learner of each level by name."""
        learning, goals = import_learning(self.problem.settings.run.algorithm), self.problem.settings.goals
        upper, lower = zip(self.levels, state.learners, strict=True)
        primitive = learning.LevelLearner(*lower, *self._learning())
        controller = learning.ControllerLearner(*upper, *self._learning(), primitive, goals.goal_candidates)
        return {"controller": controller, "primitive": primitive}

    def updates_due(self, before: int, now: int) -> Iterator[tuple[str, int]]:
        """Yield the level and the number of the updates that are due for the environment steps `before` to `now`."""
        yield from super().updates_due(before, now)
        interval = self.problem.settings.goals.controller_update_interval
        for _ in range(now // interval - before // interval):
            yield "controller", 1


_COUNTS = ("seed", "generation", "env_steps")


def import_learning(algorithm: str) -> Any:
    """Return the module that learns with JAX; raise MissingExtraError if JAX or Optax is not installed."""
    try:
        return importlib.import_module("shes.algorithms.hiro.level_learner")
    except ImportError as error:
        raise MissingExtraError(
            f"--algorithm {algorithm} needs JAX and Optax ({error}). Install them: pip install 'shes[hiro]'."
        ) from error


def _episode_seeds(state: TD3State) -> Iterator[int]:
    """Yield the seeds of the episodes of the generation that follows `state`."""
    rng = stream(state.seed, Purpose.TRAINING_EPISODES, state.generation)
    while True:
        yield int(rng.integers(0, 2**63))


def _check_finite(name: str, level: LearnerState, losses: Mapping[str, float]) -> None:
    """Raise DivergenceError if a loss or a parameter of a level is NaN or infinite."""
    # A generation that makes no update of a network has no loss.
    has_nan = level.num_updates and np.isinf(losses["critic_loss"])
    if has_nan or not all(np.isfinite(array).all() for array in level.learner.values()):
        raise _diverged(name, level.num_updates)


def _diverged(name: str, num_updates: int) -> DivergenceError:
    return DivergenceError(
        f"the networks of the {name} have diverged after {num_updates:,} updates (NaN or infinity). Everything up to "
        "the last checkpoint is kept. Start another run with a lower --critic-learning-rate, --actor-learning-rate or "
        "--reward-scale."
    )
