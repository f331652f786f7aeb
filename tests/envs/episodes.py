"""Makes tasks, plays their episodes, and shows everything that a caller can see of them."""

import numpy as np
from numpy.testing import assert_array_equal

from shes.envs.named_environments import find_environment
from shes.sim.simulator import CpuSimulator

NUMBERS = ("time", "reward", "running_return", "score", "position", "heading")
FLAGS = ("success", "terminated", "fallen", "diverged")


def make_task(name, num_episodes, simulator=CpuSimulator, **options):
    """Return episodes of environment `name` with `options` of its task."""
    environment = find_environment(name)
    return environment.make(num_episodes, environment.task.Options(**options), simulator)


def view(task, rows=slice(None)):
    """Return copies of every array of `rows`, by name."""
    seen = {name: np.array(getattr(task, name)[rows]) for name in NUMBERS + FLAGS}
    seen["observation"] = task.observe()[rows].copy()
    if hasattr(task, "sim"):
        seen["qpos"], seen["qvel"] = task.sim.qpos[rows].copy(), task.sim.qvel[rows].copy()
    return seen


def assert_same_view(left, right):
    for name, values in left.items():
        assert_array_equal(values, right[name], err_msg=name)


def draw_actions(task, steps, seed=0):
    """Return actions [steps, A] that use the whole range of the controls."""
    return np.random.default_rng(seed).uniform(-1, 1, (steps, task.action_size)) * task.control_limit


def play(task, actions, ids=None):
    """Step with `actions` [steps, A], the same for every row, and return the last view."""
    for action in actions:
        task.step(np.arange(task.num_episodes) if ids is None else ids, np.tile(action, (task.num_episodes, 1)))
    return view(task)
