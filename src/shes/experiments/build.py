"""The only constructors: from settings to the parts of a run."""

from __future__ import annotations

from functools import partial

import numpy as np

from shes.algorithm import Settings
from shes.backends.backend import Backend
from shes.backends.processes import ProcessesBackend
from shes.backends.serial import SerialBackend
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.external.environment import ExternalEnvironment
from shes.envs.registry import EnvironmentMaker, find_environment
from shes.envs.task import TaskOptions
from shes.errors import ShapeError
from shes.es.level import LevelState, TrainState, UpdateRule
from shes.es.noise import NoiseTable
from shes.es.statistics import ObservationStatistics
from shes.es.streams import Purpose, stream
from shes.experiments.config import TrainConfig
from shes.hierarchy.agent import AgentDesign
from shes.hierarchy.goals import make_goal_encoding
from shes.hierarchy.rewards import make_primitive_reward
from shes.policies.mlp import MLP
from shes.worker import RolloutWorker, WorkerPlan

__all__ = [
    "build_backend",
    "build_design",
    "build_environment",
    "build_plan",
    "build_settings",
    "build_state",
    "build_task",
    "open_noise_table",
]


def build_environment(config: TrainConfig) -> EnvironmentMaker:
    """Return what makes episodes of the environment of `config`.

    Raises:
        UnknownNameError: There is none of its name, or Gymnasium knows none of its id.
        MissingExtraError: It comes with a package that is not installed.
        ConfigError: It is not as it is described.
    """
    return find_environment(config.env) if config.external is None else ExternalEnvironment.find(config.external)


def build_options(config: TrainConfig, env: EnvironmentMaker, *, is_evaluation: bool) -> TaskOptions:
    """Return the options of the environment in training or in evaluation."""
    has_intervals = "goal_interval" in env.heeds
    return TaskOptions(
        spec=config.spec,
        integrator=config.integrator,
        reset_noise=config.evaluation_reset_noise if is_evaluation else config.reset_noise,
        evaluation=is_evaluation,
        target_sampling=config.target_sampling,
        target=config.target,
        evaluation_target=config.evaluation_target,
        observe_block=config.observe_block,
        fall_penalty=config.fall_penalty,
        **({"goal_interval": config.controller_interval} if has_intervals else {}),
    )


def build_task(config: TrainConfig, num_episodes: int, *, is_evaluation: bool) -> EpisodeBatch:
    """Return the environment of `config` for `num_episodes` episodes."""
    env = build_environment(config)
    return env.make(num_episodes, build_options(config, env, is_evaluation=is_evaluation))


def build_design(config: TrainConfig) -> AgentDesign:
    """Return what the agent of `config` is made of.

    Raises:
        ShapeError: The environment observes another number of values than its layout names.
    """
    task = build_task(config, 1, is_evaluation=False)
    task.reset(np.array([0]), [0])
    shape = task.observe().shape
    if shape != (1, task.observation_size):
        raise ShapeError(
            f"environment {config.env!r} must observe [N, {task.observation_size}], as many values as its layout "
            f"names; for 1 episode it observed {shape}. Change its layout or its observe()."
        )
    task.close()
    encoding = make_goal_encoding(config.goal_encoding)
    return AgentDesign(
        controller=MLP(task.observation_size, config.hidden, 2),
        primitive=MLP(encoding.size + len(task.primitive_view), config.hidden, task.action_size),
        primitive_view=tuple(task.primitive_view.tolist()),
        goal_encoding=encoding,
        primitive_reward=make_primitive_reward(config.primitive_reward),
        goal_distance=config.goal_distance,
        controller_interval=config.controller_interval,
        has_minimum_goal_distance=config.minimum_goal_distance,
        control_limit=task.control_limit,
    )


def build_settings(config: TrainConfig) -> Settings:
    """Return the numbers of Algorithm 1."""
    return Settings(
        population_size=config.population_size,
        episodes_per_policy=config.episodes_per_policy,
        sigma=config.sigma,
        update=build_update_rule(config),
        mirrored=config.mirrored,
        has_common_random_numbers=config.common_random_numbers,
        statistics_fraction=config.statistics_fraction,
    )


def build_update_rule(config: TrainConfig) -> UpdateRule:
    """Return how fitness becomes a step."""
    return UpdateRule(learning_rate=config.learning_rate, weight_decay=config.weight_decay, rank_ties=config.rank_ties)


def build_state(config: TrainConfig, design: AgentDesign) -> TrainState:
    """Return the state before the first generation."""
    adam = build_update_rule(config).adam
    levels: list[LevelState] = []
    for number, (policy, size) in enumerate(zip(design.policies, design.observation_sizes, strict=True)):
        theta = policy.initial(stream(config.seed, Purpose.INITIAL_PARAMETERS, number), config.biases)
        statistics = ObservationStatistics.empty(size)
        levels.append(LevelState(theta=theta, optimizer=adam.start(len(theta)), statistics=statistics))
    return TrainState(seed=config.seed, generation=0, env_steps=0, levels=tuple(levels))


def open_noise_table(config: TrainConfig, design: AgentDesign) -> NoiseTable:
    """Open the noise table of `config`, building it where it is missing."""
    table = NoiseTable.open(config.noise_table_size)
    for dim in design.dims:
        table.check_dim(dim)
    return table


def build_plan(config: TrainConfig, design: AgentDesign, table: NoiseTable) -> WorkerPlan:
    """Return what every worker needs to know."""
    assert table.path is not None
    env = build_environment(config)
    return WorkerPlan(
        env=env,
        training=build_options(config, env, is_evaluation=False),
        evaluation=build_options(config, env, is_evaluation=True),
        design=design,
        noise_table=table.path,
        episodes_per_policy=config.episodes_per_policy,
        horizon=config.horizon,
        evaluation_horizon=config.evaluation_horizon or config.horizon,
        chunk_size=config.chunk_size,
    )


def build_backend(config: TrainConfig, plan: WorkerPlan) -> Backend:
    """Start the workers."""
    factory = partial(RolloutWorker, plan)
    if config.backend == "serial":
        return SerialBackend(factory)
    return ProcessesBackend(factory, config.workers)
