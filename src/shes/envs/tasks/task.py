"""The contract of a task: N episodes in a MuJoCo world, for training, evaluation and Gymnasium.

Lengths are in units of `Body.scale`: metres, but for a robot from a file, whose world has its size.

Source: time step, frame skip and observation scales follow the SHES authors' HrlMuJoCoEnvs.jl. A task owns its
simulator. It loops over episodes only in a reset, where each draws from its own seed.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, NamedTuple

import mujoco
import numpy as np

from shes.envs.bodies.body import MIN_COS_TILT, Body, ObservationElement, elements
from shes.envs.episode_batch import EpisodeBatch, Reader
from shes.envs.worlds import ARENA, INTEGRATORS, SCALE, Grid, add_grid, empty_world
from shes.errors import ConfigError, ShapeError, UnknownNameError
from shes.settings import Choices, Example, Ge, Gt, Le, Lt, Settings, Unasked
from shes.sim.simulator import CpuSimulator, Simulator
from shes.streams import EpisodePurpose, stream
from shes.types import BoolArray, F64Array, FloatArray, IntArray, to_host

SPECS = {"shes": "euler", "hiro": "rk4"}
"""Specifications and their integrators."""
FURTHEST_M = 1000.0
"""Largest coordinate of a target or goal: beyond every world, and small enough that its square is finite."""

Coordinates = Annotated[tuple[float, ...], Ge(-FURTHEST_M), Le(FURTHEST_M), Example("0 16")]
"""Coordinates of a point."""
TIME_SCALE = 0.001
"""Factor on the number of control steps in observations."""
TIME_ELEMENTS = elements(["time"], f"control steps since the reset, times {TIME_SCALE}", low=0.0)
"""The element of the time."""

SimulatorFactory = Callable[[mujoco.MjModel, int], Simulator]
"""Makes a simulator from a model and the number of simulations."""


@dataclass(frozen=True, kw_only=True)
class TaskOptions(Settings):
    """The options of every task: settings that may differ between two uses of it.

    A task with its own options names a subclass in `Options`. The flags of `shes train`, the arguments of
    `gymnasium.make` and the documentation follow from its fields.
    """

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
    evolution strategies count the reward of that step for each of the steps left, unless it is progress along a path.
    """


class TaskDescription(NamedTuple):
    """The task in words, for the documentation and `shes envs`."""

    reward: str
    ends: str
    """When an episode terminates."""
    score: str
    success: str
    """When an episode counts as solved."""


class BodyReader(Reader):
    """Observations are arrays [O] or [N, O]; actions lie in [-1, 1]."""

    def __init__(self, body: Body, observation_size: int, proprioception: IntArray) -> None:
        """Read observations of `observation_size` values; `proprioception` are the indices of qpos and qvel."""
        self.observation_size = observation_size
        self._body = body
        self._qpos = proprioception[: body.num_qpos]

    def rows(self, observation: Any, num_envs: int) -> tuple[F64Array, bool]:
        """Return `observation` as rows [num_envs, O], and whether it is a single [O]; see `Reader.rows`."""
        seen = np.asarray(observation, dtype=np.float64)
        rows = seen[None] if seen.ndim == 1 else seen
        if rows.shape != (num_envs, self.observation_size):
            size = self.observation_size
            raise ShapeError(f"observation must have shape ({size},) or ({num_envs}, {size}), got {seen.shape}.")
        return rows, seen.ndim == 1

    def locate(self, rows: F64Array, info: Mapping[str, Any] | None, env: Any = None) -> tuple[F64Array, F64Array]:
        """Return position [N, 2] and heading [N], from the observation alone; see `Reader.locate`."""
        qpos = rows[:, self._qpos]
        return self._body.position(qpos), self._body.heading(qpos)

    def to_action(self, control: F64Array) -> F64Array:
        """Return `control` [N, A] scaled and clipped to [-1, 1]."""
        return np.clip(control / self._body.control_limit, -1, 1)


class Task(EpisodeBatch):
    """N episodes of one task in a MuJoCo world. Arrays are live: copy what must outlast the next step."""

    name: ClassVar[str]
    """Name without the body, e.g. `gather`."""
    description: ClassVar[TaskDescription]
    """Reward, termination, score and success in words."""
    specs: ClassVar[tuple[str, ...]] = ("shes",)
    """Specifications that the task implements."""
    Options: ClassVar[Any] = TaskOptions
    falls_end: bool = False
    """Whether a fall ends an episode."""
    grid: ClassVar[Grid] = ARENA
    """The grid of the world; see `shes.envs.worlds`."""

    def __init__(
        self, body: Body, num_episodes: int, options: TaskOptions, simulator: SimulatorFactory = CpuSimulator
    ) -> None:
        """Build the world for `body` and `num_episodes` simulations of it."""
        if not isinstance(options, self.Options):
            options = self.Options(**vars(options))
        self.check_options(options)
        self.body = self.robot = body
        self.scale = body.scale
        self.step_s = body.frame_skip * body.timestep_s
        self.options: Any = options  # of class `Options`; subclasses narrow the annotation
        self.num_episodes = num_episodes
        self.action_size, self.control_limit = len(body.controls), body.control_limit
        self.sim = simulator(self.build_world(body, options).compile(), num_episodes)
        self.xp, self.starts_together = self.sim.xp, self.sim.starts_together
        self.states, self.check_buffers = self.sim.states, self.sim.check_buffers
        self._control_map = body.control_map and tuple(self.xp.asarray(each) for each in body.control_map)
        self.observation_names = tuple(element.name for element in self.observation_spec)
        self.observation_size = len(self.observation_names)
        if twice := next((name for name in self.observation_names if self.observation_names.count(name) > 1), None):
            raise ConfigError(f"two observed values of {body.name}-{self.name} are named {twice!r}. Rename the joint.")
        own = [self.observation_names.index(element.name) for element in (*body.pose, *body.velocity)]
        self.proprioception, self.primitive_view = np.array(own), np.arange(self.observation_size)
        self.position_columns = self.proprioception[:2]
        self.reader = BodyReader(body, self.observation_size, self.proprioception)
        self.time = self.xp.zeros(num_episodes, dtype=np.int64)
        self.reward, self.running_return = (self.xp.zeros(num_episodes) for _ in range(2))
        self.diverged, self.truncated = self.sim.diverged, self.xp.zeros(num_episodes, dtype=np.bool_)
        self._heading: F64Array | None = None  # computed when it is first read after a step
        self._observation: F64Array = self.xp.zeros((num_episodes, self.observation_size))
        max_tilt: float | None = getattr(options, "max_tilt", None)
        if max_tilt is not None:
            body.cos_tilt(self.sim.qpos)  # raises ConfigError for a body that cannot tilt
        self.min_cos_tilt = None if max_tilt is None or options.evaluation else float(np.cos(np.deg2rad(max_tilt)))
        self.allocate()

    def allocate(self) -> None:
        """Allocate the task's own arrays, at the end of the constructor.

        A task whose `primitive_view`, `sensor_rings` or `reader` is not that of its body sets it here.
        """

    @classmethod
    def check_options(cls, options: Any) -> None:
        """Check the options that depend on the task."""
        if options.spec not in cls.specs:
            raise UnknownNameError(f"specification of {cls.name}", options.spec, cls.specs, "Set --spec.")

    @classmethod
    def build_world(cls, body: Body, options: TaskOptions) -> mujoco.MjSpec:
        """Return the world of `grid` with `body` in it, ready to compile."""
        is_stiff = getattr(options, "stiff_contacts", "B" in "".join(cls.grid))
        spec = empty_world(f"{body.name}-{cls.name}", options.integrator, body.timestep_s, stiff_contacts=is_stiff)
        body.add_to(spec, cls.ground_m * body.scale)
        cls.add_walls(spec, body, options)
        if body.scale != 1:
            spec.add_numeric(name=SCALE, data=[body.scale], size=1)
        return spec

    @classmethod
    def add_walls(cls, spec: mujoco.MjSpec, body: Body, options: TaskOptions) -> None:  # noqa: ARG003 - as in Gather
        """Add the walls, platforms and blocks of `grid` to `spec`."""
        add_grid(spec, cls.grid, body.scale, body.block_factor)

    @property
    @abstractmethod
    def observation_spec(self) -> tuple[ObservationElement, ...]:
        """Observation spec: one element for each observed value, in order."""

    @property
    @abstractmethod
    def distance(self) -> F64Array:
        """Distance to what is to be reached next [N], in units of `scale`; infinity if nothing is left to reach."""

    @abstractmethod
    def reset_features(self, ids: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        """Draw the task's features, such as targets, for episodes `ids`; write each array once.

        Args:
            ids: Rows to reset.
            rngs: Generator of each episode: the only source of randomness.
        """

    @abstractmethod
    def update_features(self) -> F64Array:
        """Update the task after a step and return the reward [N]; the caller zeroes it where the physics diverged."""

    @property
    def physics_s(self) -> float:
        """Wall-clock seconds spent in the simulation so far."""
        return self.sim.physics_s

    @property
    def position(self) -> F64Array:
        """Robots' positions [N, 2]; see `EpisodeBatch.position`."""
        return self.body.position(self.sim.qpos)

    @property
    def heading(self) -> F64Array:
        """Robots' headings (yaw) [N] in radians."""
        if self._heading is None:
            self._heading = self.body.heading(self.sim.qpos)
        return self._heading

    @property
    def terminated(self) -> BoolArray:
        """Whether the task has ended the episode [N]: by default where the robot has fallen, or never."""
        return self.is_down() if self.falls_end else self.xp.zeros(self.num_episodes, dtype=np.bool_)

    @property
    def fallen(self) -> BoolArray:
        """Whether the robot's fall has ended the episode [N]."""
        return self.terminated & self.is_down()

    @property
    def tilt(self) -> F64Array:
        """Tilt as a fraction of a fall; see `EpisodeBatch.tilt`."""
        if not self.body.can_tilt:
            return super().tilt
        return self.xp.minimum((1 - self.body.cos_tilt(self.sim.qpos)) / (1 - MIN_COS_TILT), 1)

    def is_down(self) -> BoolArray:
        """Return whether robots lie [N], by the rule of the body or by `max_tilt`, even if that ends no episode."""
        fallen = self.body.fallen(self.sim.qpos, self.ground_m * self.scale)
        if self.min_cos_tilt is None:
            return fallen
        return fallen | (self.body.cos_tilt(self.sim.qpos) < self.min_cos_tilt)

    @property
    def counts(self) -> dict[str, IntArray]:
        """The task's own counters by name, each [N]: entries of `info`."""
        return {}

    def world_to_draw(self) -> mujoco.MjSpec:
        """Return a new world to draw poses in."""
        return self.build_world(self.body.as_drawn(), self.options)

    def pose(self, episode: int) -> F64Array:
        """Return a copy of the qpos [nq] of episode `episode`, as a NumPy array."""
        return to_host(self.sim.qpos[episode]).copy()

    def robot_elements(
        self, pose: tuple[ObservationElement, ...] = (), velocity: tuple[ObservationElement, ...] = ()
    ) -> tuple[ObservationElement, ...]:
        """Return the elements of what `write_robot` writes; `pose` and `velocity` are those of a block."""
        limit = np.inf if self.options.spec == "hiro" else self.body.velocity_clip
        speeds = (replace(each, low=-limit, high=limit) for each in (*self.body.velocity, *velocity))
        return (*self.body.pose, *pose, *speeds)

    def write_robot(self, out: F64Array, num_more: int = 0) -> int:
        """Write the robot's qpos and qvel, each with `num_more` values of a block, to `out`; return their number.

        Velocities are clipped with specification shes, unchanged with hiro.
        """
        num_qpos = self.body.num_qpos + num_more
        end = num_qpos + self.body.num_qvel + num_more
        out[:, :num_qpos] = self.sim.qpos[:, :num_qpos]
        velocity, written = self.sim.qvel[:, : end - num_qpos], out[:, num_qpos:end]
        if self.options.spec == "hiro":
            written[:] = velocity
        else:
            np.maximum(velocity, -self.body.velocity_clip, out=written)  # two ufuncs are faster than np.clip
            np.minimum(written, self.body.velocity_clip, out=written)
        return end

    def reset(self, ids: IntArray, seeds: Sequence[int], states: Sequence[F64Array | None] = ()) -> None:
        """Start new episodes in rows `ids`; see `EpisodeBatch.reset`."""
        self.sim.reset(ids)
        rngs = [stream(int(seed), EpisodePurpose.RESET) for seed in seeds]
        self._place_robots(ids, rngs)
        if given := [i for i, state in enumerate(states) if state is not None]:
            self.sim.set_states(ids[given], np.array([states[i] for i in given]))
        self._heading = None
        rows = self.xp.asarray(ids)
        for array in (self.time, self.reward, self.running_return):
            array[rows] = 0
        self.reset_features(ids, rngs)

    def step(self, ids: IntArray, action: FloatArray) -> None:
        """Advance episodes `ids` by one control step, without waiting for a device; see `EpisodeBatch.step`."""
        if self._control_map is None:
            self.sim.ctrl[:] = action
        else:
            offset, factor = self._control_map
            self.sim.ctrl[:] = offset + factor * action
        self.sim.step(ids, self.body.frame_skip)
        self._heading = None
        self.time += 1
        self.reward[:] = np.where(self.sim.diverged, 0.0, self.update_features())
        self.running_return += self.reward

    def _place_robots(self, ids: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        """Add the reset noise to the robots' default pose; blocks stay in place."""
        noise, robot = self.options.reset_noise, self.body
        if not noise and robot.home is None:
            return
        # Everything is drawn before anything is written: on a device every write is a transfer.
        drawn = [(rng.uniform(-noise, noise, robot.num_qpos), rng.normal(0, noise, robot.num_qvel)) for rng in rngs]
        offset = np.array([pose for pose, _ in drawn])
        offset[:, :3] *= robot.scale
        home = self.sim.model.qpos0[: robot.num_qpos].copy()
        if robot.home is not None:
            home[:] = robot.home
            home[2] += (self.ground_m + noise) * robot.scale  # so that no noise puts a foot below the ground
        qpos = home + offset
        if robot.quaternion is not None:
            quaternion = qpos[:, robot.quaternion]
            quaternion /= np.sqrt(np.vecdot(quaternion, quaternion))[:, None]
        xp, rows = self.xp, self.xp.asarray(ids)
        self.sim.qpos[rows, : robot.num_qpos] = xp.asarray(qpos)
        self.sim.qvel[rows, : robot.num_qvel] = xp.asarray(np.array([velocity for _, velocity in drawn]))
        if robot.home_activation is not None:
            self.sim.state_parts[4][rows] = xp.asarray(robot.home_activation)
