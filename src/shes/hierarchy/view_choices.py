"""Choices of a level's view: which view a level has in an environment.

Source: SHES paper II-D (a transferred primitive sees the robot's own coordinates); `docs/learning.md` (egocentric
views).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

from shes.envs.episode_batch import EpisodeBatch
from shes.hierarchy.views import ColumnsView, EgocentricView, SectorsView, View
from shes.options import subclass_of
from shes.registry import Registry


class ViewChoice(ABC):
    """A choice of a level's view in any environment. It is made without arguments."""

    is_egocentric: ClassVar[bool] = False
    """Whether its views are egocentric."""
    lack: ClassVar[str] = "which has no such view"
    """End of the error message for a robot or a task without such a view."""
    sees_task: ClassVar[bool] = False
    """Whether a primitive sees more than the robot."""

    @abstractmethod
    def of(self, task: EpisodeBatch) -> View | None:
        """Return the view in `task`, or None if it has none."""


class WholeObservation(ViewChoice):
    """The task's observation."""

    def of(self, task: EpisodeBatch) -> View:
        """Return the view of all values."""
        return ColumnsView()


class Observation(ViewChoice):
    """The task's observation; only the robot's coordinates when the primitive learns without a controller."""

    sees_task = True

    def of(self, task: EpisodeBatch) -> View:
        """Return the view of what the task shows to primitives."""
        return ColumnsView(task.primitive_view.tolist())


class Proprioception(ViewChoice):
    """The robot's coordinates."""

    def of(self, task: EpisodeBatch) -> View:
        """Return the view of the robot's qpos and qvel."""
        return ColumnsView(task.proprioception.tolist())


class Egocentric(ViewChoice):
    """The robot's state in its own frame, without its position."""

    is_egocentric = True
    lack = "which has no egocentric view"

    def of(self, task: EpisodeBatch) -> View | None:
        """Return the egocentric view, if the robot has one."""
        if task.robot is None or not task.robot.egocentric:
            return None
        return EgocentricView(task.robot, task.proprioception.tolist(), self.others(task))

    def others(self, task: EpisodeBatch) -> Sequence[int]:
        """Return the indices of the observed values besides the robot's."""
        return ()


class EgocentricAndOthers(Egocentric):
    """The robot's state in its own frame, then the rest of the observation."""

    def others(self, task: EpisodeBatch) -> Sequence[int]:
        """Return the indices of all other values."""
        return _not_the_robots(task)


class Sectors(ViewChoice):
    """The task's sensors, and the heading and the position by sector (Gather): what the equivariant network needs."""

    lack = "and no sensors around it beside its position, as Gather has"

    def of(self, task: EpisodeBatch) -> View | None:
        """Return the view of the sensors and the vectors, if there are sensors and a position."""
        if not task.sensor_rings.size or not len(task.position_columns) or task.robot is None:
            return None
        velocity = task.proprioception[task.robot.num_qpos :][:2]  # that of a root joint is in the world's frame
        vectors = {"position": task.position_columns.tolist(), "velocity": velocity.tolist()}
        return SectorsView(task.sensor_rings.tolist(), vectors)


class Position(ViewChoice):
    """The robot's position and what is not the robot's, such as the target.

    Which way to take depends on nothing else, and each input of a controller adds the noise of its weights.
    """

    lack = "which observes no absolute position"

    def of(self, task: EpisodeBatch) -> View | None:
        """Return the view of the position and of all values but the robot's, if the position is known."""
        if not len(task.position_columns):
            return None
        return ColumnsView([*task.position_columns.tolist(), *_not_the_robots(task)])


def _not_the_robots(task: EpisodeBatch) -> list[int]:
    """Return the indices of the observed values besides the robot's coordinates, in ascending order."""
    return sorted(set(range(task.observation_size)) - set(task.proprioception.tolist()))


PRIMITIVE_VIEWS: Registry[type[ViewChoice]] = Registry(
    "primitive view",
    {"observation": Observation, "proprioception": Proprioception, "egocentric": Egocentric},
    fix="Set --primitive-view.",
    check=subclass_of(ViewChoice),
)
"""Views of the primitive by name: the choices of `--primitive-view`."""
CONTROLLER_VIEWS: Registry[type[ViewChoice]] = Registry(
    "controller view",
    {
        "observation": WholeObservation,
        "egocentric": EgocentricAndOthers,
        "sectors": Sectors,
        "position": Position,
    },
    fix="Set --controller-view.",
    check=subclass_of(ViewChoice),
)
"""Views of the controller by name: the choices of `--controller-view`."""
