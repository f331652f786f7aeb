"""Gather: collect food and avoid poison.

Source: specification shes is the SHES authors' HrlMuJoCoEnvs.jl; hiro is rllab's GatherEnv (Duan et al. 2016).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product
from typing import ClassVar

import mujoco
import numpy as np

from shes.envs.bodies.body import Body, ObservationElement
from shes.envs.markers import FOOD, POISON, Marker
from shes.envs.tasks.task import TIME_ELEMENTS, TIME_SCALE, FallOptions, Task, TaskDescription, TaskOptions
from shes.envs.worlds import add_square_walls
from shes.types import BoolArray, F64Array, IntArray, to_host

NUM_OBJECTS = 8
"""Number of objects of each kind: food and poison."""
ACTIVITY_RANGE_M = 10.0
"""Half width of the square in which objects lie."""
FREE_RADIUS_M = 2.0
"""Least distance of objects from the origin."""
CATCH_RANGE_M = 1.0
"""An object nearer to the robot than this is collected."""
SENSOR_RANGE_M = {"shes": 8.0, "hiro": 6.0}
HIRO_WALLS_M = 10.5
"""Half width of the arena with specification hiro; with shes the walls are those of the grid."""
HIRO_FALL_REWARD = -10.0
"""Reward of the step of a fall, with specification hiro."""
NUM_BINS = 10
"""Sensor bins of each kind, over the full circle; bin 0 starts behind the robot."""
MARKER_RADIUS_M = 0.4
"""Radius of objects in pictures; they have no body."""
_BIN_RAD = 2 * np.pi / NUM_BINS
_ARC_LINES = 6
"""Lines of which the arc of a reading is drawn; even, so that the ray ends at a joint."""
_RAY_HEIGHT_M, _RAY_RADIUS_M, _RAY_OPACITY = 0.1, 0.03, 0.7
FOOD_REWARD, POISON_REWARD = 1.0, -1.0
"""Reward of an object of each kind."""


def _outside_free_radius(places: F64Array) -> F64Array:
    return places[(places**2).sum(axis=1) >= FREE_RADIUS_M**2]


_LATTICE = _outside_free_radius(np.array([*product(np.arange(-ACTIVITY_RANGE_M, ACTIVITY_RANGE_M, 2.0), repeat=2)]))
"""Positions with even coordinates at which objects lie with specification hiro [any, 2]."""


class Gather(Task):
    """Eight pieces of food (+1) and eight of poison (-1) lie between walls.

    The robot senses objects in ten sectors around its heading and collects those within 1 m. With `shes` objects lie
    anywhere, the sensors reach 8 m, and the walls are at 12 m. With `hiro` objects lie on even coordinates, the sensors
    reach 6 m, and the walls are at 10.5 m.
    """

    name: ClassVar[str] = "gather"
    specs: ClassVar[tuple[str, ...]] = ("shes", "hiro")
    Options = FallOptions
    options: FallOptions
    description: ClassVar[TaskDescription] = TaskDescription(
        reward="+1 for each piece of food and -1 for each piece of poison collected; hiro: -10 in the step of a fall",
        ends="when the robot falls over, by the rule of its body; hiro: also when everything is collected",
        score="highest running return in the episode, at least 0",
        success="the score is above 0",
    )

    def allocate(self) -> None:
        """Allocate objects, distances and the observation."""
        n, xp = self.num_episodes, self.xp
        self.sensor_rings = self.observation_names.index("food_0") + np.arange(2 * NUM_BINS).reshape(2, NUM_BINS)
        # Coordinates come first, [xy, N, kind, object], so that all x and all y are contiguous.
        self._places: F64Array = xp.zeros((2, n, 2, NUM_OBJECTS))
        self.present: BoolArray = xp.zeros((n, 2, NUM_OBJECTS), dtype=np.bool_)
        """Which objects have not been collected [N, kind, object]."""
        # First bin of each kind in the flat readings of all episodes [N, kind, 1].
        self._first_bin: IntArray = NUM_BINS * xp.arange(2 * n).reshape(n, 2, 1)
        self._best_return: F64Array = xp.zeros(n)
        self._offset: F64Array = xp.zeros(self._places.shape)
        self._squared_distance: F64Array = xp.zeros(self.present.shape)

    @classmethod
    def add_walls(cls, spec: mujoco.MjSpec, body: Body, options: TaskOptions) -> None:
        """Add the walls of the arena to `spec`, a free square between them; objects are not geoms."""
        if options.spec == "hiro":
            add_square_walls(spec, HIRO_WALLS_M, body.scale)
        else:
            super().add_walls(spec, body, options)

    @property
    def observation_spec(self) -> tuple[ObservationElement, ...]:
        """The robot's qpos and qvel, readings of food and poison, time; with hiro the time precedes the readings."""
        reading, width = "1 - d/6" if self.options.spec == "hiro" else "1 - d^2/8^2", 360 // NUM_BINS
        readings = tuple(
            ObservationElement(
                name=f"{kind}_{number}",
                meaning=f"{reading} of the nearest {kind} at a bearing of {first} to {first + width} degrees from the "
                "heading; 0 if none is in range",
                low=0.0,
                high=1.0,
            )
            for kind in ("food", "poison")
            for number, first in enumerate(range(-180, 180, width))
        )
        if self.options.spec == "hiro":
            return self.robot_elements() + TIME_ELEMENTS + readings
        return self.robot_elements() + readings + TIME_ELEMENTS

    @property
    def terminated(self) -> BoolArray:
        """Whether the robot has fallen [N]; with hiro also whether everything is collected."""
        fallen = self.is_down()
        return fallen | ~self.present.any(axis=(1, 2)) if self.options.spec == "hiro" else fallen

    @property
    def score(self) -> F64Array:
        """Highest running return in the episode, at least 0 [N]; 0 after a divergence."""
        return self._best_return * ~self.sim.diverged

    @property
    def success(self) -> BoolArray:
        """Whether the score is above 0 [N]: at some time more food than poison was collected."""
        return self.score > 0

    @property
    def distance(self) -> F64Array:
        """Distance to the nearest piece of food left [N], in units of `scale`; infinity if none is left."""
        left = np.where(self.present[:, 0], self._squared_distance[:, 0], np.inf)
        return np.sqrt(left.min(axis=1))

    @property
    def counts(self) -> dict[str, IntArray]:
        """Pieces of food and of poison collected [N]."""
        collected = NUM_OBJECTS - self.present.sum(axis=2)
        return {"food": collected[:, 0], "poison": collected[:, 1]}

    def markers(self, episode: int) -> list[Marker]:
        """Return the remaining objects as balls."""
        objects, present = to_host(self.objects[episode]), to_host(self.present[episode])
        return [
            Marker("ball", (*place, MARKER_RADIUS_M), MARKER_RADIUS_M, color)
            for kind, color in enumerate((FOOD, POISON))
            for place in objects[kind][present[kind]]
        ]

    def sensor_markers(self, episode: int) -> list[Marker]:
        """Return a ray and an arc for each reading that is not 0: its sector, and the distance that it tells."""
        readings = to_host(self._readings()[episode]).reshape(2, NUM_BINS)
        x, y = to_host(self.position[episode])
        markers = list[Marker]()
        for kind, number in np.argwhere(readings).tolist():
            left = 1 - readings[kind, number]
            distance = SENSOR_RANGE_M[self.options.spec] * (left if self.options.spec == "hiro" else left**0.5)
            first = float(self.heading[episode]) - np.pi + number * _BIN_RAD
            bearings = first + np.linspace(0, _BIN_RAD, _ARC_LINES + 1)
            arc = [(x + distance * np.cos(each), y + distance * np.sin(each), _RAY_HEIGHT_M) for each in bearings]
            ends = [((x, y, _RAY_HEIGHT_M), arc[_ARC_LINES // 2]), *pairwise(arc)]
            faint = (*(FOOD, POISON)[kind][:3], _RAY_OPACITY)
            markers += [Marker("line", start, _RAY_RADIUS_M, faint, end) for start, end in ends]
        return markers

    @property
    def objects(self) -> F64Array:
        """Positions of the objects [N, kind, object, xy] in units of `scale`, a view; kind 0 is food, 1 poison."""
        return np.moveaxis(self._places, 0, -1)

    def reset_features(self, ids: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        """Draw the objects of episodes `ids`; see `Task.reset_features`."""
        drawn = np.stack([self._draw_places(rng) for rng in rngs])  # [ids, object of any kind, xy]
        places = np.moveaxis(drawn, -1, 0).reshape(2, len(ids), 2, NUM_OBJECTS)
        rows = self.xp.asarray(ids)
        self._places[:, rows] = self.xp.asarray(places)
        self.present[rows] = True
        self._best_return[rows] = 0
        self._measure()

    def _draw_places(self, rng: np.random.Generator) -> F64Array:
        """Draw positions of all objects [2 * NUM_OBJECTS, 2]: distinct ones of the lattice, or uniform ones."""
        count = 2 * NUM_OBJECTS
        if self.options.spec == "hiro":
            return _LATTICE[rng.permutation(len(_LATTICE))[:count]]
        places = np.empty((0, 2))
        while len(places) < count:
            drawn = rng.uniform(-ACTIVITY_RANGE_M, ACTIVITY_RANGE_M, (2 * count, 2))
            places = np.concatenate([places, _outside_free_radius(drawn)])
        return places[:count]

    def _measure(self) -> None:
        np.subtract(self._places, self.position.T[:, :, None, None], out=self._offset)
        squares = self._offset * self._offset
        np.add(squares[0], squares[1], out=self._squared_distance)

    def update_features(self) -> F64Array:
        """Remove the objects that are collected and return the reward [N]; with hiro a fall is penalised."""
        self._measure()
        reward: F64Array = self.xp.zeros(self.num_episodes)
        collects_nothing = self.sim.diverged
        if self.options.spec == "hiro":
            fallen = self.is_down()
            reward = np.where(fallen, HIRO_FALL_REWARD, reward)
            collects_nothing = collects_nothing | fallen
        caught = self.present & (self._squared_distance < CATCH_RANGE_M**2)
        if self.xp is not np or caught.any():  # a device takes longer to answer than to compute
            caught &= ~collects_nothing[:, None, None]
            self.present ^= caught
            counts = caught.sum(axis=2)
            reward += counts[:, 0] * FOOD_REWARD + counts[:, 1] * POISON_REWARD
            np.maximum(self._best_return, self.running_return + reward, out=self._best_return)
        return reward

    def observe(self) -> F64Array:
        """Return robot, readings (without what this step has collected), and time [N, O]."""
        out, is_hiro = self._observation, self.options.spec == "hiro"
        end = self.write_robot(out)
        out[:, slice(end + 1, None) if is_hiro else slice(end, -1)] = self._readings()
        np.multiply(self.time, TIME_SCALE, out=out[:, end if is_hiro else -1])
        return out

    def _readings(self) -> F64Array:
        """Return the reading of the nearest object in each bin [N, kind * bin]; 0 in an empty bin.

        A reading is `1 - d^2 / range^2` with specification shes and `1 - d / range` with hiro.
        """
        sensor_range = SENSOR_RANGE_M[self.options.spec]
        if self.xp is np:
            seen = np.flatnonzero(self.present & (self._squared_distance < sensor_range**2))
            squared = self._squared_distance.ravel()[seen]
            x, y = self._offset.reshape(2, -1).take(seen, axis=1)
            row = seen // NUM_OBJECTS  # an episode's food, then its poison
            heading, first_bin = self.heading[row // 2], NUM_BINS * row
        else:
            # All objects, because selecting the visible ones would wait for the device. Others are moved to the end of
            # the range, where they read 0.
            end = sensor_range**2
            squared = np.minimum(np.where(self.present, self._squared_distance, end), end)
            x, y = self._offset[0], self._offset[1]
            heading, first_bin = self.heading[:, None, None], self._first_bin
        if self.options.spec == "hiro":
            intensity = 1 - np.sqrt(squared) / sensor_range
        else:
            intensity = 1 - squared / sensor_range**2
        bearing = np.arctan2(y, x) - heading
        turn = bearing / (2 * np.pi) + 0.5
        turn -= np.floor(turn)
        bins = np.minimum((turn * NUM_BINS).astype(np.intp), NUM_BINS - 1)
        bins += first_bin
        readings = self.xp.zeros(2 * self.num_episodes * NUM_BINS)
        self.xp.maximum.at(readings, bins, intensity)
        return readings.reshape(self.num_episodes, 2 * NUM_BINS)
