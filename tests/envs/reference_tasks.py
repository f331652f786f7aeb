"""Plain reference of every task, written independently of the package, for its tests.

Sources: docs/environments/index.md (it decides); then HrlMuJoCoEnvs.jl for `shes`, efficient-hrl and rllab's GatherEnv
for `hiro`. One episode, one `MjData`, plain loops.

For bit-identical comparison every distance is sqrt(dx * dx + dy * dy [+ dz * dz]), summed in this order, and Flagrun's
d_c is computed from `goal = position + offset`, not from the offset. There is one generator per episode. A reset draws
the robot's pose (uniform), its velocity (normal), and then what `start_task` draws.
"""

import math

import mujoco
import numpy as np

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


class ReferenceEpisode:
    """What all tasks share: one robot in one world, reset and stepped by plain MuJoCo calls."""

    reset_noise = 0.1
    num_point = (2, 2)
    """Size of the point's qpos and qvel."""
    is_over = False
    """Whether the task ends the episode here."""

    def __init__(self, body, spec, model, **options):
        """Set the `options`, which are class attributes, in place of their defaults."""
        assert all(hasattr(self, name) for name in options)
        vars(self).update(options)
        self.body, self.spec, self.model, self.data = body, spec, model, mujoco.MjData(model)
        self.num_robot = (15, 14) if body == "ant" else self.num_point

    def start_task(self):
        """Make the task's own draws of a reset; the robot is in place."""

    def finish_step(self):
        """Do what comes after the reward and before the observation."""

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
        for _ in range(5):
            self.data.ctrl[:] = control
            mujoco.mj_step(self.model, self.data)
        self.steps += 1
        self.diverged |= any(self.data.warning[warning].number > 0 for warning in DIVERGENCE_WARNINGS)
        reward = self.play_task()
        self.reward = 0.0 if self.diverged else reward
        self.running_return += self.reward
        has_ended = self.diverged or self.is_over
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
        return self.body == "ant" and not 0.2 <= self.data.qpos[2] <= 1.0

    def coordinates(self, num_qpos, num_qvel):
        """Return the first of qpos, and of qvel, which shes clips."""
        velocities = self.data.qvel[:num_qvel].tolist()
        if self.spec == "shes":
            velocities = [min(max(each, -10.0), 10.0) for each in velocities]
        return [*self.data.qpos[:num_qpos], *velocities]


class ReferenceNavigation(ReferenceEpisode):
    """Reach a target: what Maze, Push and Fall share."""

    target_scale = 1.0
    """Factor on the observed target, with shes."""

    is_fixed = True
    """Whether the target is not drawn."""

    def observation(self):
        seen = self.coordinates(*((None, None) if self.spec == "shes" else self.num_robot))
        scale = self.target_scale if self.spec == "shes" else 1.0
        return np.array([*seen, self.steps * 0.001, *(np.array(self.target) * scale)])

    def play_task(self):
        return -self.distance

    @property
    def distance(self):
        return distance_between(self.data.qpos[: len(self.target)], self.target)

    @property
    def success(self):
        return not self.diverged and self.distance < 5.0

    @property
    def score(self):
        return float(self.success)


class ReferenceMaze(ReferenceNavigation):
    """Maze. A reset draws the target."""

    target, target_scale, is_fixed = (0.0, 16.0), 0.01, False

    def start_task(self):
        if not self.is_fixed:
            self.target = self.rng.uniform(-4, 20, 2)


class ReferencePush(ReferenceNavigation):
    target = (0.0, 19.0)


class ReferenceFall(ReferenceNavigation):
    """Fall. The point has a third qpos, its height, and a third qvel."""

    target, num_point = (0.0, 27.0, 4.5), (3, 3)


class ReferenceFlagrun(ReferenceEpisode):
    """Follow goals that move at the end of every `interval` steps, whether or not the episode ended there."""

    interval = 25

    def start_task(self):
        self.was_near = False
        self.draw_goal()

    def play_task(self):
        """Return the progress toward the goal that was seen before the step."""
        self.was_near = self.distance < 1.0
        return 1.0 - self.distance / self.start_distance + (1.0 if self.was_near else 0.0)

    def finish_step(self):
        if self.steps % self.interval == 0:
            self.draw_goal()

    def draw_goal(self):
        offset = self.rng.uniform(-4, 4, 2)
        while distance_between(offset, (0.0, 0.0)) < 1.0:
            offset = self.rng.uniform(-4, 4, 2)
        self.goal = self.position + offset
        self.start_distance = self.distance

    is_over = ReferenceEpisode.has_fallen

    def observation(self):
        dx, dy = self.goal - self.position
        angle = np.arctan2(dy, dx) - self.heading
        return np.array([np.sin(angle), np.cos(angle), self.distance / 1000, *self.coordinates(*self.num_robot)])

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
    """Gather. Its draws of a reset are with shes `uniform(-10, 10, (32, 2))`, again until 16 are far enough.

    With hiro they are `permutation(99)`, as places in this list: x = -10, -8, ..., 8, for each x y = -10, -8, ..., 8,
    without (0, 0). The first 8 are the food and the next 8 the poison.
    """

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
            reward = -10.0
        else:
            food, self.food = self.pick_up(self.food)
            poison, self.poison = self.pick_up(self.poison)
            reward = float(food - poison)
        if not self.diverged:
            self.best_return = max(self.best_return, self.running_return + reward)
        return reward

    def pick_up(self, things):
        """Return how many of these are nearer than 1, and the others."""
        left = [thing for thing in things if distance_between(thing, self.position) >= 1.0]
        return len(things) - len(left), left

    @property
    def is_over(self):
        return self.has_fallen or (self.spec == "hiro" and not (self.food or self.poison))

    def observation(self):
        time, readings = [self.steps * 0.001], self.readings(self.food) + self.readings(self.poison)
        rest = time + readings if self.spec == "hiro" else readings + time
        return np.array(self.coordinates(*self.num_robot) + rest)

    def readings(self, things):
        """Return the reading of the nearest thing in each bin; bin 0 begins behind the robot, at bearing -pi."""
        result, sensor_range = [0.0] * 10, 6.0 if self.spec == "hiro" else 8.0
        x, y = self.position
        for thing_x, thing_y in things:
            distance = distance_between((thing_x, thing_y), (x, y))
            if distance > sensor_range:
                continue
            turn = (math.atan2(thing_y - y, thing_x - x) - self.heading + math.pi) / (2 * math.pi) % 1.0
            bin_number = min(math.floor(turn * 10), 9)
            squared = (thing_x - x) * (thing_x - x) + (thing_y - y) * (thing_y - y)
            part = distance / sensor_range if self.spec == "hiro" else squared / sensor_range**2
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


REFERENCES = {"maze": ReferenceMaze, "push": ReferencePush, "fall": ReferenceFall}
REFERENCES |= {"flagrun": ReferenceFlagrun, "gather": ReferenceGather}
