"""A task without physics that keeps the Task contract: deterministic, and exact in whatever batch it runs.

How an episode ends is in its seed: see `ends_of`. Only + - * / are used, so no bit depends on the batch. Worker
processes import this module: `FakeEnvironment` is what a plan sends them.
"""

from dataclasses import dataclass

import numpy as np


def ends_of(seed):
    """Return after how many steps an episode terminates and diverges, 0 for never."""
    kind, number = seed % 4, 1 + seed // 4 % 20
    return number * (kind in (1, 3)), number * (kind in (2, 3))


def make_seed(*, terminates_after=0, diverges_after=0, draw=0):
    """Return a seed whose episode ends as said, after 20 steps at most; `draw` tells seeds of one script apart."""
    kind = (1 if terminates_after else 0) + (2 if diverges_after else 0)
    return kind + 4 * (max(terminates_after, diverges_after, 1) - 1) + 80 * draw


class FakeTask:
    """A point that goes where it is pushed; it is paid for going right, and more the longer the episode."""

    observation_size = 5
    action_size = 2
    control_limit = 1.0
    physics_s = 0.0
    xp = np
    starts_together = False

    def __init__(self, num_episodes, on_step=None, goal_interval=0):
        """Make room for `num_episodes`; with a `goal_interval` the task itself sets goals and moves them as often."""
        self.num_episodes = num_episodes
        self.on_step = on_step
        self.goal_interval = goal_interval
        self.goal = np.ones((num_episodes, 2)) if goal_interval else None
        self.terminates_after, self.diverges_after, self.seeds = np.zeros((3, num_episodes), int)
        self.age, self.heading = np.zeros(num_episodes, int), np.zeros(num_episodes)
        self.position, self.wind = np.zeros((2, num_episodes, 2))
        self.reward, self.running_return = np.zeros((2, num_episodes))
        self.diverged, self.has_ended, self.observes_nan, self.truncated = np.zeros((4, num_episodes), bool)

    @property
    def terminated(self):
        return (self.terminates_after > 0) & (self.terminates_after <= self.age)

    @property
    def fallen(self):
        """Ends after an odd number of steps are falls."""
        return self.terminated & (self.age % 2 == 1)

    @property
    def tilt(self):
        return np.where(self.diverged, np.nan, np.abs(np.sin(self.age + self.position[:, 0])) / 2)

    @property
    def reward_after_end(self):
        return np.where(self.terminated & ~self.diverged, -2.0, 0.0)

    @property
    def score(self):
        return self.position[:, 0] * ~self.diverged

    @property
    def success(self):
        return self.score > 0

    def observe(self):
        seen = np.column_stack([self.position, self.wind * 10, self.age * 0.01])
        seen[self.observes_nan] = np.nan
        return seen

    def set_way(self, way):
        assert way is None

    def reset(self, ids, seeds, states=()):
        assert len(ids) == len(seeds)
        self.age[ids] = 0
        for i, seed in zip(ids, seeds, strict=True):
            rng = np.random.default_rng(seed)
            (self.terminates_after[i], self.diverges_after[i]), self.seeds[i] = ends_of(seed), seed
            self.position[i], self.wind[i] = rng.uniform(-2, 2, 2), rng.uniform(-0.1, 0.1, 2)
            self.heading[i] = rng.uniform(-3, 3)
            self._move_goal(i)
        for array in (self.reward, self.running_return, self.diverged, self.has_ended):
            array[ids] = 0

    def step(self, ids, action):
        assert np.all(np.diff(ids) > 0), "ids are sorted and unique"
        assert not self.has_ended[ids].any(), "an episode that has ended is not stepped"
        assert action.shape == (self.num_episodes, self.action_size)
        if self.on_step:
            self.on_step(self, ids, action)
        self.position[ids] += 0.3 * action[ids] + self.wind[ids]
        self.heading[ids] += 0.1 * action[ids, 0]
        self.age[ids] += 1
        for i in ids:
            if self.age[i] == self.diverges_after[i]:
                self.diverged[i] = True
                self.position[i] = 0  # the simulator's own reset state: finite
            if self.goal_interval and self.age[i] % self.goal_interval == 0:
                self._move_goal(i)
        # As in a real task, what is computed for rows that did not move means nothing.
        self.reward = (self.position[:, 0] + 0.25 * self.age) * ~self.diverged
        self.running_return += self.reward
        self.has_ended[ids] = (self.terminated | self.diverged)[ids]

    def _move_goal(self, i):
        """Put the goal of episode `i` somewhere that depends on its seed and its age."""
        if self.goal_interval:
            rng = np.random.default_rng([self.seeds[i], self.age[i]])
            self.goal[i] = self.position[i] + rng.uniform(0.5, 1.5, 2) * rng.choice([-1, 1], 2)

    def close(self):
        pass

    def check_buffers(self):
        pass


@dataclass(frozen=True)
class FakeEnvironment:
    """Makes fake tasks: in place of an environment of the registry."""

    goal_interval: int = 0
    has_own_physics = False

    def make(self, num_episodes, options=None, simulator=None):
        return FakeTask(num_episodes, goal_interval=self.goal_interval)
