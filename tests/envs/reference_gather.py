"""Plain reference of Ant Gather and Point Gather (spec "shes"), written independently of the package, for its tests.

Sources: docs/environments/index.md, and where it is silent sash-a/HrlMuJoCoEnvs.jl (assets/easier_ant.xml,
src/Gather, src/WorldStructure.jl). One environment, one object at a time, float64: simple, not fast.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

PHYSICS_STEPS = 5  # per control step
NUMBER_OF_BINS = 10
SENSOR_RANGE = 8.0
CATCH_DISTANCE = 1.0
LOWEST_TORSO = 0.2
HIGHEST_TORSO = 1.0
VELOCITY_LIMIT = 10.0
DIVERGENCE_WARNINGS = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)

# `##### / #...# / #.r.# / #...# / #####` in cells of 8 x 8: wall cells from 12 to 20 on each side, 4 high.
WALLS = """
    <geom name="wall_north" type="box" pos="0 16 2" size="20 4 2" contype="1" conaffinity="1"/>
    <geom name="wall_south" type="box" pos="0 -16 2" size="20 4 2" contype="1" conaffinity="1"/>
    <geom name="wall_east" type="box" pos="16 0 2" size="4 12 2" contype="1" conaffinity="1"/>
    <geom name="wall_west" type="box" pos="-16 0 2" size="4 12 2" contype="1" conaffinity="1"/>
"""

ANT_GATHER = """
<mujoco model="reference_ant_gather">
  <compiler angle="degree" inertiafromgeom="true"/>
  <option timestep="0.02" integrator="Euler"/>
  <default>
    <joint limited="true" armature="1" damping="1"/>
    <geom contype="1" conaffinity="0" condim="3" density="5" margin="0.01" friction="1 0.5 0.5"
          solref="0.02 1" solimp="0.8 0.8 0.01"/>
    <motor gear="1" ctrllimited="true" ctrlrange="-30 30"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" pos="0 0 0" size="40 40 40" conaffinity="1"/>
    <body name="torso" pos="0 0 0.75">
      <joint name="root" type="free" limited="false" margin="0.01" armature="0" damping="0"/>
      <geom name="torso" type="sphere" size="0.25"/>
      <body name="leg_1" pos="0 0 0">
        <geom name="fixed_1" type="capsule" size="0.08" fromto="0 0 0 0.2 0.2 0"/>
        <body name="upper_1" pos="0.2 0.2 0">
          <joint name="hip_1" type="hinge" axis="0 0 1" range="-30 30"/>
          <geom name="upper_1" type="capsule" size="0.08" fromto="0 0 0 0.2 0.2 0"/>
          <body name="lower_1" pos="0.2 0.2 0">
            <joint name="ankle_1" type="hinge" axis="-1 1 0" range="30 70"/>
            <geom name="lower_1" type="capsule" size="0.08" fromto="0 0 0 0.4 0.4 0"/>
          </body>
        </body>
      </body>
      <body name="leg_2" pos="0 0 0">
        <geom name="fixed_2" type="capsule" size="0.08" fromto="0 0 0 -0.2 0.2 0"/>
        <body name="upper_2" pos="-0.2 0.2 0">
          <joint name="hip_2" type="hinge" axis="0 0 1" range="-30 30"/>
          <geom name="upper_2" type="capsule" size="0.08" fromto="0 0 0 -0.2 0.2 0"/>
          <body name="lower_2" pos="-0.2 0.2 0">
            <joint name="ankle_2" type="hinge" axis="1 1 0" range="-70 -30"/>
            <geom name="lower_2" type="capsule" size="0.08" fromto="0 0 0 -0.4 0.4 0"/>
          </body>
        </body>
      </body>
      <body name="leg_3" pos="0 0 0">
        <geom name="fixed_3" type="capsule" size="0.08" fromto="0 0 0 -0.2 -0.2 0"/>
        <body name="upper_3" pos="-0.2 -0.2 0">
          <joint name="hip_3" type="hinge" axis="0 0 1" range="-30 30"/>
          <geom name="upper_3" type="capsule" size="0.08" fromto="0 0 0 -0.2 -0.2 0"/>
          <body name="lower_3" pos="-0.2 -0.2 0">
            <joint name="ankle_3" type="hinge" axis="-1 1 0" range="-70 -30"/>
            <geom name="lower_3" type="capsule" size="0.08" fromto="0 0 0 -0.4 -0.4 0"/>
          </body>
        </body>
      </body>
      <body name="leg_4" pos="0 0 0">
        <geom name="fixed_4" type="capsule" size="0.08" fromto="0 0 0 0.2 -0.2 0"/>
        <body name="upper_4" pos="0.2 -0.2 0">
          <joint name="hip_4" type="hinge" axis="0 0 1" range="-30 30"/>
          <geom name="upper_4" type="capsule" size="0.08" fromto="0 0 0 0.2 -0.2 0"/>
          <body name="lower_4" pos="0.2 -0.2 0">
            <joint name="ankle_4" type="hinge" axis="1 1 0" range="30 70"/>
            <geom name="lower_4" type="capsule" size="0.08" fromto="0 0 0 0.4 -0.4 0"/>
          </body>
        </body>
      </body>
    </body>
WALLS
  </worldbody>
  <actuator>
    <motor name="hip_4" joint="hip_4"/>
    <motor name="ankle_4" joint="ankle_4"/>
    <motor name="hip_1" joint="hip_1"/>
    <motor name="ankle_1" joint="ankle_1"/>
    <motor name="hip_2" joint="hip_2"/>
    <motor name="ankle_2" joint="ankle_2"/>
    <motor name="hip_3" joint="hip_3"/>
    <motor name="ankle_3" joint="ankle_3"/>
  </actuator>
</mujoco>
"""

POINT_GATHER = """
<mujoco model="reference_point_gather">
  <compiler angle="degree" inertiafromgeom="true"/>
  <option timestep="0.02" integrator="Euler" gravity="0 0 0"/>
  <default>
    <geom contype="1" conaffinity="0" condim="3" margin="0.01" friction="1 0.5 0.5"
          solref="0.02 1" solimp="0.8 0.8 0.01"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" pos="0 0 0" size="40 40 40" contype="0" conaffinity="0"/>
    <body name="point" pos="0 0 0.5">
      <joint name="x" type="slide" axis="1 0 0" limited="true" range="-100 100" armature="ARMATURE" damping="DAMPING"/>
      <joint name="y" type="slide" axis="0 1 0" limited="true" range="-100 100" armature="ARMATURE" damping="DAMPING"/>
      <geom name="point" type="sphere" size="0.25" mass="0.33"/>
    </body>
WALLS
  </worldbody>
  <actuator>
    <motor name="x" joint="x" gear="GEAR" ctrllimited="true" ctrlrange="-1 1"/>
    <motor name="y" joint="y" gear="GEAR" ctrllimited="true" ctrlrange="-1 1"/>
  </actuator>
</mujoco>
"""


def ant_gather_xml() -> str:
    """The ant in the Gather world (assets/easier_ant.xml)."""
    return ANT_GATHER.replace("WALLS", WALLS)


def point_gather_xml(gear: float = 3.0, damping: float = 0.4, armature: float = 0.0) -> str:
    """The point in the Gather world."""
    text = POINT_GATHER.replace("WALLS", WALLS)
    text = text.replace("GEAR", repr(float(gear)))
    text = text.replace("DAMPING", repr(float(damping)))
    return text.replace("ARMATURE", repr(float(armature)))


def yaw(quaternion: ArrayLike) -> float:
    """Direction in the xy plane of the rotated x axis; the quaternion is w x y z."""
    w, x, y, z = (float(value) for value in np.asarray(quaternion, dtype=np.float64))
    length_squared = w * w + x * x + y * y + z * z
    rotation = (
        np.array(
            [
                [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
            ]
        )
        / length_squared
    )
    rotated_x_axis = rotation @ np.array([1.0, 0.0, 0.0])
    return math.atan2(rotated_x_axis[1], rotated_x_axis[0])


def readings(
    position: Sequence[float] | Array,
    heading: float,
    objects_left: Iterable[Sequence[float] | Array],
    bins: int = NUMBER_OF_BINS,
    sensor_range: float = SENSOR_RANGE,
) -> Array:
    """Readings of one kind of object (`_sensor_readings` in src/Gather/GatherBase.jl).

    Bin b covers bearings from -pi + b * 2 pi / bins (included) to the next bin's start (excluded).
    """
    nearest_squared = [math.inf] * bins
    for thing in objects_left:
        dx = float(thing[0]) - float(position[0])
        dy = float(thing[1]) - float(position[1])
        distance_squared = dx * dx + dy * dy
        if distance_squared > sensor_range * sensor_range:
            continue
        bearing = math.atan2(dy, dx) - heading
        while bearing >= math.pi:
            bearing -= 2 * math.pi
        while bearing < -math.pi:
            bearing += 2 * math.pi
        index = math.floor((bearing + math.pi) / (2 * math.pi / bins))
        index = min(index, bins - 1)  # a bearing one rounding error below pi
        nearest_squared[index] = min(nearest_squared[index], distance_squared)
    result = np.zeros(bins)
    for index in range(bins):
        if nearest_squared[index] < math.inf:
            result[index] = 1.0 - nearest_squared[index] / (sensor_range * sensor_range)
    return result


class ReferenceGather:
    """One Gather environment on one MjData (src/Gather/AntGather.jl).

    The time limit is the caller's. Objects are picked up by a step only, never by a reset.
    """

    def __init__(self, model: mujoco.MjModel, body: Literal["ant", "point"]) -> None:
        if body not in ("ant", "point"):
            raise ValueError(f"unknown body {body!r}")
        self.model = model
        self.body = body
        self.data = mujoco.MjData(model)
        self.food: list[Array] = []
        self.poison: list[Array] = []
        self.steps = 0
        self.food_count = 0
        self.poison_count = 0
        self.running_return = 0.0
        self.score = 0.0

    def reset(self, qpos: ArrayLike, qvel: ArrayLike, food: ArrayLike, poison: ArrayLike) -> Array:
        """Start an episode in exactly this state, with these objects, and return the first observation."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = np.asarray(qpos, dtype=np.float64)
        self.data.qvel[:] = np.asarray(qvel, dtype=np.float64)
        self.food = [thing.copy() for thing in np.asarray(food, dtype=np.float64).reshape(-1, 2)]
        self.poison = [thing.copy() for thing in np.asarray(poison, dtype=np.float64).reshape(-1, 2)]
        self.steps = 0
        self.food_count = 0
        self.poison_count = 0
        self.running_return = 0.0
        self.score = 0.0
        return self.observation()

    def step(self, action_in_control_units: ArrayLike) -> tuple[Array, float, bool, dict[str, float]]:
        """One control step of 0.1 s: physics, then pickups, then readings."""
        action = np.asarray(action_in_control_units, dtype=np.float64)
        if action.shape != (self.model.nu,) or not np.all(np.isfinite(action)):
            raise ValueError(f"not an action: {action}")
        for _ in range(PHYSICS_STEPS):
            self.data.ctrl[:] = action
            mujoco.mj_step(self.model, self.data)
        for warning in DIVERGENCE_WARNINGS:
            if self.data.warning[warning].number > 0:
                raise RuntimeError(f"the simulation diverged: {warning}")
        self.steps += 1

        food_now, self.food = self._pick_up(self.food)
        poison_now, self.poison = self._pick_up(self.poison)
        self.food_count += food_now
        self.poison_count += poison_now
        reward = float(food_now - poison_now)
        self.running_return += reward
        self.score = max(self.score, self.running_return)

        info: dict[str, float] = {
            "food_count": self.food_count,
            "poison_count": self.poison_count,
            "score": self.score,
            "return": self.running_return,
        }
        return self.observation(), reward, self.terminated(), info

    def position(self) -> Array:
        """Where the robot is in the xy plane; the first two of qpos for both bodies."""
        return self.data.qpos[0:2].copy()

    def heading(self) -> float:
        """The ant's yaw; always 0 for the point."""
        if self.body == "point":
            return 0.0
        return yaw(self.data.qpos[3:7])

    def terminated(self) -> bool:
        """Whether the ant's torso is outside [0.2, 1.0] (`isdone` in src/Gather/AntGather.jl)."""
        if self.body == "point":
            return False
        height = float(self.data.qpos[2])
        return not (LOWEST_TORSO <= height <= HIGHEST_TORSO)

    def observation(self) -> Array:
        """qpos, qvel clipped to 10 either way, food readings, poison readings, steps / 1000."""
        values: list[float] = []
        for coordinate in self.data.qpos:
            values.append(float(coordinate))
        for velocity in self.data.qvel:
            values.append(min(max(float(velocity), -VELOCITY_LIMIT), VELOCITY_LIMIT))
        values.extend(readings(self.position(), self.heading(), self.food))
        values.extend(readings(self.position(), self.heading(), self.poison))
        values.append(self.steps * 0.001)
        return np.array(values, dtype=np.float64)

    def _pick_up(self, things: list[Array]) -> tuple[int, list[Array]]:
        """How many of these are nearer than 1, and the others (`_collect_collectibles!` in GatherBase.jl)."""
        x, y = self.position()
        caught = 0
        left: list[Array] = []
        for thing in things:
            distance_squared = (thing[0] - x) ** 2 + (thing[1] - y) ** 2
            if distance_squared < CATCH_DISTANCE**2:
                caught += 1
            else:
                left.append(thing)
        return caught, left
