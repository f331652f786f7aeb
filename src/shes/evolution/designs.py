"""Agent designs of the evolution strategies, from the settings of a run and its environment."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from shes.agents.agent import AgentDesign, FlatDesign
from shes.agents.equivariant import EquivariantMLP, sector_actions
from shes.agents.goal_agent import Controller, GoalDesign
from shes.agents.goals import SectorOutput, make_controller_output, make_goal_encoding
from shes.agents.mlp import MLP
from shes.agents.rewards import make_primitive_reward
from shes.agents.views import (
    CONTROLLER_VIEWS,
    PRIMITIVE_VIEWS,
    Clock,
    Proprioception,
    SectorsView,
    View,
    ViewChoice,
)
from shes.algorithms.problem import Problem
from shes.envs.bodies.symmetry import SymmetryGroup
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import ConfigError
from shes.evolution.hyperparameters import explores, is_alone, is_branched
from shes.settings import flag


def flat_design(problem: Problem) -> FlatDesign:
    """Return the design of an agent with a single policy."""
    task, settings = problem.sample(), problem.settings
    inputs = _clock_size(settings) + task.observation_size
    return FlatDesign(policy=MLP(inputs, settings.networks.hidden, task.action_size), **_acting(settings, task))


def goal_design(problem: Problem) -> GoalDesign:
    """Return the design of a primitive, with its controller unless the environment sets the goals.

    Raises:
        ConfigError: A view or the symmetry does not suit the environment, or the position is unknown.
    """
    task, settings = problem.sample(), problem.settings
    hierarchy = settings.hierarchy
    task.check_position()
    encoding, view = make_goal_encoding(hierarchy.goal_encoding, settings.values), primitive_view(settings, task)
    inputs = encoding.size + _clock_size(settings) + view.size(task.observation_size)
    return GoalDesign(
        controller=None if is_alone(settings) else _controller(settings, task),
        primitive=MLP(inputs, primitive_layers(settings), task.action_size),
        primitive_view=view,
        symmetry=_symmetry(settings, task),
        goal_encoding=encoding,
        primitive_reward=make_primitive_reward(hierarchy.primitive_reward, settings.values),
        controller_interval=hierarchy.controller_interval,
        **_acting(settings, task),
    )


def _controller(settings: Any, task: EpisodeBatch) -> Controller:
    """Return the design of the controller."""
    hierarchy, hidden = settings.hierarchy, settings.networks.hidden
    output, view = (
        make_controller_output(hierarchy.controller_output, settings.values),
        _controller_view(settings, task),
    )
    if hierarchy.controller_network == "equivariant":
        assert isinstance(view, SectorsView), "check_together has seen to it"
        output = SectorOutput(view.num_sectors, output)
        channels = (view.num_channels, *hidden, 1)
        network: MLP = EquivariantMLP([sector_actions(view.num_sectors, count) for count in channels])
    else:
        network = MLP(view.size(task.observation_size), hidden, output.size)
    return Controller(
        network=network,
        output=output,
        view=view,
        goal_distance=hierarchy.goal_distance,
        has_minimum_goal_distance=hierarchy.minimum_goal_distance,
    )


def _acting(settings: Any, task: EpisodeBatch) -> dict[str, Any]:
    """Return the fields of a design that concern the acting level."""
    clock = None
    if settings.networks.clock_frequency is not None:
        clock = Clock(frequency_hz=settings.networks.clock_frequency, step_s=task.step_s)
    return {"control_limit": task.control_limit, "clock": clock}


def branch_design(settings: Any, design: AgentDesign) -> GoalDesign | None:
    """Return the design of the agents in branches under a controller, or None if there are no such branches."""
    if not (is_branched(settings) or explores(settings)) or not isinstance(design, GoalDesign) or not design.controller:
        return None
    return replace(
        design, controller=None, num_recorded_goals=settings.estimate.intervals if is_branched(settings) else 1
    )


def primitive_layers(settings: Any) -> tuple[int, ...]:
    """Return the sizes of the primitive's hidden layers."""
    own = None if is_alone(settings) else settings.hierarchy.primitive_hidden
    return settings.networks.hidden if own is None else own


def _clock_size(settings: Any) -> int:
    return 0 if settings.networks.clock_frequency is None else Clock.size


def _symmetry(settings: Any, task: EpisodeBatch) -> SymmetryGroup | None:
    """Return the primitive's symmetry group, if any; raise ConfigError if the robot has no known symmetry."""
    kind = settings.hierarchy.symmetry
    if kind == "none":
        return None
    group = None if task.robot is None else task.robot.symmetry(is_mirrored=kind == "dihedral")
    if group is None:
        robot = "an external robot" if task.robot is None else f"the {task.robot.name}"
        raise ConfigError(
            f"symmetry is {kind!r}, but {robot} of {settings.run.env} has no known symmetry. "
            "Omit --symmetry, or choose an environment with the ant."
        )
    return group


def _view(settings: Any, task: EpisodeBatch, setting: str, choice: type[ViewChoice]) -> View:
    """Return the view that `setting` chooses; raise ConfigError if the robot has none."""
    view = choice().of(task)
    if view is None:
        env = settings.run.env
        whose = f"{env} has an external robot" if task.robot is None else f"{env} has the {task.robot.name}"
        name = settings.values[setting]
        raise ConfigError(f"{setting} is {name!r}, but {whose}, {choice.lack}. Set {flag(setting)} to another one.")
    return view


def _controller_view(settings: Any, task: EpisodeBatch) -> View:
    return _view(settings, task, "controller_view", CONTROLLER_VIEWS.find(settings.hierarchy.controller_view))


def primitive_view(settings: Any, task: EpisodeBatch) -> View:
    """Return the view of the primitive; raise ConfigError if the robot has no such view."""
    choice = PRIMITIVE_VIEWS.find(settings.hierarchy.primitive_view)
    if choice.sees_task and is_alone(settings):
        choice = Proprioception  # the task's own observation would tell it where the goal is
    return _view(settings, task, "primitive_view", choice)


def primitive_inputs(problem: Problem) -> tuple[str, ...]:
    """Return the name of each input of the primitive, in order."""
    task, settings = problem.sample(), problem.settings
    encoding, frequency = settings.hierarchy.goal_encoding, settings.networks.clock_frequency
    features = [f"goal {encoding} {i}" for i in range(make_goal_encoding(encoding, settings.values).size)]
    clock = [] if frequency is None else [f"clock {x} {frequency} Hz" for x in ("sin", "cos")]
    return (*features, *clock, *primitive_view(settings, task).names(task.observation_names))


def controller_inputs(problem: Problem) -> tuple[str, ...]:
    """Return the name of each input of the controller, in order."""
    task, settings = problem.sample(), problem.settings
    return tuple(_controller_view(settings, task).names(task.observation_names))
