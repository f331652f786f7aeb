"""Options of the tasks: settings that may differ between two uses of one task.

A task with its own options names a subclass: `class MazeOptions(TaskOptions)`, `Options = MazeOptions`. The flags of
`shes train`, the arguments of `gymnasium.make` and the documentation follow from its fields.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from shes.envs.worlds import INTEGRATORS
from shes.settings import Choices, Example, Ge, Gt, Le, Lt, Settings, Unasked

SPECS = {"shes": "euler", "hiro": "rk4"}
"""Specifications and their integrators."""
FURTHEST_M = 1000.0
"""Largest coordinate of a target or goal: beyond every world, and small enough that its square is finite."""

Coordinates = Annotated[tuple[float, ...], Ge(-FURTHEST_M), Le(FURTHEST_M), Example("0 16")]
"""Coordinates of a point in metres."""


@dataclass(frozen=True, kw_only=True)
class TaskOptions(Settings):
    """The options of every task."""

    spec: Annotated[str, Choices(SPECS)] = "shes"
    """Published specification of the environment: shes (the SHES authors'), or hiro (Nachum et al. 2018, rllab)."""
    integrator: Annotated[str, Choices(("default", *INTEGRATORS))] = "default"
    """MuJoCo's integrator; default is that of the specification: euler for shes, rk4 for hiro."""
    reset_noise: Annotated[float, Ge(0), Lt(1)] = 0.1
    """Half width of the uniform noise on qpos, standard deviation of the normal noise on qvel, at a reset.

    Deviation: 0.1 (the authors' environments: 0), so that ten evaluation episodes are not ten equal ones.
    """
    evaluation: Annotated[bool, Unasked()] = False
    """Whether a task with targets uses those of evaluation instead of those of training."""

    def __post_init__(self) -> None:
        """Check every value; the default integrator becomes that of the specification."""
        super().__post_init__()
        if self.integrator == "default":
            object.__setattr__(self, "integrator", SPECS[self.spec])


@dataclass(frozen=True, kw_only=True)
class FallOptions(TaskOptions):
    """Options of a task in which an episode of training can end by a fall."""

    max_tilt: Annotated[float | None, Gt(0), Lt(180)] = None
    """Degrees of tilt of the torso beyond which an episode of training ends as a fall. Evaluation does not use it. In
    Maze, Push and Fall, where no fall ends an episode as published, one by the rule of the body then does, too; the
    evolution strategies count the reward of that step, which is negative, for each of the steps left.
    """
