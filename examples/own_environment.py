"""A custom environment in which a point reaches a beacon, trained on two worker processes."""

import numpy as np

import shes
from shes.envs.bodies.body import elements
from shes.envs.bodies.point import Point
from shes.envs.tasks.task import Task, TaskDescription
from shes.envs.worlds import empty_world


class Beacon(Task):
    """A beacon is within 5 m along x and y. All arrays have a row for each of N episodes."""

    name = "beacon"
    description = TaskDescription(reward="exp(-distance)", ends="never", score="return", success="distance below 1 m")

    def allocate(self):
        self.beacon = np.zeros((self.num_episodes, 2))

    @classmethod
    def build_world(cls, body, options):
        spec = empty_world(cls.name, options.integrator)
        body.add_to(spec)
        return spec

    @property
    def observation_spec(self):
        return self.robot_elements() + elements(["beacon_x", "beacon_y"], "{} from the robot", "m")

    def observe(self):
        return np.hstack([self.sim.qpos, np.clip(self.sim.qvel, -10, 10), self.beacon - self.position])

    @property
    def distance(self):
        return np.hypot(*(self.beacon - self.position).T)

    @property
    def score(self):
        return self.running_return * ~self.diverged

    @property
    def success(self):
        return (self.distance < 1) & ~self.diverged

    def reset_features(self, ids, rngs):
        self.beacon[ids] = [rng.uniform(-5, 5, 2) for rng in rngs]

    def update_features(self):
        return np.exp(-self.distance)


if __name__ == "__main__":
    shes.register_environment("point-beacon", Point, Beacon)
    settings = {"population_size": 80, "learning_rate": 0.04, "controller_interval": 10, "horizon": 100}
    run = shes.train("point-beacon", preset="smoke", generations=30, num_workers=2, **settings)
    for checkpoint in ("0", "last"):
        print(f"checkpoint {checkpoint}: score {shes.evaluate(run.path, checkpoint=checkpoint).scores.mean():.1f}")
