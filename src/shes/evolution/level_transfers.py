"""Transfer of the levels of an evolution strategy. Source: SHES paper, II-D.

A primitive brings its goal encoding, clock, view and symmetry; a controller its view, network and output.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from shes.agents.views import PRIMITIVE_VIEWS
from shes.algorithms.contract import LevelTransfer
from shes.algorithms.problem import Problem
from shes.evolution.designs import controller_inputs, primitive_inputs, primitive_layers
from shes.evolution.hyperparameters import is_alone
from shes.evolution.state import TrainState


class _Transfer(LevelTransfer):
    """The transfer of the level called `name`."""

    name: ClassVar[str]

    def move(self, source: TrainState, state: TrainState) -> TrainState:
        """Return `state` with the parameters and statistics of the level in state `source`."""
        theirs = next(level for level in source.levels if level.name == self.name)
        levels = tuple(
            replace(level, theta=theirs.theta, statistics=theirs.statistics) if level.name == self.name else level
            for level in state.levels
        )
        return replace(state, levels=levels)


class PrimitiveTransfer(_Transfer):
    """The transfer of a primitive."""

    name = "primitive"
    trained_by = "shes train ant-flagrun, or a run of two levels with --primitive-view proprioception"
    advice = (
        "Name a primitive of the same robot, trained with the same --spec by shes train ant-flagrun or point-flagrun, "
        "or by a run of two levels with --primitive-view proprioception (for the point of Fall, which has a height)."
    )

    def settings(self, source: Any, level_names: tuple[str, ...]) -> dict[str, Any]:
        """Return the settings of the primitive's inputs and layers."""
        view = source.hierarchy.primitive_view
        is_plain = is_alone(source) and PRIMITIVE_VIEWS.find(view).sees_task
        return {
            **{name: source.values[name] for name in ("goal_encoding", "clock_frequency", "symmetry")},
            "hidden" if level_names == ("primitive",) else "primitive_hidden": primitive_layers(source),
            "primitive_view": "proprioception" if is_plain else view,
        }

    def interface(self, problem: Problem) -> str:
        """Return the inputs and outputs of the primitive in words."""
        inputs, task, settings = primitive_inputs(problem), problem.sample(), problem.settings
        kind = settings.hierarchy.symmetry
        symmetry = "" if kind == "none" else f" ({kind} symmetry)"
        return (
            f"{len(inputs)} inputs{symmetry} ({', '.join(inputs)}) of specification {settings.environment.spec} and "
            f"{task.action_size} controls of up to {task.control_limit:g}"
        )

    def is_egocentric(self, source: Any) -> bool:
        """Return whether the primitive sees the robot's state in its own frame."""
        return PRIMITIVE_VIEWS.find(source.hierarchy.primitive_view).is_egocentric


class ControllerTransfer(_Transfer):
    """The transfer of a controller."""

    name = "controller"
    trained_by = "shes train ant-gather, or another run of two levels"
    advice = "Name a controller of the same task, trained with the same --spec."
    suggested = ("controller_interval", "goal_distance", "minimum_goal_distance")

    def settings(self, source: Any, level_names: tuple[str, ...]) -> dict[str, Any]:
        """Return the settings of the controller's inputs, outputs and layers."""
        names = ("controller_network", "controller_output", "controller_view", "hidden")
        return {name: source.values[name] for name in names}

    def interface(self, problem: Problem) -> str:
        """Return the inputs and outputs of the controller in words."""
        inputs, settings = controller_inputs(problem), problem.settings
        spec = f"specification {settings.environment.spec}, output {settings.hierarchy.controller_output}"
        return f"{len(inputs)} inputs ({', '.join(inputs)}) of {spec}"


PRIMITIVE_TRANSFER: Mapping[str, LevelTransfer] = {"primitive": PrimitiveTransfer()}
"""The transfer to a primitive alone."""
SHES_TRANSFERS: Mapping[str, LevelTransfer] = {**PRIMITIVE_TRANSFER, "controller": ControllerTransfer()}
"""The transfers to a controller and its primitive."""
