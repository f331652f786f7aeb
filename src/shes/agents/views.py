"""Views and clocks, which make the inputs of a level from an observation, and the choices of views of a run.

Source: SHES paper II-D (a transferred primitive sees the robot's own coordinates); `docs/learning.md` (egocentric
views).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np

from shes.envs.bodies.body import Body
from shes.envs.episode_batch import EpisodeBatch
from shes.registry import Registry, check_function
from shes.types import F64Array, IntArray

SECTORS_SCALE = {"position": 8.0, "velocity": 1.0}
"""Length in metres, and speed in metres per second, that read 1 in `SectorsView`."""


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Sine and cosine of the time since the start of the episode, at one frequency: a network has no rhythm of its own.

    Source: Siekmann et al. 2021, section III (sine and cosine of a gait's phase as inputs).
    """

    size: ClassVar[int] = 2
    """Number of features."""
    frequency_hz: float
    """Frequency in simulated time."""
    step_s: float
    """Simulated time of a control step in seconds."""

    def write(self, steps: IntArray, out: F64Array) -> None:
        """Write sine and cosine into `out` [P * R, 2], for lanes `steps` [P] control steps after their start."""
        phase = (2 * np.pi * self.frequency_hz * self.step_s) * steps[:, None]
        features = out.reshape(len(steps), -1, self.size)  # a view
        np.sin(phase, out=features[..., 0])  # broadcast over the episodes of a lane, which started together
        np.cos(phase, out=features[..., 1])


class View(ABC):
    """Selects or computes the values that a level sees. It is sent to worker processes."""

    is_egocentric: bool = False
    """Whether the values, like the goals, are expressed in the robot's own frame."""
    sees_last_goal: bool = False
    """Whether the last goal follows the observed values: x and y in the world frame, from where the robot was when it
    was set, divided by the goal distance; 0 before the first goal."""

    @abstractmethod
    def write(self, observation: F64Array, heading: F64Array, out: F64Array) -> F64Array:
        """Write the view of `observation` [N, O] into `out` [N, V], and return the angle of its frame [N] in radians.

        O is larger by 2 if the view sees the last goal. `heading` [N] is that of the robots; a view without a frame of
        its own returns it.
        """

    @abstractmethod
    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the values, given the names of the observed values."""

    def size(self, observation_size: int) -> int:
        """Return the number of values seen of an observation of `observation_size` values."""
        return len(self.names([""] * observation_size))

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return the view as JSON types, for an exported agent."""

    def on(self, xp: ModuleType) -> Self:
        """Return this view with its arrays as those of `xp`."""
        view = copy(self)
        arrays = {name: xp.asarray(each) for name, each in vars(self).items() if isinstance(each, np.ndarray)}
        vars(view).update(arrays)
        return view


class ColumnsView(View):
    """Some or all of the observed values, in any order."""

    def __init__(self, indices: Sequence[int] | None = None) -> None:
        """Select the values at `indices`, or all values if None."""
        self.indices = None if indices is None else tuple(int(index) for index in indices)
        self._columns = slice(None) if self.indices is None else _columns(self.indices)

    def write(self, observation: F64Array, heading: F64Array, out: F64Array) -> F64Array:
        """Copy the values; see `View.write`."""
        out[:] = observation[:, self._columns]
        return heading

    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the selected values."""
        indices = range(len(observation_names)) if self.indices is None else self.indices
        return tuple(observation_names[i] for i in indices)

    def to_dict(self) -> dict[str, Any]:
        """Return the indices; None stands for all values."""
        return {"kind": "columns", "columns": None if self.indices is None else list(self.indices)}


class EgocentricView(View):
    """The robot's state in its own frame, without its position, followed by other observed values.

    Deviation: the paper's policies see the torso's quaternion, and velocities in the world frame. A network has to
    learn the rotation before it can learn to walk.
    """

    is_egocentric = True

    def __init__(self, body: Body, proprioception: Sequence[int], others: Sequence[int] = ()) -> None:
        """See the state of `body`, whose qpos and qvel are at `proprioception`, then the values at `others`."""
        self.body, self._own = body, len(body.egocentric)
        self._places = [
            [int(index) for index in part]
            for part in (proprioception[: body.num_qpos], proprioception[body.num_qpos :], others)
        ]
        self._qpos, self._qvel, self._others = (_columns(part) for part in self._places)

    def write(self, observation: F64Array, heading: F64Array, out: F64Array) -> F64Array:
        """Compute the robot's own values and copy the others; return the angle of its own frame. See `View.write`."""
        qpos = observation[:, self._qpos]
        angle = self.body.frame_angle(qpos)
        self.body.write_egocentric(qpos, observation[:, self._qvel], angle, out[:, : self._own])
        if self._places[2]:
            out[:, self._own :] = observation[:, self._others]
        return angle

    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the robot's own values, then of the others."""
        own = (f"egocentric {element.name}" for element in self.body.egocentric)
        return (*own, *(observation_names[i] for i in self._places[2]))

    def to_dict(self) -> dict[str, Any]:
        """Return body or joints of its home pose, and the indices of its qpos and qvel and of the other values."""
        (qpos, qvel, others), home = self._places, self.body.home
        own = {"body": self.body.name} if home is None else {"body": "free", "home": home[7:].tolist()}
        return {"kind": "egocentric", **own, "qpos": qpos, "qvel": qvel, "columns": others}


def turned_back(vector: F64Array, angle: F64Array) -> F64Array:
    """Return `vector` [N, 2] rotated by minus `angle` [N]: from the world frame to the frame of a heading."""
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = vector[:, 0], vector[:, 1]
    return np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=1)


def sector_directions(num_sectors: int) -> tuple[F64Array, F64Array]:
    """Return x (ahead) and y (left) of the directions to the middles of sectors, the first of which begins behind."""
    middle = (np.arange(num_sectors) + 0.5) * (2 * np.pi / num_sectors) - np.pi
    return np.cos(middle), np.sin(middle)


class SectorsView(View):
    """A task's range sensors and vectors, each as one value per sector around the robot: a symmetric input.

    Turning the world around the robot, or mirroring it, permutes the sectors of every channel alike. The channels are
    the rings of sensors; their eighth powers, which resolve what is near as the readings resolve what is far; and the
    heading, the robot's position in the world, its velocity and the last goal. A vector's value in a sector is its
    component along the sector's middle. The heading is always straight ahead, so its values are constants, by which a
    controller can tell the sectors apart.

    Source: `docs/learning.md`, "Equivariant controllers".
    """

    sees_last_goal = True

    def __init__(
        self, rings: Sequence[Sequence[int]], vectors: Mapping[str, Sequence[int]], scale: float = 1.0
    ) -> None:
        """See the sensors at `rings` [ring, sector], and the vectors whose x and y are at these places, by name.

        `scale` is the number of metres that count as one. The last goal is at the end.
        """
        self.units = {**{name: scale * unit for name, unit in SECTORS_SCALE.items()}, "goal": 1.0}
        self.rings = tuple(tuple(ring) for ring in rings)
        self.vectors = {name: (int(x), int(y)) for name, (x, y) in vectors.items()}
        self.num_sectors = len(self.rings[0])
        """Number of sectors, S. The first begins straight behind the robot, the others follow counter-clockwise."""
        self.num_channels = 2 * len(self.rings) + 1 + len(self.vectors)
        """Number of values per sector, C."""
        self._columns = _columns([index for ring in self.rings for index in ring])
        self._ahead, self._left = sector_directions(self.num_sectors)

    def write(self, observation: F64Array, heading: F64Array, out: F64Array) -> F64Array:
        """Write the channels one after another; see `View.write`."""
        num_readings = len(self.rings) * self.num_sectors
        readings = observation[:, self._columns]
        out[:, :num_readings] = readings
        squares = readings * readings
        squares *= squares
        np.multiply(squares, squares, out=out[:, num_readings : 2 * num_readings])
        vectors = out[:, 2 * num_readings :].reshape(len(out), -1, self.num_sectors)
        vectors[:, 0] = self._ahead
        for number, (name, columns) in enumerate(self.vectors.items(), 1):
            ahead, left = turned_back(observation[:, columns] / self.units[name], heading).T
            vectors[:, number] = ahead[:, None] * self._ahead + left[:, None] * self._left
        out[:, 2 * num_readings :] = vectors.reshape(len(out), -1)
        return heading

    def names(self, observation_names: Sequence[str]) -> tuple[str, ...]:
        """Return the names of the sensors, twice, then those of the components of the vectors."""
        readings = tuple(observation_names[i] for ring in self.rings for i in ring)
        along = (f"{name} along sector {i}" for name in ("heading", *self.vectors) for i in range(self.num_sectors))
        return (*readings, *(f"{name}, eighth power" for name in readings), *along)

    def to_dict(self) -> dict[str, Any]:
        """Return the indices of the sensors and of each vector, with its scale."""
        vectors = [[*columns, self.units[name]] for name, columns in self.vectors.items()]
        return {"kind": "sectors", "rings": [list(ring) for ring in self.rings], "columns": [], "vectors": vectors}


def _columns(indices: Sequence[int]) -> slice | IntArray:
    """Return the index of columns `indices`. Neighbours become a slice, which is faster."""
    if indices and list(indices) == list(range(indices[0], indices[0] + len(indices))):
        return slice(indices[0], indices[0] + len(indices))
    return np.array(indices, dtype=np.int64)


ViewChoice: TypeAlias = Callable[[EpisodeBatch], View | str]
"""A function of a task that returns a level's view in it; without such a view, the end of the error message."""


def whole_observation(_task: EpisodeBatch) -> View:
    """The task's observation."""
    return ColumnsView()


def observation(task: EpisodeBatch) -> View:
    """The task's observation; only the robot's coordinates when the primitive learns without a controller."""
    return ColumnsView(task.primitive_view.tolist())


def proprioception(task: EpisodeBatch) -> View:
    """The robot's coordinates."""
    return ColumnsView(task.proprioception.tolist())


def egocentric(task: EpisodeBatch, others: Sequence[int] = ()) -> View | str:
    """The robot's state in its own frame, without its position."""
    if task.robot is None or not task.robot.egocentric:
        return "which has no egocentric view"
    return EgocentricView(task.robot, task.proprioception.tolist(), others)


def egocentric_and_others(task: EpisodeBatch) -> View | str:
    """The robot's state in its own frame, then the rest of the observation."""
    return egocentric(task, _others(task))


def sectors(task: EpisodeBatch) -> View | str:
    """The task's sensors, and vectors such as the position, by sector (Gather): what the equivariant network needs."""
    if not task.sensor_rings.size or not len(task.position_columns) or task.robot is None:
        return "and no sensors around it apart from its position, as Gather has"
    velocity = task.proprioception[task.robot.num_qpos :][:2]  # that of a root joint is in the world's frame
    vectors = {"position": task.position_columns.tolist(), "velocity": velocity.tolist()}
    vectors["goal"] = [task.observation_size, task.observation_size + 1]
    return SectorsView(task.sensor_rings.tolist(), vectors, task.scale)


def position(task: EpisodeBatch) -> View | str:
    """The robot's position and what is not the robot's, such as the target.

    Which way to take depends on nothing else, and each input of a controller adds the noise of its weights.
    """
    if not len(task.position_columns):
        return "which observes no absolute position"
    return ColumnsView([*task.position_columns.tolist(), *_others(task)])


def _others(task: EpisodeBatch) -> list[int]:
    """Return the indices of the observed values besides the robot's coordinates, in ascending order."""
    return sorted(set(range(task.observation_size)) - set(task.proprioception.tolist()))


PRIMITIVE_VIEWS: Registry[ViewChoice] = Registry(
    "primitive view",
    {"observation": observation, "proprioception": proprioception, "egocentric": egocentric},
    fix="Set --primitive-view.",
    check=check_function,
)
"""Views of the primitive by name: the choices of `--primitive-view`."""
CONTROLLER_VIEWS: Registry[ViewChoice] = Registry(
    "controller view",
    {"observation": whole_observation, "egocentric": egocentric_and_others, "sectors": sectors, "position": position},
    fix="Set --controller-view.",
    check=check_function,
)
"""Views of the controller by name: the choices of `--controller-view`."""
