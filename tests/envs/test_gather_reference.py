"""Gather is bit-identical to the plain reference, which steps its own `MjData` of the same model.

The task steps all episodes at once; the reference handles one episode and one object at a time.
"""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from shes.envs.registry import make_task
from shes.envs.tasks.task_options import TaskOptions
from tests.envs.reference_gather import ReferenceGather

pytestmark = pytest.mark.extras  # the fast tests have three minutes


def draw_independent(rng, num_episodes, size):
    """Yield actions in [-1, 1] that are drawn for every step."""
    while True:
        yield rng.uniform(-1, 1, (num_episodes, size))


def draw_lasting(rng, num_episodes, size):
    """Yield actions of -1, 0 or 1 that each episode keeps for about ten steps, so that it travels."""
    actions = rng.integers(-1, 2, (num_episodes, size)).astype(float)
    while True:
        yield actions
        changes = rng.random(num_episodes) < 0.1
        actions = np.where(changes[:, None], rng.integers(-1, 2, actions.shape), actions)


def compare(name, num_episodes, steps, draw, arrange=None, integrator="euler"):
    """Play `steps` in both, compare every array after each, and return food, poison and falls of all episodes."""
    task = make_task(name, num_episodes, TaskOptions(integrator=integrator))
    ids = np.arange(num_episodes)
    task.reset(ids, ids)
    rng = np.random.default_rng(12)
    if arrange is not None:
        arrange(task, rng)
    references = [ReferenceGather(task.sim.model, task.body.name) for _ in ids]
    first = [
        reference.reset(task.sim.qpos[i], task.sim.qvel[i], task.objects[i, 0], task.objects[i, 1])
        for i, reference in enumerate(references)
    ]
    if arrange is None:
        assert_array_equal(task.observe(), first)
    has_fallen = np.zeros(num_episodes, dtype=bool)
    for step, action in zip(range(steps), draw(rng, num_episodes, task.action_size), strict=False):
        controls = action * task.control_limit
        task.step(ids, controls)
        played = [reference.step(controls[i]) for i, reference in enumerate(references)]
        observations, rewards, terminated, infos = zip(*played, strict=True)
        assert_array_equal(task.observe(), observations, err_msg=f"observation of step {step}")
        assert_array_equal(task.reward, rewards, err_msg=f"reward of step {step}")
        assert_array_equal(task.terminated, terminated, err_msg=f"end at step {step}")
        assert_array_equal(task.food, [info["food_count"] for info in infos], err_msg=f"food at step {step}")
        assert_array_equal(task.poison, [info["poison_count"] for info in infos], err_msg=f"poison at step {step}")
        assert_array_equal(task.score, [info["score"] for info in infos], err_msg=f"score at step {step}")
        assert_array_equal(task.running_return, [info["return"] for info in infos], err_msg=f"return at step {step}")
        has_fallen |= task.terminated
    assert not task.diverged.any()
    return int(task.food.sum()), int(task.poison.sum()), int(has_fallen.sum())


def launch_among_objects(task, rng):
    """Launch every ant at up to 6 m/s, some upwards, and place its objects around the path ahead."""
    n = task.num_episodes
    direction = rng.uniform(-np.pi, np.pi, n)
    unit = np.stack([np.cos(direction), np.sin(direction)], axis=1)
    task.sim.qvel[:, :2] = unit * rng.uniform(2, 6, (n, 1))
    task.sim.qvel[:, 2] = rng.uniform(0, 3, n)
    task.sim.qvel[:, 5] = rng.normal(0, 3, n)
    along = rng.uniform(0.5, 4, (n, 2, 8, 1))
    task.objects[:] = along * unit[:, None, None, :] + rng.normal(0, 0.7, task.objects.shape)


@pytest.mark.parametrize("num_episodes", [8, pytest.param(50, marks=pytest.mark.slow)])
@pytest.mark.timeout(300)
def test_ant_gather_equals_the_reference_over_random_episodes(num_episodes):
    compare("ant-gather", num_episodes, 500, draw_independent)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_ant_gather_equals_the_reference_over_fifty_episodes_of_lasting_actions(integrator):
    compare("ant-gather", 50, 500, draw_lasting, integrator=integrator)


def test_ant_gather_equals_the_reference_where_ants_meet_objects_and_fall():
    food, poison, falls = compare("ant-gather", 30, 60, draw_lasting, arrange=launch_among_objects)
    assert food > 60
    assert poison > 60
    assert 3 < falls < 30


@pytest.mark.parametrize("integrator", ["rk4", "implicitfast"])
def test_ant_gather_equals_the_reference_with_other_integrators(integrator):
    compare("ant-gather", 3, 60, draw_lasting, arrange=launch_among_objects, integrator=integrator)


@pytest.mark.timeout(300)
def test_point_gather_equals_the_reference_over_thirty_episodes():
    food, poison, falls = compare("point-gather", 30, 500, draw_lasting)
    assert food > 60
    assert poison > 60
    assert falls == 0


def test_point_gather_equals_the_reference_over_random_episodes():
    compare("point-gather", 20, 200, draw_independent)
