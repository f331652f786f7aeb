"""Environments as users have them, and their descriptions: small, exact, and of every shape that Gymnasium allows."""

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete

STEP_M = 0.1


class Car(gymnasium.Env):
    """Goes where it is pushed, and turns. How it ends is in its arguments."""

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 20}  # noqa: RUF012 - Gymnasium's own
    action_space = Box(np.array([-2, 0, -1], np.float32), np.array([2, 4, 1], np.float32))
    observation_space = Dict(
        gear=Discrete(3),
        pose=Box(-np.inf, np.inf, (3,), np.float64),
        target=Box(-1, 1, (2,), np.float64),
        turn=Box(-1, 1, (4,), np.float32),
    )

    def __init__(self, render_mode=None, terminates_after=0, truncates_after=0, nan_after=0, bad_reward_after=0):
        self.render_mode = render_mode
        self.ends = (terminates_after, truncates_after, nan_after, bad_reward_after)
        self.shown = 0

    def _observe(self):
        half = self.yaw / 2
        return {
            "pose": np.array([*self.place, np.nan if 0 < self.ends[2] <= self.age else self.yaw]),
            "gear": self.gear,
            "target": self.target.copy(),
            "turn": np.array([np.cos(half), 0, 0, np.sin(half)], np.float32),
        }

    def _info(self):
        near = bool(np.abs(self.place - self.target).max() < 0.5)
        return {"is_success": near, "x": self.place[0], "y": self.place[1], "where": self.place.copy(), "name": "car"}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.age, self.yaw, self.gear = 0, float(self.np_random.uniform(-3, 3)), int(self.np_random.integers(3))
        self.place, self.target = self.np_random.uniform(-1, 1, 2), self.np_random.uniform(-1, 1, 2)
        return self._observe(), self._info()

    def step(self, action):
        assert self.action_space.contains(action), action
        self.age += 1
        self.place = self.place + STEP_M * action[:2]
        self.yaw += 0.5 * float(action[2])
        self.shown += self.render_mode == "human"
        terminated, truncated, _, bad = (0 < after <= self.age for after in self.ends)
        reward = np.nan if bad else -float(np.abs(self.place - self.target).sum())
        return self._observe(), reward, terminated, truncated, self._info()

    def render(self):
        picture = np.zeros((60, 80, 3), np.uint8)
        picture[:, :, 0] = 50 + self.age
        return picture if self.render_mode == "rgb_array" else None


class Silent(Car):
    """Has no pictures, and reports nothing."""

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own

    def _info(self):
        return {}


class Stepper(Car):
    """Is steered by four buttons."""

    action_space = Discrete(4)


class Unbounded(Car):
    """Knows no limit."""

    action_space = Box(-np.inf, np.inf, (3,))


class Growing(Car):
    """Shows a sequence."""

    observation_space = gymnasium.spaces.Sequence(Box(-1, 1, (2,)))


class Broken(Car):
    """Cannot begin."""

    def reset(self, *, seed=None, options=None):
        raise ZeroDivisionError("no road")


class Faulty(Car):
    """Does as it said in its first step, and from the second on, or in episodes of other seeds than 0, no longer."""

    def __init__(self, render_mode=None, fault="none"):
        super().__init__(render_mode)
        self.fault = fault

    def reset(self, *, seed=None, options=None):
        if self.fault == "reset" and seed != 0:
            raise RuntimeError("no\n  fuel")
        return super().reset(seed=seed)

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        if self.age < 2:
            return observation, reward, terminated, truncated, info
        if self.fault == "step":
            raise RuntimeError("no\n  fuel")
        if self.fault == "shape":
            observation["pose"] = np.zeros(5)
        if self.fault == "scalar":
            observation = np.float64(1)
        changes = {
            "info": {"where": np.zeros(3)},
            "one": {"where": 1.0},
            "text": {"where": "here"},
            "success": {"is_success": np.array([True, False])},
        }
        return (
            observation,
            None if self.fault == "pay" else reward,
            terminated,
            truncated,
            info | changes.get(self.fault, {}),
        )


class Late(Car):
    """Reports success where an episode ends, and there alone."""

    key = "is_success"

    def _info(self):
        near = bool(self.place[0] > self.target[0])
        return {self.key: near} if 0 < self.ends[0] <= self.age else {}


class Mute(Late):
    """Calls it otherwise."""

    key = "won"


class Dark(Car):
    """Cannot be drawn."""

    def render(self):
        raise RuntimeError("no lamp")


CLASSES = (Car, Dark, Silent, Stepper, Unbounded, Growing, Broken, Faulty, Late, Mute)

CAR = {
    "id": "tests/Car-v0",
    "position": "pose[0:2]",
    "heading": "pose[2]",
    "proprioception": "pose",
    "primitive_view": ["gear", "pose"],
}
"""What `register_external_environment` is told of the car. Flat: gear 0:3, pose 3:6, target 6:8, turn 8:12."""

POINT_MAZE = {"id": "shes/PointMaze-v0", "position": [0, 1], "proprioception": "0:4", "score": "success"}
"""Point Maze as if it were another's."""


def register():
    """Let Gymnasium know the classes."""
    for cls in CLASSES:
        gymnasium.register(f"tests/{cls.__name__}-v0", entry_point=cls, max_episode_steps=7)
