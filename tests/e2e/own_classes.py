"""A user's own robot, task, primitive reward and goal encoding. Tests put this text into scripts and modules."""

import numpy as np

from shes import register_environment, register_goal_encoding, register_primitive_reward
from shes.agents.goals import GoalEncoding
from shes.agents.rewards import PrimitiveReward
from shes.envs.bodies.body import elements
from shes.envs.bodies.point import Point
from shes.envs.tasks.task import Task, TaskDescription
from shes.envs.worlds import empty_world

CORNERS_M = np.array([[2.0, 2.0], [2.0, -2.0], [-2.0, 2.0], [-2.0, -2.0]])


class Puck(Point):
    """A point with half the strength."""

    name = "puck"
    control_limit = 0.5


class Corner(Task):
    """Go to the corner that the episode has drawn."""

    name = "corner"
    description = TaskDescription(
        reward="minus the distance", ends="within 0.3 m of it", score="the return", success="it has ended"
    )

    def allocate(self):
        self.corner = np.zeros((self.num_episodes, 2))

    @classmethod
    def build_world(cls, body, options):
        spec = empty_world(cls.name, options.integrator)
        body.add_to(spec)
        return spec

    @property
    def observation_spec(self):
        return self.robot_elements() + elements(["corner_x", "corner_y"], "{} from the robot", "m")

    @property
    def distance(self):
        return np.hypot(*(self.corner - self.position).T)

    @property
    def terminated(self):
        return self.distance < 0.3

    @property
    def score(self):
        return self.running_return * ~self.diverged

    @property
    def success(self):
        return self.terminated & ~self.diverged

    def observe(self):
        return np.hstack([self.sim.qpos, np.clip(self.sim.qvel, -10, 10), self.corner - self.position])

    def reset_features(self, ids, rngs):
        self.corner[ids] = [CORNERS_M[rng.integers(4)] for rng in rngs]

    def update_features(self):
        return -self.distance


class Nearness(PrimitiveReward):
    """Minus the distance to the goal, in half metres."""

    def __call__(self, distance, start_distance, moved, goal):
        return -2 * distance


class Vector(GoalEncoding):
    """The vector to the goal, and its length."""

    size = 3

    def encode(self, vector, distance, heading, out):
        out[:, :2] = vector
        out[:, 2] = distance


def register():
    register_environment("puck-corner", Puck, Corner)
    register_primitive_reward("nearness", Nearness)
    register_goal_encoding("own-vector", Vector)
