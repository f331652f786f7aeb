"""The Task contract: an environment of our own, batched over N episodes, for training, evaluation and Gymnasium.

Source: environment specification, Common and Tasks. A task owns its simulator; nothing here loops over episodes
except a reset, where every episode draws from its own seed.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, ClassVar

import mujoco
import numpy as np

from shes.arrays import to_host
from shes.envs.bodies.body import Body
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.observation_spec import ObservationElement, elements
from shes.envs.tasks.body_reader import BodyReader
from shes.envs.tasks.options import TaskOptions
from shes.envs.worlds import TIMESTEP_S
from shes.errors import UnknownNameError
from shes.sim.cpu import CpuSimulator
from shes.sim.simulator import Simulator
from shes.types import BoolArray, F64Array, FloatArray, IntArray

__all__ = [
    "CONTROL_STEP_S",
    "FRAME_SKIP",
    "TIME_SCALE",
    "VELOCITY_CLIP",
    "SimulatorFactory",
    "Task",
    "TaskDescription",
]

FRAME_SKIP = 5
"""Physics steps per control step: 0.1 s."""
CONTROL_STEP_S = FRAME_SKIP * TIMESTEP_S
VELOCITY_CLIP = 10.0
"""Generalised velocities are observed clipped to this, in m/s and rad/s."""
TIME_SCALE = 0.001
"""Control steps are observed times this, but for the hiro Gather."""

SimulatorFactory = Callable[[mujoco.MjModel, int], Simulator]


@dataclass(frozen=True, kw_only=True)
class TaskDescription:
    """What a task pays for and when it ends, in words: the documentation and `shes envs` are made from it."""

    reward: str
    """Reward of a step."""
    ends: str
    """When an episode ends by the task's own rule."""
    score: str
    """Test score of an episode."""
    success: str
    """When an episode counts as solved."""


class Task(EpisodeBatch):
    """N episodes of one task in a MuJoCo world. Arrays are live: copy what must outlast the next step."""

    name: ClassVar[str]
    """Name without the body: `gather`."""
    description: ClassVar[TaskDescription]
    """Reward, ending and score in words."""
    step_s = CONTROL_STEP_S
    specs: ClassVar[tuple[str, ...]] = ("shes",)
    """Specifications that there are of this task."""
    sets_goals: ClassVar[bool] = False
    """Whether it tells the robot where to go, so that a primitive learns in it without a controller."""
    Options: ClassVar[Any] = TaskOptions
    """Its options: a subclass of `TaskOptions` where it has its own beside those of every task."""

    def __init__(
        self, body: Body, num_episodes: int, options: TaskOptions, simulator: SimulatorFactory = CpuSimulator
    ) -> None:
        """Build the world for `body` and `num_episodes` simulations of it."""
        if not isinstance(options, self.Options):
            options = self.Options(**vars(options))
        self.check_options(options)
        self.body = body
        self.options: Any = options  # any: a subclass says by its annotation of which class
        """Its options, of class `Options`; a subclass with its own says so in its annotations."""
        self.num_episodes = num_episodes
        self.sim = simulator(self.build_world(body, options).compile(), num_episodes)
        self.time: IntArray = self.xp.zeros(num_episodes, dtype=np.int64)
        """Control steps since the reset [N]."""
        self._heading: F64Array | None = None  # of the present state, once asked for
        self.reward: F64Array = self.xp.zeros(num_episodes)
        """Reward of the last step [N]; 0 where the simulation diverged."""
        self.running_return: F64Array = self.xp.zeros(num_episodes)
        """Sum of the rewards since the reset [N]."""

    @property
    def xp(self) -> ModuleType:
        """Array module of the simulator, and so of every array here."""
        return self.sim.xp

    @property
    def robot(self) -> Body:
        """The robot."""
        return self.body

    @property
    def starts_together(self) -> bool:
        """Whether episodes had best be reset all together."""
        return self.sim.starts_together

    @property
    def physics_s(self) -> float:
        """Seconds of wall clock spent in the simulation so far."""
        return self.sim.physics_s

    def check_buffers(self) -> None:
        """Refuse physics for which the simulator had too little room; ask once a generation.

        Raises:
            ConfigError: Contacts or constraints were left out.
        """
        self.sim.check_buffers()

    @classmethod
    def check_options(cls, options: Any) -> None:
        """Refuse options that this task cannot have; where its class of options cannot tell by itself.

        Raises:
            UnknownNameError: There is no such specification of it.
            ConfigError: A value does not fit.
        """
        if options.spec not in cls.specs:
            raise UnknownNameError(f"specification of {cls.name}", options.spec, cls.specs, "Set --spec.")

    @classmethod
    @abstractmethod
    def build_world(cls, body: Body, options: TaskOptions) -> mujoco.MjSpec:
        """Return the world with `body` in it, ready to compile."""

    @property
    @abstractmethod
    def observation_spec(self) -> tuple[ObservationElement, ...]:
        """What is observed: one element for each value."""

    @property
    @abstractmethod
    def distance(self) -> F64Array:
        """Distance to what the task wants reached next [N], in metres; infinity where nothing is left to reach."""

    @abstractmethod
    def reset_features(self, ids: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        """Draw what belongs to the task (targets, objects) for episodes `ids`; upload it with one write an array."""

    @abstractmethod
    def update_features(self) -> F64Array:
        """Update the task after a step and return the reward [N], before the diverged ones are taken out."""

    @property
    def observation_size(self) -> int:
        """Number of observed values, O."""
        return len(self.observation_spec)

    @property
    def observation_names(self) -> tuple[str, ...]:
        """What each value of the observation is called."""
        return tuple(element.name for element in self.observation_spec)

    @property
    def position_columns(self) -> IntArray:
        """Indices in the observation of the robot's absolute x and y."""
        return self.proprioception[:2]

    @property
    def action_size(self) -> int:
        """Number of controls, A."""
        return self.body.num_controls

    @property
    def control_limit(self) -> float:
        """Controls lie in [-control_limit, control_limit]."""
        return self.body.control_limit

    @property
    def proprioception(self) -> IntArray:
        """Indices in the observation of the robot's own qpos and qvel, in that order."""
        places = {name: index for index, name in enumerate(self.observation_names)}
        return np.array([places[element.name] for element in (*self.body.pose, *self.body.velocity)])

    @property
    def primitive_view(self) -> IntArray:
        """Indices in the observation of what the primitive may see; the rest is for the controller alone."""
        return np.arange(self.observation_size)

    @property
    def position(self) -> F64Array:
        """Place of the robot [N, 2] in metres."""
        return self.body.position(self.sim.qpos)

    @property
    def heading(self) -> F64Array:
        """Yaw of the robot [N] in radians."""
        if self._heading is None:
            self._heading = self.body.heading(self.sim.qpos)
        return self._heading

    @property
    def terminated(self) -> BoolArray:
        """Whether the episode has ended by the task's own rule [N]; never by the time limit."""
        return self.xp.zeros(self.num_episodes, dtype=np.bool_)

    @property
    def fallen(self) -> BoolArray:
        """Whether the robot's fall has ended the episode [N]: other ends, as of a task that is done, are none."""
        return self.terminated & self.body.fallen(self.sim.qpos)

    @property
    def diverged(self) -> BoolArray:
        """Whether the physics blew up since the reset [N]: the episode ends there and does not score."""
        return self.sim.diverged

    @property
    def counts(self) -> dict[str, IntArray]:
        """What the task counts in an episode, by name [N]: for `info`."""
        return {}

    @property
    def reader(self) -> BodyReader:
        """How an agent reads what it shows."""
        return BodyReader(self.body, self.observation_size, self.proprioception)

    def world_to_draw(self) -> mujoco.MjSpec:
        """Return the world to draw poses in, made anew."""
        return self.build_world(self.body, self.options)

    def pose(self, episode: int) -> F64Array:
        """Return a copy of the qpos [nq] of episode `episode`, in NumPy's array."""
        return to_host(self.sim.qpos[episode]).copy()

    def robot_elements(self) -> tuple[ObservationElement, ...]:
        """Return the elements of the robot's qpos and qvel."""
        return self.body.pose + self.velocity_elements(self.body.velocity)

    def velocity_elements(self, velocity: tuple[ObservationElement, ...]) -> tuple[ObservationElement, ...]:
        """Return the elements of velocities as this specification shows them."""
        if self.options.spec == "hiro":
            return velocity
        return tuple(replace(each, low=-VELOCITY_CLIP, high=VELOCITY_CLIP) for each in velocity)

    def write_velocity(self, velocity: F64Array, out: F64Array) -> None:
        """Write velocities into `out` as this specification shows them: clipped in shes, as they are in hiro."""
        if self.options.spec == "hiro":
            out[:] = velocity
        else:
            np.maximum(velocity, -VELOCITY_CLIP, out=out)  # two ufuncs are quicker than np.clip
            np.minimum(out, VELOCITY_CLIP, out=out)

    @staticmethod
    def time_elements(scale: float = TIME_SCALE) -> tuple[ObservationElement, ...]:
        """Return the element of the time."""
        scaled = "" if scale == 1 else f", times {scale}"
        return elements(["time"], f"control steps since the reset{scaled}", low=0.0)

    def states(self, ids: IntArray) -> F64Array:
        """Return copies of the whole physics states of episodes `ids` [ids, S]."""
        return self.sim.states(ids)

    def reset(self, ids: IntArray, seeds: Sequence[int], states: Sequence[F64Array | None] = ()) -> None:
        """Start episodes `ids` anew, each from its own seed; see `EpisodeBatch.reset`."""
        self.sim.reset(ids)
        rngs = [
            np.random.Generator(np.random.PCG64(np.random.SeedSequence(int(seed), spawn_key=(0,)))) for seed in seeds
        ]
        self._place_robots(ids, rngs)
        given = [i for i, state in enumerate(states) if state is not None]
        if given:
            self.sim.set_states(ids[given], np.array([states[i] for i in given]))
        self._heading = None
        rows = self.xp.asarray(ids)
        self.time[rows] = 0
        self.reward[rows] = 0
        self.running_return[rows] = 0
        self.reset_features(ids, rngs)

    def step(self, ids: IntArray, action: FloatArray) -> None:
        """Apply `action` [N, A] in control units for one control step of episodes `ids` (sorted, unique).

        Rows that are not in `ids` do not move; what is computed for them means nothing. A device is not waited for.
        """
        self.sim.ctrl[:] = action
        self.sim.step(ids, FRAME_SKIP)
        self._heading = None
        self.time += 1
        self.reward[:] = np.where(self.sim.diverged, 0.0, self.update_features())
        self.running_return += self.reward

    def _place_robots(self, ids: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        """Put the robots of episodes `ids` into their default pose plus reset noise; blocks stay exactly in place."""
        noise, robot = self.options.reset_noise, self.body
        if not noise:
            return
        # Everything is drawn before anything is written: on a device every write is a transfer.
        drawn = [(rng.uniform(-noise, noise, robot.num_qpos), rng.normal(0, noise, robot.num_qvel)) for rng in rngs]
        qpos = self.sim.model.qpos0[: robot.num_qpos] + np.array([pose for pose, _ in drawn])
        if robot.quaternion is not None:
            quaternion = qpos[:, robot.quaternion]
            quaternion /= np.sqrt(np.vecdot(quaternion, quaternion))[:, None]
        xp, rows = self.xp, self.xp.asarray(ids)
        self.sim.qpos[rows, : robot.num_qpos] = xp.asarray(qpos)
        self.sim.qvel[rows, : robot.num_qvel] = xp.asarray(np.array([velocity for _, velocity in drawn]))
