"""TD3 with one policy as the algorithm of a run; HIRO derives from it.

A generation is whole episodes, of at least `generation_steps` environment steps, so that nothing of an episode outlives
it. A step of experience is followed by the updates that are due for it: one of the acting level per environment step,
and one of HIRO's controller per `controller_update_interval` steps, whatever the number of environments. The first
generation acts at random and updates nothing.

Source: Fujimoto et al. 2018; Nachum et al. 2018, Algorithm 1.
"""

from __future__ import annotations

import importlib
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from shes.agents.agent import AgentDesign, FlatDesign
from shes.agents.mlp import RectifiedMLP
from shes.algorithms.contract import Algorithm, Preset, Problem, Report, check_arrays
from shes.backends.backend import Backend
from shes.baselines.collector import Actor, Collector
from shes.baselines.learner_settings import HIRO_PRESETS, LearnerSettings
from shes.baselines.levels import LearnerState, Level, Replay, flat, within
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import ConfigError, import_extra
from shes.es.level import LevelParameters
from shes.machine import free_memory
from shes.settings import Settings
from shes.streams import Purpose, stream

LEARNING = "shes.baselines.learning"
"""The module that learns with JAX, which is imported when learning begins."""
_COUNTS = ("seed", "generation", "env_steps")


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

    sections: ClassVar[Mapping[str, type[Settings]]] = {"learner": LearnerSettings}
    presets: ClassVar[Mapping[str, Preset]] = HIRO_PRESETS
    packages: ClassVar[tuple[str, ...]] = ("jax", "optax")
    learns_in_main_process: ClassVar[bool] = True
    collector: ClassVar[type[Collector]] = Collector
    """Class of the collector of experience."""

    def __init__(self, problem: Problem) -> None:
        """Create agents and levels; raise ConfigError if TD3 cannot learn in this problem."""
        design = self.make_design(problem)
        # The noise table is small, because nothing reads it.
        super().__init__(replace(problem, noise_table_size=2 * max(design.dims)), design)
        self.settings: LearnerSettings = problem.settings.learner
        self.levels = self.make_levels()

    def make_design(self, problem: Problem) -> AgentDesign:
        """Return the design of the agents; raise ConfigError if TD3 cannot learn in this problem."""
        task, own = check_problem(problem), problem.settings.learner
        policy = RectifiedMLP(task.observation_size, own.hidden, task.action_size)
        return FlatDesign(networks={"policy": policy}, control_limit=task.control_limit, input_clip=own.input_clip)

    def make_levels(self) -> tuple[Level, ...]:
        """Return the levels, controller first: here that alone which acts every step."""
        own, actions = self.settings, self.design.policies[-1].sizes[-1]
        limits = (self.design.control_limit,) * actions
        level = self.make_level(self.level_names[-1], limits, own.exploration_noise, action=(actions,))
        return (replace(level, update_interval=own.update_interval),)

    def make_level(self, name: str, half_range: tuple[float, ...], noise: float, **shapes: tuple[int, ...]) -> Level:
        """Return a level whose transitions have arrays of these `shapes` in addition to those of every level."""
        own, actor = self.settings, self.design.networks[name]
        common = {"inputs": actor.sizes[:1], "reward": (), "goes_on": (), "next_inputs": actor.sizes[:1]}
        # In the worst case, every environment begins a last episode when the generation is about to end.
        slack = max(own.generation_steps, own.warmup_steps) + own.num_envs * self.problem.horizon
        return Level(
            name=name,
            actor=actor,
            half_range=tuple(map(float, half_range)),
            exploration_std=own.noise_units(half_range) * noise,
            settings=own,
            replay=Replay(shapes={**common, **shapes}, capacity=own.replay_size, slack=slack),
        )

    def start(self, seed: int) -> TD3State:
        """Return the state before the first generation; raise ConfigError if its buffers do not fit the memory."""
        need, free = sum(level.replay.num_bytes for level in self.levels), free_memory()
        if need > free:
            raise ConfigError(
                f"replay_size is {self.settings.replay_size:,}: the replay buffers take {need / 1e9:,.1f} GB of "
                f"memory, but {free / 1e9:,.1f} GB are free. Set --replay-size, --generation-steps, --warmup-steps or "
                "--num-envs lower."
            )
        self.check_installed(self.problem.settings.run.algorithm)
        rngs = (stream(seed, Purpose.INITIAL_PARAMETERS, 0, number) for number in range(len(self.levels)))
        learners = tuple(level.start(rng) for level, rng in zip(self.levels, rngs, strict=True))
        return TD3State(seed=seed, generation=0, env_steps=0, learners=learners)

    @staticmethod
    def check_installed(name: str) -> None:
        """Raise MissingExtraError unless JAX and Optax are installed, and ConfigError if they find no device."""
        need, fix = f"--algorithm {name} needs JAX and Optax", "Install them: pip install 'shes[hiro]'."
        import_extra(LEARNING, need, fix).check_device()

    def run(self, state: TD3State, backend: Backend) -> Generator[Report[TD3State], None, None]:
        """Yield a report after every generation from `state` on, indefinitely. `backend` is not used."""
        self.check_installed(self.problem.settings.run.algorithm)
        learning = importlib.import_module(LEARNING)
        with closing(self.problem.env.make(self.settings.num_envs, self.problem.training)) as batch:
            actors = [Actor(level) for level in self.levels]
            collector = self.collector(batch, self.design, actors, self.problem.horizon, self.settings)
            while True:
                with learning.plain_settings():
                    report = self._generation(state, collector, learning.make_learners(self.levels, state.learners))
                state = report.state
                yield report

    def _generation(self, state: TD3State, collector: Collector, learners: Mapping[str, Any]) -> Report[TD3State]:
        own, start, env_steps = self.settings, perf_counter(), state.env_steps
        is_random = env_steps < own.warmup_steps
        num_steps = own.warmup_steps - env_steps if is_random else own.generation_steps
        purposes = (Purpose.TRAINING_EPISODES, Purpose.EXPLORATION, Purpose.REPLAY)
        seeding, exploring, drawing = (stream(state.seed, each, state.generation) for each in purposes)
        actors = {actor.level.name: actor for actor in collector.actors}
        for name, actor in actors.items():
            actor.is_random = is_random
            actor.use(learners[name].actor, learners[name].statistics)
        seeds = iter(lambda: int(seeding.integers(0, 2**63)), None)
        for transitions in collector.run(num_steps, seeds, exploring):
            for name, rows in transitions.items():
                learners[name].add(rows)
            before, env_steps = env_steps, state.env_steps + collector.num_steps
            for name, count in () if is_random else self.updates_due(before, env_steps):
                learners[name].update(count, drawing)
                actors[name].use(learners[name].actor, learners[name].statistics)
        finished = {name: learner.finish() for name, learner in learners.items()}
        ended = tuple(level for level, _ in finished.values())
        state = replace(state, generation=state.generation + 1, env_steps=env_steps, learners=ended)
        rollout_s, physics_s = collector.rollout_s, collector.physics_s
        seconds = {"rollout_s": rollout_s, "update_s": perf_counter() - start - rollout_s, "physics_s": physics_s}
        times = {name: round(value, 4) for name, value in seconds.items()}
        return Report(state=state, columns={**columns(collector, finished), **times})

    def updates_due(self, before: int, now: int) -> Iterator[tuple[str, int]]:
        """Yield the level and the number of the updates that are due for the environment steps `before` to `now`."""
        for level in reversed(self.levels):
            for _ in range(now // level.update_interval - before // level.update_interval):
                yield level.name, level.update_interval if level is self.levels[-1] else 1

    def to_arrays(self, state: TD3State) -> dict[str, np.ndarray]:
        """Return `state` as named arrays. Those of the replay buffers are views."""
        counts = {name: np.array(getattr(state, name)) for name in _COUNTS}
        levels = zip(self.level_names, state.learners, strict=True)
        return counts | {f"{name}/{key}": array for name, own in levels for key, array in own.to_arrays().items()}

    def from_arrays(self, arrays: Mapping[str, np.ndarray]) -> TD3State:
        """Return the state that `to_arrays` converted; raise CheckpointError unless it is one of this run."""
        blank = tuple(level.start(np.random.default_rng(0)) for level in self.levels)
        check_arrays(arrays, self.to_arrays(TD3State(seed=0, generation=0, env_steps=0, learners=blank)))
        learners = tuple(level.from_arrays(within(level.name, arrays)) for level in self.levels)
        return TD3State(**{name: int(arrays[name]) for name in _COUNTS}, learners=learners)

    def parameters(self, state: TD3State) -> tuple[LevelParameters, ...]:
        """Return the parameters and the normalisation of the actors."""
        return tuple(LevelParameters.of(flat(level.learner["actor"]), level.statistics) for level in state.learners)

    def without_training(self, state: TD3State) -> TD3State:
        """Return `state` with empty replay buffers."""
        return replace(state, learners=tuple(replace(each, replay=each.replay.emptied()) for each in state.learners))

    kept = without_training
    """`last` alone holds the replay buffers."""


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
    own, algorithm, task = problem.settings.learner, problem.settings.run.algorithm, problem.sample()
    if problem.device != "cpu":
        fault = f"device is {problem.device!r}, but {algorithm} collects its experience on the CPU. Set --device cpu."
    elif not own.hidden:
        fault = "hidden must be at least one layer, because a linear critic cannot rank actions. Set --hidden."
    elif own.batch_size > own.replay_size:
        fault = (
            f"batch_size is {own.batch_size:,}, more than the {own.replay_size:,} transitions of replay_size: nothing "
            "would ever be learned. Set --batch-size lower, or --replay-size higher."
        )
    elif task.ends_early:
        fault = (
            f"max_tilt ends episodes of {problem.name} that the task does not end; every reward there is negative, so "
            f"that {algorithm} would learn to fall. Omit --max-tilt, or set --algorithm shes."
        )
    elif np.issubdtype(task.reader.to_action(np.zeros((1, task.action_size))).dtype, np.integer):
        fault = f"the actions of {problem.name} are discrete, but TD3 needs continuous ones. Set --algorithm es."
    else:
        return task
    raise ConfigError(fault)
