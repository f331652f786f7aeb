"""Agent designs of the evolution strategies, and the transfer of their levels between runs.

A primitive brings its goal encoding, clock, view and symmetry; a controller its view, network and output.

Source: SHES paper, II-D (transfer).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from shes.agents.agent import AgentDesign, FlatDesign
from shes.agents.equivariant import EquivariantMLP, sector_actions
from shes.agents.goal_agent import GoalDesign
from shes.agents.goals import CONTROLLER_OUTPUTS, GOAL_ENCODINGS, SectorOutput
from shes.agents.mlp import MLP
from shes.agents.rewards import PRIMITIVE_REWARDS
from shes.agents.views import CONTROLLER_VIEWS, PRIMITIVE_VIEWS, Clock, SectorsView, View, proprioception
from shes.algorithms.contract import LevelTransfer, Problem
from shes.envs.bodies.body import SymmetryGroup
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import ConfigError
from shes.evolution.hyperparameters import explores, is_alone, is_branched
from shes.options import make
from shes.settings import flag


def flat_design(problem: Problem) -> FlatDesign:
    """Return the design of an agent with a single policy."""
    task, settings = problem.sample(), problem.settings
    clock = _clock(settings, task)
    inputs = (clock.size if clock else 0) + task.observation_size
    policy = MLP(inputs, settings.networks.hidden, task.action_size)
    return FlatDesign(networks={"policy": policy}, control_limit=task.control_limit, clock=clock)


def goal_design(problem: Problem) -> GoalDesign:
    """Return the design of a primitive, with its controller unless the environment sets the goals.

    Raise ConfigError if a view or the symmetry does not suit the environment, or the position is unknown.
    """
    task, settings = problem.sample(), problem.settings
    hierarchy, clock = settings.hierarchy, _clock(settings, task)
    task.check_position()
    encoding = make(GOAL_ENCODINGS, hierarchy.goal_encoding, settings.values)
    view = _view(settings, task, "primitive_view")
    inputs = encoding.size + (clock.size if clock else 0) + view.size(task.observation_size)
    design = GoalDesign(
        networks={"primitive": MLP(inputs, _primitive_layers(settings), task.action_size)},
        primitive_view=view,
        symmetry=_symmetry(settings, task),
        goal_encoding=encoding,
        primitive_reward=make(PRIMITIVE_REWARDS, hierarchy.primitive_reward, settings.values),
        controller_interval=hierarchy.controller_interval,
        control_limit=task.control_limit,
        clock=clock,
    )
    return design if is_alone(settings) else _with_controller(design, settings, task)


def branch_design(settings: Any, design: AgentDesign) -> GoalDesign | None:
    """Return the design of the agents in branches under a controller, or None if there are no such branches."""
    if not (is_branched(settings) or explores(settings)) or not isinstance(design, GoalDesign) or is_alone(settings):
        return None
    goals, networks = settings.estimate.intervals if is_branched(settings) else 1, {**design.networks}
    del networks["controller"]
    return replace(design, networks=networks, controller_view=None, controller_output=None, num_recorded_goals=goals)


def _with_controller(design: GoalDesign, settings: Any, task: EpisodeBatch) -> GoalDesign:
    hierarchy, hidden, view = settings.hierarchy, settings.networks.hidden, _view(settings, task, "controller_view")
    output = make(CONTROLLER_OUTPUTS, hierarchy.controller_output, settings.values)
    if hierarchy.controller_network == "equivariant":
        assert isinstance(view, SectorsView), "check_together has seen to it"
        output = SectorOutput(view.num_sectors, output)
        channels = (view.num_channels, *hidden, 1)
        network: MLP = EquivariantMLP([sector_actions(view.num_sectors, count) for count in channels])
    else:
        network = MLP(view.size(task.observation_size), hidden, output.size)
    return replace(
        design,
        networks={"controller": network, **design.networks},
        controller_view=view,
        controller_output=output,
        goal_distance=hierarchy.goal_distance,
        has_minimum_goal_distance=hierarchy.minimum_goal_distance,
    )


def _clock(settings: Any, task: EpisodeBatch) -> Clock | None:
    frequency = settings.networks.clock_frequency
    return None if frequency is None else Clock(frequency_hz=frequency, step_s=task.step_s)


def _primitive_layers(settings: Any) -> tuple[int, ...]:
    own = settings.values.get("primitive_hidden")
    return settings.networks.hidden if own is None else own


def _symmetry(settings: Any, task: EpisodeBatch) -> SymmetryGroup | None:
    kind = settings.hierarchy.symmetry
    if kind == "none":
        return None
    group = None if task.robot is None else task.robot.symmetry(is_mirrored=kind != "rotation")
    if group is None and kind != "auto":
        robot = "an external robot" if task.robot is None else f"the {task.robot.name}"
        raise ConfigError(
            f"symmetry is {kind!r}, but {robot} of {settings.run.env} has no known symmetry. "
            "Omit --symmetry, or set it to auto."
        )
    return group


def _view(settings: Any, task: EpisodeBatch, setting: str) -> View:
    """Return the view that `setting` chooses; raise ConfigError if the robot has none."""
    name = settings.values[setting]
    choice = {"controller_view": CONTROLLER_VIEWS, "primitive_view": PRIMITIVE_VIEWS}[setting].find(name)
    if setting == "primitive_view" and name == "observation" and is_alone(settings):
        choice = proprioception  # the task's own observation would tell it where the goal is
    view = choice(task)
    if isinstance(view, str):
        env = settings.run.env
        whose = f"{env} has an external robot" if task.robot is None else f"{env} has the {task.robot.name}"
        raise ConfigError(f"{setting} is {name!r}, but {whose}, {view}. Set {flag(setting)} to another one.")
    return view


class _PrimitiveTransfer(LevelTransfer):
    trained_by = "shes train ant-flagrun, or a run of two levels with --primitive-view proprioception"
    advice = (
        "Name a primitive of the same robot, trained with the same --spec by shes train ant-flagrun or point-flagrun, "
        "or by a run of two levels with --primitive-view proprioception (for the point of Fall, which has a height)."
    )

    def settings(self, source: Any, level_names: tuple[str, ...]) -> dict[str, Any]:
        view = source.hierarchy.primitive_view
        is_plain = is_alone(source) and view == "observation"
        return {
            **{name: source.values[name] for name in ("goal_encoding", "clock_frequency", "symmetry")},
            "hidden" if level_names == ("primitive",) else "primitive_hidden": _primitive_layers(source),
            "primitive_view": "proprioception" if is_plain else view,
        }

    def interface(self, problem: Problem) -> str:
        task, settings = problem.sample(), problem.settings
        encoding, frequency = settings.hierarchy.goal_encoding, settings.networks.clock_frequency
        features = [f"goal {encoding} {i}" for i in range(make(GOAL_ENCODINGS, encoding, settings.values).size)]
        clock = [] if frequency is None else [f"clock {x} {frequency} Hz" for x in ("sin", "cos")]
        inputs = [*features, *clock, *_view(settings, task, "primitive_view").names(task.observation_names)]
        kind = settings.hierarchy.symmetry
        symmetry = "" if kind == "none" else f" ({kind} symmetry)"
        return (
            f"{len(inputs)} inputs{symmetry} ({', '.join(inputs)}) of specification {settings.environment.spec} and "
            f"{task.action_size} controls of up to {task.control_limit:g}"
        )


class _ControllerTransfer(LevelTransfer):
    trained_by = "shes train ant-gather, or another run of two levels"
    advice = "Name a controller of the same task, trained with the same --spec."
    suggested = ("controller_interval", "goal_distance", "minimum_goal_distance")

    def settings(self, source: Any, level_names: tuple[str, ...]) -> dict[str, Any]:
        names = ("controller_network", "controller_output", "controller_view", "hidden")
        return {name: source.values[name] for name in names}

    def interface(self, problem: Problem) -> str:
        task, settings = problem.sample(), problem.settings
        inputs = _view(settings, task, "controller_view").names(task.observation_names)
        spec = f"specification {settings.environment.spec}, output {settings.hierarchy.controller_output}"
        return f"{len(inputs)} inputs ({', '.join(inputs)}) of {spec}"


PRIMITIVE_TRANSFER: Mapping[str, LevelTransfer] = {"primitive": _PrimitiveTransfer()}
"""The transfer to a primitive alone."""
SHES_TRANSFERS: Mapping[str, LevelTransfer] = {**PRIMITIVE_TRANSFER, "controller": _ControllerTransfer()}
"""The transfers to a controller and its primitive."""
