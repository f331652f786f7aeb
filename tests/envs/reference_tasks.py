"""Plain reference of every task, written independently of the package for tests.

Sources: docs/environments/index.md and docs/algorithm.md (they decide); then sash-a/HrlMuJoCoEnvs.jl (JR)
for `shes`, Nachum et al. 2018's efficient-hrl and rllab's GatherEnv for `hiro`. One episode, one `MjData`, plain loops.

What these leave open about tasks, and how it is decided here (worlds: see reference_worlds.py):
 1. hiro Maze, Push, Fall: "target raw to the high level only". The observation returned is the 30 numbers and then the
    raw target (32, 32, 33); `low_level_observation()` is the first 30. qvel is unclipped in every hiro task.
 2. hiro Gather's "t" is t * 0.001, as in the other tasks, of which the HIRO paper says "t", too. It stands before the
    readings, in shes Gather behind them.
 3. Maze's score is against the episode's own target, which is (0, 16) in evaluation (JR: always against (0, 16)).
 4. "Final distance": score, success and distance are those of the last step played; after a reset, of the start.
 5. Free cells for `free_cells`: all cells without a wall, the robot's own included. The whole pair is redrawn.
 6. Flagrun's new goal comes at the end of every c-th step, after its reward was paid for the old goal, so the returned
    observation shows the goal that the next action is for. `distance` is then that to the new goal, success is of the
    old one, like the reward. d_c is
    |goal - position|, computed from the sum `goal = position + offset`, not from the offset.
 7. Flagrun ends on a fall and pays the progress reward on that step too. Its success (not specified) is that the last
    step ended nearer than 1 to the goal that it was for; False after a reset. Its `hiro` (not specified, Nachum et al.
    have none) is the same with RK4 and unclipped qvel.
 8. Flagrun for the point: sin, cos, distance / 1000, qpos 2, qvel 2 (clipped in shes); yaw 0.
 9. hiro Gather: sensors span 2 pi around the yaw (as JR and SNN4HRL; rllab's own default is pi); the free radius of 2
    takes only (0, 0) from the lattice; the fall is looked at before pickups, so the objects stay and the episode ends.
    Its success (not specified) is a score above 0. Its point never falls.
10. Divergence: the step ends the episode with reward 0; score is 0 and success False from then on.
11. The robot's noise is drawn for all of its qpos and qvel: for the point 2 and 2 numbers, in Fall 3 and 3. With
    noise 0 nothing is drawn.
12. hiro's evaluation of Maze in the official code has three targets, (16, 0), (16, 16), (0, 16); here only (0, 16).
13. Time is counted in control steps from 0; the horizon is the caller's.

Arithmetic, for bit-identical comparison: every distance is sqrt(dx * dx + dy * dy [+ dz * dz]), summed in this order;
rewards are -distance, or 1 - distance / d_c [+ 1]; sin, cos and atan2 are NumPy's, and compare with a tolerance.

Random draws: one generator per episode, `PCG64(SeedSequence(seed, spawn_key=(0,)))`. Every reset makes, in this order,
 1. `uniform(-noise, noise, num_robot_qpos)`, added to the robot's qpos (neither if noise is 0),
 2. `normal(0, noise, num_robot_qvel)`, added to its qvel; then an ant's quaternion is normalised (no draw),
 3. the task's own draws, as its class says.
"""

import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tests.envs import reference_worlds as worlds
from tests.envs.reference_worlds import BodyName

Array = NDArray[np.float64]

REWARDED_RADIUS = 1.0
SUCCESS_DISTANCE = 5.0
VELOCITY_LIMIT = 10.0
LOWEST_TORSO = 0.2
HIGHEST_TORSO = 1.0
SPECS = ("shes", "hiro")
PHYSICS_STEPS = 5
DIVERGENCE_WARNINGS = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)


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


def distance_between(one: ArrayLike, other: ArrayLike) -> float:
    """Euclidean distance, summed from the first coordinate to the last."""
    total = 0.0
    for a, b in zip(np.asarray(one).tolist(), np.asarray(other).tolist(), strict=True):
        total += (a - b) * (a - b)
    return math.sqrt(total)


def clipped(velocities: ArrayLike) -> list[float]:
    """Each velocity, at most 10 either way."""
    return [min(max(velocity, -VELOCITY_LIMIT), VELOCITY_LIMIT) for velocity in np.asarray(velocities).tolist()]


class ReferenceEpisode:
    """What all tasks share: one robot in one world, reset and stepped by plain MuJoCo calls.

    `model` is the one to simulate; without it the task's own MJCF text is compiled, with `integrator` (by default euler
    for shes, rk4 for hiro). In a model the robot's qpos and qvel come first, the block's behind them.
    """

    num_robot: tuple[int, int]
    """How many qpos and qvel are the robot's."""

    def __init__(
        self,
        body: BodyName,
        spec: str = "shes",
        model: mujoco.MjModel | None = None,
        *,
        reset_noise: float = 0.1,
        evaluation: bool = False,
        integrator: str | None = None,
        **world_options: Any,
    ) -> None:
        if body not in ("ant", "point"):
            raise ValueError(f"unknown body {body!r}")
        if spec not in SPECS:
            raise ValueError(f"unknown specification {spec!r}")
        self.body = body
        self.spec = spec
        self.reset_noise = reset_noise
        self.evaluation = evaluation
        if model is None:
            integrator = integrator or {"shes": "euler", "hiro": "rk4"}[spec]
            model = mujoco.MjModel.from_xml_string(self.xml(integrator=integrator, **world_options))
        self.model = model
        self.data = mujoco.MjData(model)
        self.num_robot = (15, 14) if body == "ant" else (2, 2)
        self.steps = 0
        self.reward = 0.0
        self.running_return = 0.0
        self.diverged = False
        self.rng = np.random.default_rng()

    def xml(self, **options: Any) -> str:
        """MJCF text of the task's world for `self.body`."""
        raise NotImplementedError

    def start_task(self) -> None:
        """Make the task's own draws of a reset; the robot is in place."""

    def play_task(self) -> float:
        """Bring the task's state up to date after a step's physics and return the step's reward."""
        raise NotImplementedError

    def finish_step(self) -> None:
        """Do what comes after the reward and before the observation."""

    def observation(self) -> Array:
        """What the agent sees now."""
        raise NotImplementedError

    def is_over(self) -> bool:
        """Whether the task ends the episode here."""
        return False

    def reset(self, seed: int) -> Array:
        """Start the episode of this seed and return its first observation."""
        mujoco.mj_resetData(self.model, self.data)
        self.rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(0,))))
        num_qpos, num_qvel = self.num_robot
        if self.reset_noise:
            self.data.qpos[:num_qpos] += self.rng.uniform(-self.reset_noise, self.reset_noise, num_qpos)
            self.data.qvel[:num_qvel] += self.rng.normal(0, self.reset_noise, num_qvel)
            if self.body == "ant":
                self.data.qpos[3:7] /= np.linalg.norm(self.data.qpos[3:7])
        self.steps = 0
        self.reward = 0.0
        self.running_return = 0.0
        self.diverged = False
        self.start_task()
        return self.observation()

    def step(self, control: ArrayLike) -> tuple[Array, float, bool]:
        """Play one control step of 0.1 s; `control` is in control units (ant: 30 is the limit; point: 1)."""
        action = np.asarray(control, dtype=np.float64)
        if action.shape != (self.model.nu,) or not np.all(np.isfinite(action)):
            raise ValueError(f"not an action: {action}")
        for _ in range(PHYSICS_STEPS):
            self.data.ctrl[:] = action
            mujoco.mj_step(self.model, self.data)
        self.steps += 1
        for warning in DIVERGENCE_WARNINGS:
            if self.data.warning[warning].number > 0:
                self.diverged = True
        self.reward = self.play_task()
        if self.diverged:
            self.reward = 0.0
        self.running_return += self.reward
        terminated = self.diverged or self.is_over()
        self.finish_step()
        return self.observation(), self.reward, terminated

    @property
    def position(self) -> Array:
        """Where the robot is in the xy plane."""
        return self.data.qpos[0:2].copy()

    @property
    def heading(self) -> float:
        """The ant's yaw; always 0 for the point."""
        return yaw(self.data.qpos[3:7]) if self.body == "ant" else 0.0

    @property
    def has_fallen(self) -> bool:
        """Whether the ant's torso is outside [0.2, 1.0]; a point cannot fall."""
        return self.body == "ant" and not LOWEST_TORSO <= self.data.qpos[2] <= HIGHEST_TORSO

    @property
    def distance(self) -> float:
        """How far it is to what the task wants reached."""
        raise NotImplementedError

    @property
    def score(self) -> float:
        """The test score, were this the last step."""
        raise NotImplementedError

    @property
    def success(self) -> bool:
        """Whether the task is solved, were this the last step."""
        raise NotImplementedError

    def robot_observation(self) -> list[float]:
        """The robot's qpos and qvel (hiro: unclipped), without the block's."""
        num_qpos, num_qvel = self.num_robot
        velocities = self.data.qvel[:num_qvel]
        return self.data.qpos[:num_qpos].tolist() + (
            clipped(velocities) if self.spec == "shes" else velocities.tolist()
        )


class ReferenceNavigation(ReferenceEpisode):
    """Reach a target: what Maze, Push and Fall share.

    shes: all qpos and qvel, clipped (robot, then block), t * 0.001, target * `target_scale`.
    hiro: the robot's qpos and unclipped qvel, t * 0.001, and the raw target, which is for the high level only.
    The reward is -distance after the step. It never ends early. Score: 1 if the distance is below 5, else 0.
    """

    grid: tuple[str, ...]
    fixed_target: tuple[float, ...]
    target_scale = 1.0

    def __init__(self, body: BodyName, spec: str = "shes", model: mujoco.MjModel | None = None, **options: Any) -> None:
        super().__init__(body, spec, model, **options)
        self.target = np.array(self.fixed_target)

    def xml(self, **options: Any) -> str:
        return worlds.world_xml(self.grid, self.body, **options)

    def observation(self) -> Array:
        if self.spec == "hiro":
            return np.array([*self.low_level_observation(), *self.target])
        values = self.data.qpos.tolist() + clipped(self.data.qvel)
        return np.array([*values, self.steps * 0.001, *(self.target * self.target_scale)])

    def low_level_observation(self) -> Array:
        """The state of hiro's low level, 30 numbers for the ant: no target, no block."""
        return np.array([*self.robot_observation(), self.steps * 0.001])

    def play_task(self) -> float:
        return -self.distance

    @property
    def distance(self) -> float:
        """Distance to the target in as many coordinates as it has."""
        return distance_between(self.data.qpos[: len(self.target)], self.target)

    @property
    def success(self) -> bool:
        return not self.diverged and self.distance < SUCCESS_DISTANCE

    @property
    def score(self) -> float:
        return float(self.success)


class ReferenceMaze(ReferenceNavigation):
    """Maze. shes: 15 + 14 + 1 + 2 = 32 for the ant, 7 for the point, target * 0.01. hiro: 30 (5) + 2.

    Draws of a reset, behind the robot's: in training `uniform(-4, 20, 2)`, x and y of the target; with `free_cells`
    again until it lies in a free cell. In evaluation nothing: the target is (0, 16).
    """

    grid = worlds.MAZE
    fixed_target = (0.0, 16.0)
    target_scale = 0.01

    def __init__(
        self,
        body: BodyName,
        spec: str = "shes",
        model: mujoco.MjModel | None = None,
        *,
        free_cells: bool = False,
        **options: Any,
    ) -> None:
        super().__init__(body, spec, model, **options)
        self.free_cells = free_cells

    def start_task(self) -> None:
        if self.evaluation:
            self.target = np.array(self.fixed_target)
            return
        self.target = self.rng.uniform(-4, 20, 2)
        while self.free_cells and worlds.cell_at(self.grid, *self.target) == "#":
            self.target = self.rng.uniform(-4, 20, 2)


class ReferencePush(ReferenceNavigation):
    """Push. shes: 17 + 16 + 1 + 2 = 36 for the ant, 11 for the point, with the block's x, y; hiro: 30 (5) + 2.

    The block's two numbers stand behind the robot's in qpos and in qvel. It has no draws of its own.
    """

    grid = worlds.PUSH
    fixed_target = (0.0, 19.0)


class ReferenceFall(ReferenceNavigation):
    """Fall. shes: 17 + 16 + 1 + 3 = 37 for the ant, 14 for the point, with the block's y, z; hiro: 30 (7) + 3.

    The point has a third qpos, its height, and a third qvel. It has no draws of its own.
    """

    grid = worlds.FALL
    fixed_target = (0.0, 27.0, 4.5)

    def __init__(self, body: BodyName, spec: str = "shes", model: mujoco.MjModel | None = None, **options: Any) -> None:
        super().__init__(body, spec, model, **options)
        if body == "point":
            self.num_robot = (3, 3)


class ReferenceFlagrun(ReferenceEpisode):
    """Follow goals that move every `interval` steps.

    Observation: sin and cos of (bearing of the goal - yaw), distance / 1000, robot's qpos, robot's qvel, clipped in
    shes; 32 numbers for the ant, 7 for the point. Reward: 1 - distance / d_c, and 1 more when nearer than 1. Ends on a
    fall. Score: the return.

    Draws of a reset, behind the robot's: `uniform(-4, 4, 2)`, again until its length is at least 1; the goal is that
    far from the robot. Draws of a step whose number (from 1) is a multiple of `interval`: the same, after the reward,
    on the last step of an episode too, and whether or not it ended there.
    """

    def __init__(
        self,
        body: BodyName,
        spec: str = "shes",
        model: mujoco.MjModel | None = None,
        *,
        interval: int = 25,
        **options: Any,
    ) -> None:
        super().__init__(body, spec, model, **options)
        self.interval = interval
        self.goal = np.zeros(2)
        self.start_distance = 1.0
        self.was_near = False

    def xml(self, **options: Any) -> str:
        return worlds.world_xml(worlds.GATHER, self.body, **options)

    def start_task(self) -> None:
        self.was_near = False
        self._draw_goal()

    def play_task(self) -> float:
        """Progress toward the goal that was seen before the step."""
        self.was_near = self.distance < REWARDED_RADIUS
        return 1.0 - self.distance / self.start_distance + (1.0 if self.was_near else 0.0)

    def finish_step(self) -> None:
        """Draw the goal for the next `interval` steps, when these are over."""
        if self.steps % self.interval == 0:
            self._draw_goal()

    def _draw_goal(self) -> None:
        offset = self.rng.uniform(-4, 4, 2)
        while distance_between(offset, (0.0, 0.0)) < REWARDED_RADIUS:
            offset = self.rng.uniform(-4, 4, 2)
        self.goal = self.position + offset
        self.start_distance = self.distance

    def is_over(self) -> bool:
        return self.has_fallen

    def observation(self) -> Array:
        dx, dy = self.goal - self.position
        angle = np.arctan2(dy, dx) - self.heading
        return np.array([np.sin(angle), np.cos(angle), self.distance / 1000, *self.robot_observation()])

    @property
    def distance(self) -> float:
        return distance_between(self.position, self.goal)

    @property
    def score(self) -> float:
        return 0.0 if self.diverged else self.running_return

    @property
    def success(self) -> bool:
        """Whether the goal of the last step was nearer than 1 after it."""
        return not self.diverged and self.was_near


class ReferenceGather(ReferenceEpisode):
    """Gather: +1 food, -1 poison nearer than 1. Score: the highest running return, at least 0. Ends on a fall.

    shes: robot's qpos, clipped qvel, 10 food readings, 10 poison readings, t; 50 or 25 numbers. The step of a fall pays
    its pickups. hiro: t stands before the readings, qvel is unclipped; the step of an ant's fall pays -10 in place of
    its pickups, and the episode ends when nothing is left, too.

    Draws of a reset, behind the robot's. shes: `uniform(-10, 10, (32, 2))`, of which those at least 2 from the origin
    count, again until there are 16. hiro: `permutation(99)`, as places in this list: x = -10, -8, ..., 8, for each x
    y = -10, -8, ..., 8, without (0, 0). The first 8 are the food and the next 8 the poison.
    """

    num_bins = 10
    catch_distance = 1.0
    penalty = -10.0

    def __init__(
        self,
        body: BodyName,
        spec: str = "shes",
        model: mujoco.MjModel | None = None,
        **options: Any,
    ) -> None:
        super().__init__(body, spec, model, **options)
        self.sensor_range = {"shes": 8.0, "hiro": 6.0}[spec]
        self.food: list[tuple[float, float]] = []
        self.poison: list[tuple[float, float]] = []
        self.best_return = 0.0

    def xml(self, **options: Any) -> str:
        """The arena; with hiro its walls are at +-10.5."""
        if self.spec == "hiro":
            return worlds.hiro_gather_xml(self.body, **options)
        return worlds.world_xml(worlds.GATHER, self.body, **options)

    def start_task(self) -> None:
        places: list[tuple[float, float]] = []
        if self.spec == "hiro":
            lattice = [(float(x), float(y)) for x in range(-10, 10, 2) for y in range(-10, 10, 2) if x * x + y * y >= 4]
            places = [lattice[number] for number in self.rng.permutation(len(lattice)).tolist()]
        while len(places) < 16:
            drawn = self.rng.uniform(-10, 10, (32, 2)).tolist()
            places += [(x, y) for x, y in drawn if x * x + y * y >= 4]
        self.food, self.poison = places[:8], places[8:16]
        self.best_return = 0.0

    def play_task(self) -> float:
        if self.has_fallen:
            reward = self.penalty
        else:
            food, self.food = self._pick_up(self.food)
            poison, self.poison = self._pick_up(self.poison)
            reward = float(food - poison)
        if not self.diverged:
            self.best_return = max(self.best_return, self.running_return + reward)
        return reward

    def _pick_up(self, things: list[tuple[float, float]]) -> tuple[int, list[tuple[float, float]]]:
        """How many of these are nearer than 1, and the others."""
        left = [thing for thing in things if distance_between(thing, self.position) >= self.catch_distance]
        return len(things) - len(left), left

    def is_over(self) -> bool:
        """Whether the ant has fallen or, with hiro, nothing is left."""
        return self.has_fallen or (self.spec == "hiro" and not (self.food or self.poison))

    def observation(self) -> Array:
        time, readings = [self.steps * 0.001], self._readings(self.food) + self._readings(self.poison)
        return np.array([*self.robot_observation(), *(time + readings if self.spec == "hiro" else readings + time)])

    def _readings(self, things: list[tuple[float, float]]) -> list[float]:
        """The reading of the nearest thing in each bin; bin 0 begins behind the robot, at bearing -pi.

        shes: 1 - distance^2 / range^2, hiro: 1 - distance / range.
        """
        result = [0.0] * self.num_bins
        x, y = self.position
        for thing_x, thing_y in things:
            distance = distance_between((thing_x, thing_y), (x, y))
            if distance > self.sensor_range:
                continue
            turn = (math.atan2(thing_y - y, thing_x - x) - self.heading + math.pi) / (2 * math.pi) % 1.0
            bin_number = min(math.floor(turn * self.num_bins), self.num_bins - 1)
            squared = (thing_x - x) * (thing_x - x) + (thing_y - y) * (thing_y - y)
            part = distance / self.sensor_range if self.spec == "hiro" else squared / self.sensor_range**2
            result[bin_number] = max(result[bin_number], 1.0 - part)
        return result

    @property
    def distance(self) -> float:
        """Distance to the nearest piece of food left; infinity where none is left."""
        return min((distance_between(thing, self.position) for thing in self.food), default=math.inf)

    @property
    def score(self) -> float:
        """The highest running return so far, at least 0."""
        return 0.0 if self.diverged else self.best_return

    @property
    def success(self) -> bool:
        return self.score > 0
