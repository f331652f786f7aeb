"""Plain reference of every task, written independently of the package for tests.

Sources: docs/environments/index.md and docs/algorithm.md (they decide); then sash-a/HrlMuJoCoEnvs.jl (JR)
for `shes`, Nachum et al. 2018's efficient-hrl and rllab's GatherEnv for `hiro`. One episode, one `MjData`, plain loops.

What these leave open about tasks, and how it is decided here (worlds: see reference_worlds.py):
 1. hiro Maze, Push, Fall: the observation is the robot's 30 numbers and then the raw target (32, 32, 33), which only
    the high level sees. qvel is unclipped in every hiro task.
 2. hiro Gather's "t" is t * 0.001, as in the other tasks. It stands before the readings, in shes Gather behind them.
 3. Maze's score is against the episode's own target, which is (0, 16) in evaluation (JR: always against (0, 16)).
    The official hiro evaluates three targets, (16, 0), (16, 16), (0, 16); here only (0, 16).
 4. Score, success and distance are those of the last step played; after a reset, of the start.
 5. `free_cells` are all cells without a wall, the robot's own included. The whole pair is redrawn.
 6. Flagrun's new goal comes at the end of every c-th step, after the reward for the old goal was paid, so the returned
    observation shows the new goal. `distance` is to the new goal, success is of the old one, like the reward. d_c is
    |goal - position|, computed from the sum `goal = position + offset`, not from the offset.
 7. Flagrun ends on a fall and pays the progress reward on that step too. Its success is that the last step ended nearer
    than 1 to the goal that it was for; False after a reset. Its `hiro` is the same with RK4 and unclipped qvel.
 8. Flagrun for the point: sin, cos, distance / 1000, qpos 2, qvel 2 (clipped in shes); yaw 0.
 9. hiro Gather: sensors span 2 pi around the yaw (as JR and SNN4HRL; rllab's own default is pi). The fall is looked at
    before pickups. Success is a score above 0.
10. Divergence: the step ends the episode with reward 0; score is 0 and success False from then on.
11. The robot's noise is drawn for all of its qpos and qvel: for the point 2 and 2 numbers, in Fall 3 and 3. With
    noise 0 nothing is drawn.

Arithmetic, for bit-identical comparison: every distance is sqrt(dx * dx + dy * dy [+ dz * dz]), summed in this order;
rewards are -distance, or 1 - distance / d_c [+ 1]; sin, cos and atan2 are NumPy's, and compare with a tolerance.

Random draws: one generator per episode, `PCG64(SeedSequence(seed, spawn_key=(0,)))`. Every reset draws the robot's pose
(uniform), its velocity (normal), and then what `start_task` draws.
"""

import math

import mujoco
import numpy as np

from tests.envs import reference_worlds as worlds

REWARDED_RADIUS = 1.0
SUCCESS_DISTANCE = 5.0
VELOCITY_LIMIT = 10.0
LOWEST_TORSO, HIGHEST_TORSO = 0.2, 1.0
PHYSICS_STEPS = 5
DIVERGENCE_WARNINGS = [getattr(mujoco.mjtWarning, f"mjWARN_BAD{name}") for name in ("QPOS", "QVEL", "QACC", "CTRL")]


def yaw(quaternion):
    """Return the direction in the xy plane of the rotated x axis; the quaternion is w x y z."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(quaternion) / np.linalg.norm(quaternion))
    x, y, _ = rotation.reshape(3, 3) @ np.array([1.0, 0.0, 0.0])
    return math.atan2(y, x)


def distance_between(one, other):
    """Return the Euclidean distance, summed from the first coordinate to the last."""
    total = 0.0
    for a, b in zip(np.asarray(one).tolist(), np.asarray(other).tolist(), strict=True):
        total += (a - b) * (a - b)
    return math.sqrt(total)


def clipped(velocities):
    return [min(max(each, -VELOCITY_LIMIT), VELOCITY_LIMIT) for each in np.asarray(velocities).tolist()]


class ReferenceEpisode:
    """What all tasks share: one robot in one world, reset and stepped by plain MuJoCo calls.

    `model` is the one to simulate; without it the task's own MJCF text is compiled, with `integrator` (by default euler
    for shes, rk4 for hiro). In a model the robot's qpos and qvel come first, the block's behind them.
    """

    def __init__(self, body, spec="shes", model=None, *, reset_noise=0.1, evaluation=False, integrator=None, **world):
        self.body, self.spec = body, spec
        self.reset_noise, self.evaluation = reset_noise, evaluation
        if model is None:
            integrator = integrator or {"shes": "euler", "hiro": "rk4"}[spec]
            model = mujoco.MjModel.from_xml_string(self.xml(integrator=integrator, **world))
        self.model, self.data = model, mujoco.MjData(model)
        self.num_robot = (15, 14) if body == "ant" else (2, 2)

    def start_task(self):
        """Make the task's own draws of a reset; the robot is in place."""

    def finish_step(self):
        """Do what comes after the reward and before the observation."""

    def is_over(self):
        """Return whether the task ends the episode here."""
        return False

    def reset(self, seed):
        """Start the episode of this seed."""
        mujoco.mj_resetData(self.model, self.data)
        self.rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(0,))))
        num_qpos, num_qvel = self.num_robot
        if self.reset_noise:
            self.data.qpos[:num_qpos] += self.rng.uniform(-self.reset_noise, self.reset_noise, num_qpos)
            self.data.qvel[:num_qvel] += self.rng.normal(0, self.reset_noise, num_qvel)
            if self.body == "ant":
                self.data.qpos[3:7] /= np.linalg.norm(self.data.qpos[3:7])
        self.steps, self.reward, self.running_return, self.diverged = 0, 0.0, 0.0, False
        self.start_task()

    def step(self, control):
        """Play one control step of 0.1 s; `control` is in control units. Return whether the episode has ended."""
        for _ in range(PHYSICS_STEPS):
            self.data.ctrl[:] = control
            mujoco.mj_step(self.model, self.data)
        self.steps += 1
        self.diverged |= any(self.data.warning[warning].number > 0 for warning in DIVERGENCE_WARNINGS)
        self.reward = self.play_task()
        if self.diverged:
            self.reward = 0.0
        self.running_return += self.reward
        has_ended = self.diverged or self.is_over()
        self.finish_step()
        return has_ended

    @property
    def position(self):
        return self.data.qpos[0:2].copy()

    @property
    def heading(self):
        return yaw(self.data.qpos[3:7]) if self.body == "ant" else 0.0

    @property
    def has_fallen(self):
        """Whether the ant's torso is outside [0.2, 1.0]; a point cannot fall."""
        return self.body == "ant" and not LOWEST_TORSO <= self.data.qpos[2] <= HIGHEST_TORSO

    def robot_observation(self):
        """Return the robot's qpos and qvel (hiro: unclipped), without the block's."""
        num_qpos, num_qvel = self.num_robot
        velocities = self.data.qvel[:num_qvel]
        return [*self.data.qpos[:num_qpos], *(clipped(velocities) if self.spec == "shes" else velocities)]


class ReferenceNavigation(ReferenceEpisode):
    """Reach a target: what Maze, Push and Fall share.

    shes: all qpos and qvel, clipped (robot, then block), t * 0.001, target * `target_scale`.
    hiro: the robot's qpos and unclipped qvel, t * 0.001, and the raw target.
    The reward is -distance after the step. It never ends early. Score: 1 if the distance is below 5, else 0.
    """

    target_scale = 1.0

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.target = np.array(self.fixed_target)

    def xml(self, **options):
        return worlds.world_xml(self.grid, self.body, **options)

    def observation(self):
        if self.spec == "hiro":
            return np.array([*self.low_level_observation(), *self.target])
        values = [*self.data.qpos, *clipped(self.data.qvel)]
        return np.array([*values, self.steps * 0.001, *(self.target * self.target_scale)])

    def low_level_observation(self):
        """Return the state of hiro's low level, 30 numbers for the ant: no target, no block."""
        return np.array([*self.robot_observation(), self.steps * 0.001])

    def play_task(self):
        return -self.distance

    @property
    def distance(self):
        return distance_between(self.data.qpos[: len(self.target)], self.target)

    @property
    def success(self):
        return not self.diverged and self.distance < SUCCESS_DISTANCE

    @property
    def score(self):
        return float(self.success)


class ReferenceMaze(ReferenceNavigation):
    """Maze. shes: 15 + 14 + 1 + 2 = 32 for the ant, 7 for the point, target * 0.01. hiro: 30 (5) + 2.

    Draws in training: `uniform(-4, 20, 2)`, the target; with `free_cells` again until it lies in a free cell.
    """

    grid, fixed_target, target_scale = worlds.MAZE, (0.0, 16.0), 0.01

    def __init__(self, *arguments, free_cells=False, **options):
        super().__init__(*arguments, **options)
        self.free_cells = free_cells

    def start_task(self):
        if self.evaluation:
            self.target = np.array(self.fixed_target)
            return
        self.target = self.rng.uniform(-4, 20, 2)
        while self.free_cells and worlds.cell_at(self.grid, *self.target) == "#":
            self.target = self.rng.uniform(-4, 20, 2)


class ReferencePush(ReferenceNavigation):
    """Push. shes: 17 + 16 + 1 + 2 = 36 for the ant, 11 for the point, with the block's x, y; hiro: 30 (5) + 2."""

    grid, fixed_target = worlds.PUSH, (0.0, 19.0)


class ReferenceFall(ReferenceNavigation):
    """Fall. shes: 17 + 16 + 1 + 3 = 37 for the ant, 14 for the point, with the block's y, z; hiro: 30 (7) + 3.

    The point has a third qpos, its height, and a third qvel.
    """

    grid, fixed_target = worlds.FALL, (0.0, 27.0, 4.5)

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        if self.body == "point":
            self.num_robot = (3, 3)


class ReferenceFlagrun(ReferenceEpisode):
    """Follow goals that move every `interval` steps.

    Observation: sin and cos of (bearing of the goal - yaw), distance / 1000, robot's qpos and qvel; 32 numbers for the
    ant, 7 for the point. Reward: 1 - distance / d_c, and 1 more when nearer than 1. Score: the return.

    Draws of a reset: `uniform(-4, 4, 2)`, again until its length is at least 1; the goal is that far from the robot.
    The same after every step whose number (from 1) is a multiple of `interval`, whether or not the episode ended there.
    """

    def __init__(self, *arguments, interval=25, **options):
        super().__init__(*arguments, **options)
        self.interval = interval

    def xml(self, **options):
        return worlds.world_xml(worlds.GATHER, self.body, **options)

    def start_task(self):
        self.was_near = False
        self.draw_goal()

    def play_task(self):
        """Return the progress toward the goal that was seen before the step."""
        self.was_near = self.distance < REWARDED_RADIUS
        return 1.0 - self.distance / self.start_distance + (1.0 if self.was_near else 0.0)

    def finish_step(self):
        if self.steps % self.interval == 0:
            self.draw_goal()

    def draw_goal(self):
        offset = self.rng.uniform(-4, 4, 2)
        while distance_between(offset, (0.0, 0.0)) < REWARDED_RADIUS:
            offset = self.rng.uniform(-4, 4, 2)
        self.goal = self.position + offset
        self.start_distance = self.distance

    def is_over(self):
        return self.has_fallen

    def observation(self):
        dx, dy = self.goal - self.position
        angle = np.arctan2(dy, dx) - self.heading
        return np.array([np.sin(angle), np.cos(angle), self.distance / 1000, *self.robot_observation()])

    @property
    def distance(self):
        return distance_between(self.position, self.goal)

    @property
    def score(self):
        return 0.0 if self.diverged else self.running_return

    @property
    def success(self):
        return not self.diverged and self.was_near


class ReferenceGather(ReferenceEpisode):
    """Gather: +1 food, -1 poison nearer than 1. Score: the highest running return, at least 0. Ends on a fall.

    shes: robot's qpos, clipped qvel, 10 food readings, 10 poison readings, t; 50 or 25 numbers. The step of a fall pays
    its pickups. hiro: t stands before the readings, qvel is unclipped; the step of an ant's fall pays -10 in place of
    its pickups, and the episode ends when nothing is left, too.

    Draws of a reset. shes: `uniform(-10, 10, (32, 2))`, of which those at least 2 from the origin count, again until
    there are 16. hiro: `permutation(99)`, as places in this list: x = -10, -8, ..., 8, for each x y = -10, -8, ..., 8,
    without (0, 0). The first 8 are the food and the next 8 the poison.
    """

    num_bins = 10
    catch_distance = 1.0
    penalty = -10.0

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self.sensor_range = {"shes": 8.0, "hiro": 6.0}[self.spec]

    def xml(self, **options):
        """Return the arena; with hiro its walls are at +-10.5."""
        if self.spec == "hiro":
            return worlds.hiro_gather_xml(self.body, **options)
        return worlds.world_xml(worlds.GATHER, self.body, **options)

    def start_task(self):
        places = []
        if self.spec == "hiro":
            lattice = [(float(x), float(y)) for x in range(-10, 10, 2) for y in range(-10, 10, 2) if x * x + y * y >= 4]
            places = [lattice[number] for number in self.rng.permutation(len(lattice)).tolist()]
        while len(places) < 16:
            drawn = self.rng.uniform(-10, 10, (32, 2)).tolist()
            places += [(x, y) for x, y in drawn if x * x + y * y >= 4]
        self.food, self.poison = places[:8], places[8:16]
        self.best_return = 0.0

    def play_task(self):
        if self.has_fallen and self.spec == "hiro":
            reward = self.penalty
        else:
            food, self.food = self.pick_up(self.food)
            poison, self.poison = self.pick_up(self.poison)
            reward = float(food - poison)
        if not self.diverged:
            self.best_return = max(self.best_return, self.running_return + reward)
        return reward

    def pick_up(self, things):
        """Return how many of these are nearer than 1, and the others."""
        left = [thing for thing in things if distance_between(thing, self.position) >= self.catch_distance]
        return len(things) - len(left), left

    def is_over(self):
        return self.has_fallen or (self.spec == "hiro" and not (self.food or self.poison))

    def observation(self):
        time, readings = [self.steps * 0.001], self.readings(self.food) + self.readings(self.poison)
        return np.array([*self.robot_observation(), *(time + readings if self.spec == "hiro" else readings + time)])

    def readings(self, things):
        """Return the reading of the nearest thing in each bin; bin 0 begins behind the robot, at bearing -pi.

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
    def distance(self):
        """Distance to the nearest piece of food left; infinity where none is left."""
        return min((distance_between(thing, self.position) for thing in self.food), default=math.inf)

    @property
    def score(self):
        return 0.0 if self.diverged else self.best_return

    @property
    def success(self):
        return self.score > 0
