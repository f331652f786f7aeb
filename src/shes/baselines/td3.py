"""TD3 with one policy as the algorithm of a run; HIRO derives from it.

A generation is whole episodes, of at least `generation_steps` environment steps, so that nothing of an episode outlives
it. A step of experience is followed by the updates that are due for it: one of the acting level per environment step,
and one of HIRO's controller per `controller_update_interval` steps, whatever the number of environments. The first
generation acts at random and updates nothing.

Source: Fujimoto et al. 2018; Nachum et al. 2018, Algorithm 1.
"""

from __future__ import annotations

import importlib
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from shes.agents.agent import AgentDesign, FlatDesign
from shes.agents.mlp import RectifiedMLP
from shes.algorithms.contract import Algorithm, Preset, Report
from shes.algorithms.problem import Problem
from shes.backends.backend import Backend
from shes.baselines.collector import Actor, Collector
from shes.baselines.learner_settings import HIRO_PRESETS, TD3_SECTIONS, LearnerSettings
from shes.baselines.levels import LearnerState, Level, within
from shes.baselines.replay import Replay
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import ConfigError, MissingExtraError
from shes.es.level import LevelParameters
from shes.machine import free_memory
from shes.rollout.worker import WorkerPlan
from shes.settings import Settings
from shes.streams import Purpose, stream

LEARNING = "shes.baselines.learning"
"""The module that learns with JAX, which is imported when learning begins."""


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
    learns_in_main_process: ClassVar[bool] = True

    @staticmethod
    def steps_per_generation(settings: Any) -> int:
        """Return the environment steps of a generation, without the rest of the episodes that are then running."""
        return settings.learner.generation_steps

    @staticmethod
    def check_installed(name: str) -> None:
        """Check that JAX and Optax are installed; see the base class."""
        try:
            importlib.import_module(LEARNING)
        except ImportError as error:
            raise MissingExtraError(
                f"--algorithm {name} needs JAX and Optax ({error}). Install them: pip install 'shes[hiro]'."
            ) from error

    def __init__(self, problem: Problem) -> None:
        """Create agents and levels; raise ConfigError if TD3 cannot learn in this problem."""
        super().__init__(problem, self.make_design(problem))
        self.settings: LearnerSettings = problem.settings.learner
        self.levels = self.make_levels()

    def make_design(self, problem: Problem) -> AgentDesign:
        """Return the design of the agents; raise ConfigError if TD3 cannot learn in this problem."""
        task, own = check_problem(problem), problem.settings.learner
        policy = RectifiedMLP(task.observation_size, own.hidden, task.action_size)
        return FlatDesign(policy=policy, control_limit=task.control_limit, input_clip=own.input_clip)

    def make_levels(self) -> tuple[Level, ...]:
        """Return the levels, controller first: here that alone which acts every step."""
        actions = self.design.policies[-1].sizes[-1]
        limits = (self.design.control_limit,) * actions
        noise = self.settings.exploration_noise
        return (self.make_level(self.level_names[-1], limits, noise, {"action": (actions,)}),)

    def make_level(
        self, name: str, half_range: tuple[float, ...], exploration_noise: float, shapes: Mapping[str, tuple[int, ...]]
    ) -> Level:
        """Return a level whose transitions have arrays of these `shapes` besides those of every level."""
        own, actor = self.settings, getattr(self.design, name)
        common = {"inputs": actor.sizes[:1], "reward": (), "goes_on": (), "next_inputs": actor.sizes[:1]}
        # In the worst case, every environment begins a last episode when the generation is about to end.
        slack = max(own.generation_steps, own.warmup_steps) + own.num_envs * self.problem.horizon
        return Level(
            name=name,
            actor=actor,
            half_range=tuple(map(float, half_range)),
            exploration_std=own.noise_units(half_range) * exploration_noise,
            settings=own,
            replay=Replay(shapes={**common, **shapes}, capacity=own.replay_size, slack=slack),
        )

    def start(self, seed: int) -> TD3State:
        """Return the state before the first generation; raise ConfigError if its buffers do not fit the memory."""
        check_memory([level.replay for level in self.levels])
        self.check_installed(self.problem.settings.run.algorithm)
        rngs = (stream(seed, Purpose.INITIAL_PARAMETERS, 0, number) for number in range(len(self.levels)))
        learners = tuple(level.start(rng) for level, rng in zip(self.levels, rngs, strict=True))
        return TD3State(seed=seed, generation=0, env_steps=0, learners=learners)

    def run(self, state: TD3State, backend: Backend) -> Generator[Report[TD3State], None, None]:
        """Yield a report after every generation from `state` on, indefinitely. `backend` is not used."""
        batch = self.problem.env.make(self.settings.num_envs, self.problem.training)
        try:
            actors = {level.name: Actor(level) for level in self.levels}
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
        learners = self.make_learners(importlib.import_module(LEARNING), state)
        is_random = state.env_steps < own.warmup_steps
        num_steps = own.warmup_steps - state.env_steps if is_random else own.generation_steps
        exploring, drawing = (
            stream(state.seed, each, state.generation) for each in (Purpose.EXPLORATION, Purpose.REPLAY)
        )
        for name, actor in actors.items():
            actor.is_random = is_random
            actor.use(learners[name].actor, learners[name].statistics)
        env_steps = state.env_steps
        for transitions in collector.run(num_steps, _episode_seeds(state), exploring):
            for name, rows in transitions.items():
                learners[name].add(rows)
            before, env_steps = env_steps, state.env_steps + collector.num_steps
            for name, count in () if is_random else self.updates_due(before, env_steps):
                if learners[name].can_learn:
                    learners[name].update(count, drawing)
                    actors[name].use(learners[name].actor, learners[name].statistics)
        finished = {name: learner.finish() for name, learner in learners.items()}
        state = TD3State(
            seed=state.seed,
            generation=state.generation + 1,
            env_steps=env_steps,
            learners=tuple(level for level, _ in finished.values()),
        )
        row = columns(collector, finished)
        rollout_s, physics_s = collector.rollout_s, collector.physics_s
        seconds = {"rollout_s": rollout_s, "update_s": perf_counter() - start - rollout_s, "physics_s": physics_s}
        return Report(state=state, columns=row | {name: round(value, 4) for name, value in seconds.items()})

    def make_collector(self, batch: EpisodeBatch, actors: Mapping[str, Actor]) -> Collector:
        """Return the collector of experience in `batch`."""
        return Collector(batch, actors, self.problem.horizon, self.settings)

    def make_learners(self, learning: Any, state: TD3State) -> dict[str, Any]:
        """Return the learner of each level by name, of module `learning`."""
        (level,), (own,) = self.levels, state.learners
        return {level.name: learning.LevelLearner(level, own)}

    def updates_due(self, before: int, now: int) -> Iterator[tuple[str, int]]:
        """Yield the level and the number of the updates that are due for the environment steps `before` to `now`."""
        interval = self.settings.update_interval
        for _ in range(now // interval - before // interval):
            yield self.level_names[-1], interval

    def to_arrays(self, state: TD3State) -> dict[str, np.ndarray]:
        """Return `state` as named arrays. Those of the replay buffers are views."""
        counts = {name: np.array(getattr(state, name)) for name in _COUNTS}
        levels = zip(self.level_names, state.learners, strict=True)
        return counts | {f"{name}/{key}": array for name, own in levels for key, array in own.to_arrays().items()}

    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> TD3State:
        """Return the state that `to_arrays` converted."""
        learners = tuple(level.from_arrays(within(level.name, arrays)) for level in self.levels)
        return TD3State(**{name: int(arrays[name]) for name in _COUNTS}, learners=learners)

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


_COUNTS = ("seed", "generation", "env_steps")


def columns(collector: Collector, levels: Mapping[str, tuple[LearnerState, Mapping[str, float]]]) -> dict[str, Any]:
    """Return the columns of `progress.csv` but the times, from the episodes and the `levels` with their losses.

    Values that do not exist are NaN.
    """
    episodes = {name: np.array([episode[name] for episode in collector.episodes]) for name in collector.episodes[0]}
    row: dict[str, Any] = {}
    for name in levels:
        returns = episodes[f"{name}_return"]
        row |= {f"{name}_return_mean": float(returns.mean()), f"{name}_return_max": float(returns.max())}
    columns = {"score": "score_mean", "success": "success_rate", "steps": "episode_steps_mean"}
    for name in ("score", "success", "steps", "terminated", "diverged"):
        row[columns.get(name, f"{name}_rate")] = float(episodes[name].mean())
    row["diverged_episodes"] = int(episodes["diverged"].sum())
    if "controller" in levels:
        row["goal_distance_mean"] = float(np.mean(collector.goal_distances or [np.nan]))
    for name, (level, losses) in levels.items():
        row |= {f"{name}_{loss}": value for loss, value in losses.items()}
        row |= {f"{name}_updates": level.learner["num_updates"], f"{name}_replay_size": level.replay.size}
    return row


def check_problem(problem: Problem) -> EpisodeBatch:
    """Return the environment for one episode, closed; raise ConfigError unless TD3 can learn in it."""
    own, algorithm = problem.settings.learner, problem.settings.run.algorithm
    if problem.device != "cpu":
        raise ConfigError(
            f"device is {problem.device!r}, but {algorithm} collects its experience on the CPU. Set --device cpu."
        )
    if not own.hidden:
        raise ConfigError(
            "hidden must be at least one layer, because a linear critic cannot rank actions. Set --hidden."
        )
    if own.batch_size > own.replay_size:
        raise ConfigError(
            f"batch_size is {own.batch_size:,}, more than the {own.replay_size:,} transitions of replay_size: "
            "nothing would ever be learned. Set --batch-size lower, or --replay-size higher."
        )
    if own.num_envs > own.generation_steps:  # they take memory, and most play nothing
        raise ConfigError(
            f"num_envs is {own.num_envs:,}, but a generation has {own.generation_steps:,} environment steps "
            f"(generation_steps). Set --num-envs {own.generation_steps} or less."
        )
    task = problem.sample()
    if task.ends_early:
        raise ConfigError(
            f"max_tilt ends episodes of {problem.name} that the task does not end; every reward there is negative, so "
            f"that {algorithm} would learn to fall. Omit --max-tilt, or set --algorithm shes."
        )
    if np.issubdtype(task.reader.to_action(np.zeros((1, task.action_size))).dtype, np.integer):
        raise ConfigError(
            f"the actions of {problem.name} are discrete, but TD3 needs continuous ones. Set --algorithm es."
        )
    return task


def check_memory(replays: Sequence[Replay]) -> None:
    """Raise ConfigError unless the replay buffers fit the free memory."""
    need, free = sum(replay.num_bytes for replay in replays), free_memory()
    if need > free:
        raise ConfigError(
            f"replay_size is {replays[0].capacity:,}: the replay buffers take {need / 1e9:,.1f} GB of memory, but "
            f"{free / 1e9:,.1f} GB are free. Set --replay-size, --generation-steps, --warmup-steps or --num-envs lower."
        )


def _episode_seeds(state: TD3State) -> Iterator[int]:
    """Yield the seeds of the episodes of the generation that follows `state`."""
    rng = stream(state.seed, Purpose.TRAINING_EPISODES, state.generation)
    while True:
        yield int(rng.integers(0, 2**63))
