"""Small external environments, with all kinds of spaces that Gymnasium allows."""

import sys
from contextlib import contextmanager

import gymnasium
import mujoco
import numpy as np
from gymnasium.spaces import Box, Dict, Discrete

from shes.envs.named_environments import EXTERNAL_ENVIRONMENTS

MAX_STEPS = 7
"""Time limit of the registration of every environment here."""


class Car(gymnasium.Env):
    """A car that moves and turns as it is pushed. Its arguments say how it ends or fails."""

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 20}  # noqa: RUF012 - Gymnasium's own
    action_space = Box(np.array([-2, 0, -1], np.float32), np.array([2, 4, 1], np.float32))
    observation_space = Dict(
        gear=Discrete(3), pose=Box(-np.inf, np.inf, (3,), np.float64), desired_goal=Box(-1, 1, (2,), np.float64)
    )

    def __init__(self, render_mode=None, terminates_after=0, truncates_after=0, spoils="", value=np.nan, fault=""):
        """Make a car. `spoils`, "pose" or "pay", is `value` from the third step on; `fault` begins with the second."""
        self.render_mode, self.fault = render_mode, fault
        self.ends, self.spoils, self.value = (terminates_after, truncates_after), spoils, value

    def _observe(self):
        return {
            "pose": np.array([*self.place, self.value if self.age > 2 and self.spoils == "pose" else self.yaw]),
            "gear": self.gear,
            "desired_goal": self.target.copy(),
        }

    def _info(self):
        near = bool(np.abs(self.place - self.target).max() < 0.5)
        return {"is_success": np.float32(near), "where": self.place.copy(), "yaw": self.yaw}

    def reset(self, *, seed=None, options=None):
        if self.fault == "reset" and seed != 0:
            raise RuntimeError("no\n  fuel")
        super().reset(seed=seed)
        self.age, self.yaw, self.gear = 0, float(self.np_random.uniform(-3, 3)), int(self.np_random.integers(3))
        self.place, self.target = self.np_random.uniform(-1, 1, 2), self.np_random.uniform(-1, 1, 2)
        return self._observe(), self._info()

    def step(self, action):
        assert self.action_space.contains(action), action
        self.age += 1
        self.place = self.place + 0.1 * action[:2]
        self.yaw += 0.5 * float(action[2])
        terminated, truncated = (np.bool_(0 < after <= self.age) for after in self.ends)
        reward = -float(np.abs(self.place - self.target).sum())
        reward = self.value if self.age > 2 and self.spoils == "pay" else reward
        return self._fail(self._observe(), reward, terminated, truncated, self._info())

    def _fail(self, observation, reward, terminated, truncated, info):
        """Return the arguments, or from the second step on what `fault` asks for."""
        fault = self.fault if self.age > 1 else ""
        if fault == "step":
            raise RuntimeError("no\n  fuel")
        if fault == "exit":
            sys.exit(3)
        if fault == "where":
            del info["where"]
        observation |= {"pose": np.zeros(5)} if fault == "shape" else {}
        info |= {"is_success": np.array([True, False])} if fault == "success" else {}
        info |= {fault: "1"} if fault in ("is_success", "diverged") else {}
        told = {"reward": reward, "terminated": terminated, "truncated": truncated}
        told |= {fault: "1"} if fault in told else {}
        observation = np.float64(1) if fault == "scalar" else observation
        return observation, *told.values(), info

    def render(self):
        if self.fault == "draw":
            raise RuntimeError("no lamp")
        picture = np.zeros((60, 80, 3), np.uint8)
        picture[:, :, 0] = 50 + self.age
        return picture if self.render_mode == "rgb_array" else None


class Silent(Car):
    """A car without pictures and with an empty `info`."""

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own

    def _info(self):
        return {}


class Stepper(Car):
    """A car with four discrete actions, starting at 3."""

    action_space = Discrete(4, start=3)


class Body(gymnasium.Env):
    """A MuJoCo body with joints `joints`; its position is not observed."""

    action_space = Box(-1, 1, (1,))
    observation_space = Box(-1, 1, (1,))

    def __init__(self, joints):
        world = f"<mujoco><worldbody><body><geom size='.1'/>{joints}</body></worldbody></mujoco>"
        self.data = mujoco.MjData(mujoco.MjModel.from_xml_string(world))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.data.qvel[:] = 0  # MuJoCo's own reset would forget its warnings, too
        self.data.qpos[:] = self.np_random.uniform(-1, 1, self.data.model.nq)
        mujoco.mj_normalizeQuat(self.data.model, self.data.qpos)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        mujoco.mj_step(self.data.model, self.data)
        return np.zeros(1, np.float32), 0.0, False, False, {}


class Holder(gymnasium.Env):
    """An environment that holds the one with the physics, as in Gymnasium-Robotics."""

    action_space, observation_space = Body.action_space, Body.observation_space

    def __init__(self, joints):
        self.inner = Body(joints)
        self.reset, self.step = self.inner.reset, self.inner.step


def locate_car(observation, info):
    """Return the pose of the car, from its observation."""
    return tuple(observation["pose"])


def locate_by_info(observation, info):
    """Return the pose of the car, from its `info`."""
    return *info["where"], info["yaw"]


@contextmanager
def registered():
    """Register the car in Gymnasium for a while, in which others may be registered, too.

    Those of an imported package stay: they come with its first import alone.
    """
    before = dict(EXTERNAL_ENVIRONMENTS)
    gymnasium.register("tests/Car-v0", entry_point=Car, max_episode_steps=MAX_STEPS)
    yield
    gymnasium.registry.pop("tests/Car-v0", None)
    EXTERNAL_ENVIRONMENTS.clear()
    EXTERNAL_ENVIRONMENTS.update(before)
