"""The Task contract: an environment of our own, batched over N episodes, for training, evaluation and Gymnasium.

Source: environment specification, Common and Tasks. A task owns its simulator; nothing here loops over episodes
except a reset, where every episode draws from its own seed.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import ClassVar

import mujoco
import numpy as np

from shes.drawing.drawer import Drawer, Window
from shes.envs.body import Body
from shes.envs.body_reader import BodyReader
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.layout import ObservationElement, elements
from shes.envs.worlds import INTEGRATORS, TIMESTEP_S
from shes.errors import ConfigError, UnknownNameError
from shes.sim.cpu import CpuSimulator
from shes.sim.simulator import Simulator
from shes.types import BoolArray, F64Array, FloatArray, IntArray

__all__ = [
    "CONTROL_STEP_S",
    "FRAME_SKIP",
    "SPECS",
    "TARGET_SAMPLINGS",
    "TIME_SCALE",
    "VELOCITY_CLIP",
    "SimulatorFactory",
    "Task",
    "TaskDescription",
    "TaskOptions",
]

FRAME_SKIP = 5
"""Physics steps per control step: 0.1 s."""
CONTROL_STEP_S = FRAME_SKIP * TIMESTEP_S
VELOCITY_CLIP = 10.0
"""Generalised velocities are observed clipped to this, in m/s and rad/s."""
SPECS = {"shes": "euler", "hiro": "rk4"}
"""Specifications and their integrators."""
TARGET_SAMPLINGS = ("square", "free_cells")
TIME_SCALE = 0.001
"""Control steps are observed times this."""

_COMMON_OPTIONS = frozenset({"spec", "integrator", "reset_noise", "evaluation"})

SimulatorFactory = Callable[[mujoco.MjModel, int], Simulator]


@dataclass(frozen=True, kw_only=True)
class TaskOptions:
    """What may differ between two uses of one task."""

    spec: str = "shes"
    """Which published specification: `shes` (the SHES authors' environments) or `hiro` (Nachum et al. 2018, rllab)."""
    integrator: str = "default"
    """`euler`, `rk4`, `implicitfast`, or `default`: that of the specification, `euler` for shes and `rk4` for hiro."""
    reset_noise: float = 0.1
    """Half width of the uniform noise on qpos, standard deviation of the normal noise on qvel, at a reset.

    Deviation: 0.1 (the authors' environments: 0), so that ten evaluation episodes are not ten equal ones.
    """
    evaluation: bool = False
    """Whether evaluation's targets are used in place of training's, where the task has targets."""
    target_sampling: str = "square"
    """Maze, training: the target is uniform in the `square` [-4, 20] x [-4, 20] m, or there in `free_cells` only."""
    target: tuple[float, ...] | None = None
    """Maze, Push, Fall, training: a fixed target in metres in place of the task's own."""
    evaluation_target: tuple[float, ...] | None = None
    """Maze, Push, Fall: the target of evaluation in metres in place of the task's own."""
    observe_block: bool | None = None
    """Push, Fall: whether the block is observed; in shes it is, in hiro it is not, unless this says so."""
    fall_penalty: bool = True
    """Gather, hiro: whether the step of a fall pays -10 in place of its pickups."""
    goal_interval: int = 25
    """Flagrun: control steps that a goal is held."""

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ConfigError: A number is out of range.
            UnknownNameError: `spec`, `integrator` or `target_sampling` is not known.
        """
        if self.spec not in SPECS:
            raise UnknownNameError("spec", self.spec, SPECS, "Change spec (--spec).")
        if self.integrator == "default":
            object.__setattr__(self, "integrator", SPECS[self.spec])
        if self.integrator not in INTEGRATORS:
            raise UnknownNameError(
                "integrator", self.integrator, ("default", *INTEGRATORS), "Set integrator (--integrator)."
            )
        if self.target_sampling not in TARGET_SAMPLINGS:
            raise UnknownNameError("target sampling", self.target_sampling, TARGET_SAMPLINGS, "Set --target-sampling.")
        if self.goal_interval < 1:
            raise ConfigError(f"goal_interval must be at least 1, got {self.goal_interval}. Set --controller-interval.")
        is_number = isinstance(self.reset_noise, int | float | np.number)
        if not (is_number and 0 <= self.reset_noise < 1):
            raise ConfigError(f"reset_noise must be in [0, 1), got {self.reset_noise!r}. Set it (--reset-noise).")


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
    heeds: ClassVar[frozenset[str]] = frozenset()
    """Names of the options that this task heeds, beside those that every task does."""

    def __init__(
        self, body: Body, num_episodes: int, options: TaskOptions, simulator: SimulatorFactory = CpuSimulator
    ) -> None:
        """Build the world for `body` and `num_episodes` simulations of it."""
        self._check(options)
        self.body = body
        self.options = options
        self.num_episodes = num_episodes
        self.sim = simulator(self.build_spec(body, options).compile(), num_episodes)
        self.time: IntArray = np.zeros(num_episodes, dtype=np.int64)
        """Control steps since the reset [N]."""
        self._heading: F64Array | None = None  # of the present state, once asked for
        self.reward: F64Array = np.zeros(num_episodes)
        """Reward of the last step [N]; 0 where the simulation diverged."""
        self.running_return: F64Array = np.zeros(num_episodes)
        """Sum of the rewards since the reset [N]."""

    @classmethod
    def option_names(cls) -> frozenset[str]:
        """Return the names of the options that this task has."""
        return _COMMON_OPTIONS | cls.heeds

    @classmethod
    def _check(cls, options: TaskOptions) -> None:
        """Refuse options that this task has not.

        Raises:
            UnknownNameError: There is no such specification of it.
            ConfigError: An option that it does not heed is set.
        """
        if options.spec not in cls.specs:
            raise UnknownNameError(f"specification of {cls.name}", options.spec, cls.specs, "Set --spec.")
        for field in fields(TaskOptions):
            if field.name in cls.option_names() or getattr(options, field.name) == field.default:
                continue
            heeded = ", ".join(sorted(cls.option_names()))
            raise ConfigError(
                f"{cls.name} has no {field.name}, got {getattr(options, field.name)!r}. Its options: {heeded}. "
                f"Leave --{field.name.replace('_', '-')} away."
            )

    @classmethod
    @abstractmethod
    def build_spec(cls, body: Body, options: TaskOptions) -> mujoco.MjSpec:
        """Return the world with `body` in it, ready to compile."""

    @property
    @abstractmethod
    def layout(self) -> tuple[ObservationElement, ...]:
        """What is observed: one element for each value."""

    @property
    @abstractmethod
    def distance(self) -> F64Array:
        """Distance to what the task wants reached next [N], in metres; infinity where nothing is left to reach."""

    @abstractmethod
    def _reset_features(self, ids: IntArray, rngs: Sequence[np.random.Generator]) -> None:
        """Draw what belongs to the task (targets, objects) for episodes `ids`."""

    @abstractmethod
    def _update_features(self) -> F64Array:
        """Update the task after a step and return the reward [N], before the diverged ones are taken out."""

    @property
    def observation_size(self) -> int:
        """Number of observed values, O."""
        return len(self.layout)

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
        places = {element.name: index for index, element in enumerate(self.layout)}
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
        return np.zeros(self.num_episodes, dtype=np.bool_)

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

    def make_drawer(self, width: int, height: int) -> Drawer:
        """Return what makes pictures of poses.

        Raises:
            ConfigError: The size is not allowed, or MUJOCO_GL asks for what does not work here.
        """
        from shes.drawing.renderer import make_renderer

        return make_renderer(partial(self.build_spec, self.body, self.options), width, height)

    def open_window(self) -> Window:
        """Return a window that shows poses.

        Raises:
            ConfigError: There is no screen.
        """
        from shes.drawing.viewer import Viewer

        return Viewer(self.build_spec(self.body, self.options), self.step_s)

    def pose(self, episode: int) -> F64Array:
        """Return a copy of the qpos [nq] of episode `episode`."""
        return self.sim.qpos[episode].copy()

    def _robot_layout(self) -> tuple[ObservationElement, ...]:
        """Return the elements of the robot's qpos and qvel."""
        return self.body.pose + self._clipped(self.body.velocity)

    def _clipped(self, velocity: tuple[ObservationElement, ...]) -> tuple[ObservationElement, ...]:
        """Return the elements of velocities as this specification shows them."""
        if self.options.spec == "hiro":
            return velocity
        return tuple(replace(each, low=-VELOCITY_CLIP, high=VELOCITY_CLIP) for each in velocity)

    def _write_velocity(self, velocity: F64Array, out: F64Array) -> None:
        """Write velocities into `out` as this specification shows them: clipped in shes, as they are in hiro."""
        if self.options.spec == "hiro":
            out[:] = velocity
        else:
            np.clip(velocity, -VELOCITY_CLIP, VELOCITY_CLIP, out=out)

    @staticmethod
    def _time_layout() -> tuple[ObservationElement, ...]:
        """Return the element of the time."""
        return elements(["time"], f"control steps since the reset, times {TIME_SCALE}", low=0.0)

    def reset(self, ids: IntArray, seeds: Sequence[int]) -> None:
        """Start episodes `ids` anew, each from its own seed (a non-negative integer)."""
        self.sim.reset(ids)
        rngs = [
            np.random.Generator(np.random.PCG64(np.random.SeedSequence(int(seed), spawn_key=(0,)))) for seed in seeds
        ]
        for i, rng in zip(ids, rngs, strict=True):
            self._place_robot(int(i), rng)
        self._heading = None
        self.time[ids] = 0
        self.reward[ids] = 0
        self.running_return[ids] = 0
        self._reset_features(ids, rngs)

    def step(self, ids: IntArray, action: FloatArray) -> None:
        """Apply `action` [N, A] in control units for one control step of episodes `ids` (sorted, unique).

        Rows that are not in `ids` do not move; what is computed for them means nothing.
        """
        self.sim.ctrl[:] = action
        self.sim.step(ids, FRAME_SKIP)
        self._heading = None
        self.time += 1
        np.multiply(self._update_features(), ~self.sim.diverged, out=self.reward)
        self.running_return += self.reward

    def _place_robot(self, i: int, rng: np.random.Generator) -> None:
        """Put the robot of episode `i` into its default pose plus reset noise; blocks stay exactly in place."""
        noise = self.options.reset_noise
        if not noise:
            return
        robot = self.body
        self.sim.qpos[i, : robot.num_qpos] += rng.uniform(-noise, noise, robot.num_qpos)
        self.sim.qvel[i, : robot.num_qvel] += rng.normal(0, noise, robot.num_qvel)
        if robot.quaternion is not None:
            quaternion = self.sim.qpos[i, robot.quaternion]
            quaternion /= np.linalg.norm(quaternion)
