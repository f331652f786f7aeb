"""The only constructors: from settings to the parts of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np

from shes.algorithms.evolution.populations import Settings
from shes.algorithms.evolution.worker import RolloutWorker, WorkerPlan, simulator_factory
from shes.backends.backend import Backend
from shes.backends.processes import ProcessesBackend
from shes.backends.serial import SerialBackend
from shes.envs.bodies.symmetry import SymmetryGroup
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.registry import EnvironmentMaker, find_environment
from shes.envs.tasks.options import TaskOptions
from shes.errors import ConfigError, ShapeError
from shes.es.level import LevelState, TrainState, UpdateRule
from shes.es.noise import NoiseTable
from shes.es.novelty import make_novelty_rule
from shes.es.optimizers import make_optimizer
from shes.es.perturbation import make_perturbation
from shes.es.schedules import Schedule, make_schedule
from shes.es.shaping import make_fitness_shaping
from shes.es.statistics import ObservationStatistics
from shes.es.streams import Purpose, stream
from shes.hierarchy.agent import AgentDesign
from shes.hierarchy.clock import Clock
from shes.hierarchy.flat import FlatDesign
from shes.hierarchy.goals import make_goal_encoding
from shes.hierarchy.hierarchical import HierarchicalDesign
from shes.hierarchy.intervals import IntervalEstimate
from shes.hierarchy.outputs import make_controller_output
from shes.hierarchy.primitive import BranchDesign, PrimitiveDesign
from shes.hierarchy.rewards import make_primitive_reward
from shes.hierarchy.views import ColumnsView, EgocentricView, View
from shes.policies.mlp import MLP
from shes.runs.config import TrainConfig
from shes.runs.settings import SCHEDULED, flag
from shes.sim.warp_device import is_out_of_memory

__all__ = [
    "build_backend",
    "build_branch_design",
    "build_design",
    "build_environment",
    "build_plan",
    "build_settings",
    "build_state",
    "build_task",
    "build_update_rules",
    "check_device",
    "open_noise_table",
    "primitive_inputs",
    "primitive_view",
]


def build_environment(config: TrainConfig) -> EnvironmentMaker:
    """Return what makes episodes of the environment of `config`.

    Raises:
        UnknownNameError: There is none of its name.
    """
    return find_environment(config.env)


def build_options(config: TrainConfig, env: EnvironmentMaker, *, is_evaluation: bool) -> TaskOptions:
    """Return the options of the environment in training or in evaluation."""
    random_controller: dict[str, Any] = {
        "goal_interval": config.controller_interval,
        "goal_range": config.goal_distance,
    }
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
        **(random_controller if env.sets_goals else {}),
    )


def build_task(config: TrainConfig, num_episodes: int, *, is_evaluation: bool) -> EpisodeBatch:
    """Return the environment of `config` for `num_episodes` episodes."""
    env = build_environment(config)
    return env.make(num_episodes, build_options(config, env, is_evaluation=is_evaluation))


def build_design(config: TrainConfig) -> AgentDesign:
    """Return what the agent of `config` is made of.

    Raises:
        ShapeError: The environment observes another number of values than its layout names.
        ConfigError: There is no position to hide, or nobody knows where the robot is.
    """
    task = build_task(config, 1, is_evaluation=False)
    task.reset(np.array([0]), [0])
    shape = task.observe().shape
    if shape != (1, task.observation_size):
        raise ShapeError(
            f"environment {config.env!r} must observe [N, {task.observation_size}], as many values as its layout "
            f"names; for 1 episode it observed {shape}. Change its layout or its observe()."
        )
    if config.level_names != ("policy",) or config.novelty != "none":
        task.check_position()
    task.close()
    clock = None
    if config.clock_frequency is not None:
        clock = Clock(frequency_hz=config.clock_frequency, step_s=task.step_s)
    acting: dict[str, Any] = {"control_limit": task.control_limit, "clock": clock}
    if config.level_names == ("policy",):
        return FlatDesign(
            policy=MLP(_clock_size(config) + task.observation_size, config.hidden, task.action_size), **acting
        )
    reaching = _reaching(config, task) | acting
    if config.level_names == ("primitive",):
        return PrimitiveDesign(**reaching)
    output, view = make_controller_output(config.controller_output), _controller_view(config, task)
    return HierarchicalDesign(
        controller=MLP(view.size(task.observation_size), config.hidden, output.size),
        controller_output=output,
        controller_view=view,
        goal_distance=config.goal_distance,
        has_minimum_goal_distance=config.minimum_goal_distance,
        **reaching,
    )


def build_branch_design(config: TrainConfig, design: AgentDesign) -> BranchDesign | None:
    """Return what acts in branches beside a controller, by the `design` of the run's agent; None without branches."""
    if config.primitive_estimate != "interval" or not isinstance(design, HierarchicalDesign):
        return None
    shared = {field.name: getattr(design, field.name) for field in fields(PrimitiveDesign)}
    return BranchDesign(num_goals=config.intervals, **shared)


def _reaching(config: TrainConfig, task: EpisodeBatch) -> dict[str, Any]:
    """Return what an agent of `config` is made of that concerns its primitive."""
    encoding, view = make_goal_encoding(config.goal_encoding), primitive_view(config, task)
    hidden = config.hidden if config.primitive_hidden is None else config.primitive_hidden
    return {
        "primitive": MLP(
            encoding.size + _clock_size(config) + view.size(task.observation_size), hidden, task.action_size
        ),
        "primitive_view": view,
        "symmetry": _symmetry(config, task),
        "goal_encoding": encoding,
        "primitive_reward": make_primitive_reward(config.primitive_reward),
        "controller_interval": config.controller_interval,
    }


def _clock_size(config: TrainConfig) -> int:
    """Return the number of the clock's features."""
    return 0 if config.clock_frequency is None else Clock.size


def _symmetry(config: TrainConfig, task: EpisodeBatch) -> SymmetryGroup | None:
    """Return the symmetry that the primitive of `config` uses, if any.

    Raises:
        ConfigError: The robot of `task` has none that is known.
    """
    if config.symmetry == "none":
        return None
    group = None if task.robot is None else task.robot.symmetry(is_mirrored=config.symmetry == "dihedral")
    if group is None:
        robot = "an external robot" if task.robot is None else f"the {task.robot.name}"
        raise ConfigError(
            f"symmetry is {config.symmetry!r}, but nobody has told what symmetry {robot} of {config.env} has. "
            "Leave --symmetry away, or name an environment of the ant."
        )
    return group


def _egocentric(config: TrainConfig, task: EpisodeBatch, setting: str, others: Sequence[int] = ()) -> EgocentricView:
    """Return the egocentric view of the robot of `task`, then of the observation's values at `others`.

    Raises:
        ConfigError: Nobody knows how to look at this robot from its own frame.
    """
    if task.robot is None or not task.robot.egocentric:
        whose = f"{config.env} is Gymnasium's" if task.robot is None else f"{config.env} has the {task.robot.name}"
        raise ConfigError(
            f"{setting} is 'egocentric', but {whose}: what its robot looks like from its own frame is not known. "
            f"Set {flag(setting)} to another one."
        )
    return EgocentricView(task.robot, task.proprioception.tolist(), others)


def _controller_view(config: TrainConfig, task: EpisodeBatch) -> View:
    """Return what the controller of `config` sees of the observation of `task`.

    Raises:
        ConfigError: Nobody knows how to look at this robot from its own frame.
    """
    if config.controller_view == "observation":
        return ColumnsView()
    others = sorted(set(range(task.observation_size)) - set(task.proprioception.tolist()))
    return _egocentric(config, task, "controller_view", others)


def primitive_view(config: TrainConfig, task: EpisodeBatch) -> View:
    """Return what the primitive of `config` sees of the observation of `task`.

    Raises:
        ConfigError: Its position is to be hidden, and it sees none; or nobody knows how to look at this robot from its
            own frame.
    """
    if config.primitive_view == "egocentric":
        if config.hide_position:
            raise ConfigError(
                "hide_position: an egocentric view shows no absolute position that could be hidden. "
                "Leave --hide-position away."
            )
        return _egocentric(config, task, "primitive_view")
    sees_all = config.primitive_view == "observation" and config.level_names != ("primitive",)
    view = (task.primitive_view if sees_all else task.proprioception).tolist()
    if not config.hide_position:
        return ColumnsView(view)
    hidden = [column for column in view if column in task.position_columns]
    if not hidden:
        raise ConfigError(
            f"hide_position: a primitive in {config.env} sees no absolute position that could be hidden. "
            "Leave --hide-position away."
        )
    return ColumnsView([column for column in view if column not in hidden])


def primitive_inputs(config: TrainConfig) -> tuple[str, ...]:
    """Return what each input of the primitive of `config` is called, in order."""
    task = build_task(config, 1, is_evaluation=False)
    task.close()
    features = [f"goal {config.goal_encoding} {i}" for i in range(make_goal_encoding(config.goal_encoding).size)]
    clock = [] if config.clock_frequency is None else [f"clock {x} {config.clock_frequency} Hz" for x in ("sin", "cos")]
    return (*features, *clock, *primitive_view(config, task).names(task.observation_names))


def controller_inputs(config: TrainConfig) -> tuple[str, ...]:
    """Return what each input of the controller of `config` is called, in order."""
    task = build_task(config, 1, is_evaluation=False)
    task.close()
    return tuple(_controller_view(config, task).names(task.observation_names))


def build_settings(config: TrainConfig) -> Settings:
    """Return the numbers of Algorithm 1."""

    def schedule(name: str) -> Schedule:
        kind, end = SCHEDULED[name]
        start, quantity = getattr(config, name), kind.removesuffix("_schedule")
        stop = start if getattr(config, end) is None else getattr(config, end)
        return make_schedule(quantity, getattr(config, kind), start, stop, config.schedule_generations)

    return Settings(
        population_size=config.population_size,
        episodes_per_policy=schedule("episodes_per_policy"),
        sigma=schedule("sigma"),
        learning_rate=schedule("learning_rate"),
        updates=build_update_rules(config),
        learns=config.learns,
        mirrored=config.mirrored,
        perturbation=make_perturbation(config.perturbation),
        common_random_numbers=config.common_random_numbers,
        statistics_fraction=config.statistics_fraction,
        novelty=None if config.novelty == "none" else make_novelty_rule(config.novelty),
        novelty_neighbours=config.novelty_neighbours,
        intervals=_interval_estimate(config, schedule("sigma"), schedule("learning_rate")),
        horizon=config.horizon,
    )


def _interval_estimate(config: TrainConfig, sigma: Schedule, learning_rate: Schedule) -> IntervalEstimate | None:
    """Return how the primitive is judged by intervals, if it is and learns; the schedules are those of the run."""
    if config.primitive_estimate != "interval" or not config.learns[-1]:
        return None

    def own(quantity: str, value: float | None, shared: Schedule) -> Schedule:
        return shared if value is None else make_schedule(quantity, "constant", value, value, 1)

    return IntervalEstimate(
        population_size=config.primitive_population_size or config.population_size,
        intervals=config.intervals,
        interval_steps=config.controller_interval,
        horizon=config.horizon,
        goal_range=config.goal_distance,
        update=build_update_rules(config)[-1],
        sigma=own("primitive_sigma", config.primitive_sigma, sigma),
        learning_rate=own("primitive_learning_rate", config.primitive_learning_rate, learning_rate),
    )


def build_update_rules(config: TrainConfig) -> tuple[UpdateRule, ...]:
    """Return how fitness becomes a step, for each level."""
    rule = UpdateRule(
        weight_decay=config.weight_decay,
        decouples_decay=config.weight_decay_form == "decoupled",
        holds_when_tied=config.hold_tied,
        shaping=make_fitness_shaping(config.fitness_shaping, ties=config.rank_ties, fraction=config.top_fraction),
        optimizer=make_optimizer(config.optimizer, momentum=config.momentum),
    )
    own: dict[str, dict[str, Any]] = {"primitive": {"fall_price": config.fall_price}}
    if config.controller_weight_decay is not None:
        own["controller"] = {"weight_decay": config.controller_weight_decay}
    if config.primitive_estimate == "interval":
        name = config.primitive_fitness_shaping
        own["primitive"]["shaping"] = make_fitness_shaping(name, ties=config.rank_ties, fraction=config.top_fraction)
    return tuple(replace(rule, **own.get(name, {})) for name in config.level_names)


def build_state(config: TrainConfig, design: AgentDesign) -> TrainState:
    """Return the state before the first generation; a primitive that is transferred comes in later."""
    levels: list[LevelState] = []
    rules = build_update_rules(config)
    for number, (policy, size) in enumerate(zip(design.policies, design.observation_sizes, strict=True)):
        rng = stream(config.seed, Purpose.INITIAL_PARAMETERS, number)
        theta = policy.initial(rng, config.biases, config.output_weights)
        levels.append(
            LevelState(
                name=design.level_names[number],
                theta=theta,
                optimizer=rules[number].optimizer.start(len(theta)),
                statistics=ObservationStatistics.empty(size),
            )
        )
    novelty = None if config.novelty == "none" else make_novelty_rule(config.novelty).start()
    return TrainState(seed=config.seed, generation=0, env_steps=0, levels=tuple(levels), novelty=novelty)


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
        horizon=config.horizon,
        evaluation_horizon=config.evaluation_horizon or config.horizon,
        chunk_size=config.chunk_size,
        device=config.device,
        nconmax=config.nconmax,
        njmax=config.njmax,
        branch_design=build_branch_design(config, design),
    )


def check_device(config: TrainConfig) -> None:
    """Refuse a device that is not there, or that does not run the world of `config`: before anything is written.

    Raises:
        MissingExtraError: It needs a package that is not installed.
        ConfigError: There is no card, its driver is too old, versions do not go together, the world needs the CPU, or
            there is not the memory for one.
    """
    if config.device == "cpu":
        return
    env = build_environment(config)
    simulator = simulator_factory(config.device, config.nconmax, config.njmax)
    try:
        env.make(1, build_options(config, env, is_evaluation=False), simulator).close()
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        raise ConfigError(
            f"device {config.device} has too little memory for a single episode ({error}). See what else uses it, set "
            "--nconmax or --njmax lower, or use --device cpu."
        ) from error


def build_backend(config: TrainConfig, plan: WorkerPlan) -> Backend:
    """Start the workers; a device has one, in this process."""
    factory = partial(RolloutWorker, plan)
    if config.backend == "serial" or config.device != "cpu":
        return SerialBackend(factory)
    return ProcessesBackend(factory, config.workers)
