"""Known complaints of users of such environments that the reference and the contracts do not answer."""

import re
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest

from shes.envs.bodies.ant import Ant
from shes.envs.bodies.point import FallingPoint, Point
from shes.envs.gymnasium_ids import register_ids
from shes.envs.registry import ENVIRONMENTS
from shes.envs.tasks.fall import Fall
from shes.envs.tasks.flagrun import Flagrun
from shes.envs.tasks.gather import Gather
from shes.envs.tasks.maze import Maze
from shes.envs.tasks.push import Push
from tests.contracts.variants import VARIANTS
from tests.e2e.own_classes import Corner
from tests.golden import trajectories
from tests.golden.test_trajectories import test_an_environment_moves_as_its_golden_trajectory_says as check_golden

NUM_ENVS = 50


def over(choose):
    """Return a parametrization over the variants whose names `choose` accepts."""
    return pytest.mark.parametrize("variant", [each for each in VARIANTS if choose(each.name)], ids="-".join)


def has_target(name):
    return name.endswith(("-maze", "-push", "-fall"))


def task_of(env):
    """Return the task of a Gymnasium environment."""
    return env.unwrapped._adapter.task


# A sparse reward that is always zero.


@over(lambda name: name == "point-gather")
def test_a_random_point_finds_food_and_poison(variant):
    """Otherwise evolution has no signal at the start."""
    env = variant.make_vector(NUM_ENVS)
    env.reset(seed=0)
    rng, rewards = np.random.default_rng(0), []
    for step in range(100):
        if step % 10 == 0:
            action = rng.uniform(-1, 1, env.action_space.shape)
        rewards.append(env.step(action)[1])
    assert {-1, 1} <= set(np.unique(rewards))
    assert (np.sum(rewards, axis=0) != 0).mean() > 0.5


# A reset inside the goal radius.


@over(has_target)
def test_no_reset_of_evaluation_is_inside_the_goal_radius(variant):
    env = variant.make_vector(NUM_ENVS, evaluation=True)
    _, info = env.reset(seed=0)
    assert info["distance"].min() > 15
    assert not info["success"].any()
    assert not info["score"].any()


@over(lambda name: name.endswith("-gather"))
def test_nothing_lies_within_reach_at_a_reset_of_gather(variant):
    env = variant.make_vector(NUM_ENVS)
    env.reset(seed=0)
    offset = task_of(env).objects - task_of(env).position[:, None, None]
    assert np.linalg.norm(offset, axis=-1).min() > 1
    assert not env.step(np.zeros(env.action_space.shape))[1].any()


# A health check that ends episodes at once.


@over(has_target)
def test_no_posture_and_no_height_ends_an_episode_with_a_target(variant):
    env = variant.make_env()
    env.reset(seed=0)
    task, rng, heights = task_of(env), np.random.default_rng(0), []
    for step in range(60):
        if step == 30 and task.body.quaternion is not None:
            task.sim.qpos[0, task.body.quaternion] = [0, 1, 0, 0]  # on its back, in the air
            task.sim.qpos[0, 2] += 1
        if step == 40 and variant.name.endswith("-fall"):
            task.sim.qpos[0, :2] = [0.0, 16.0]  # over the chasm
        assert not env.step(rng.uniform(-1, 1, env.action_space.shape))[2], step
        heights.append(task.sim.qpos[0, 2] if task.body.num_qpos > 2 else 0.5)
    if variant.name.endswith("-fall"):
        assert heights[0] > 4  # what Gather calls fallen
        assert heights[-1] < 2


# Wrong registration ids.

IDS = {
    "shes/AntGather-v0": (Ant, Gather, "shes", 50),
    "shes/AntGatherHiro-v0": (Ant, Gather, "hiro", 50),
    "shes/AntMaze-v0": (Ant, Maze, "shes", 32),
    "shes/AntMazeHiro-v0": (Ant, Maze, "hiro", 32),
    "shes/AntPush-v0": (Ant, Push, "shes", 36),
    "shes/AntPushHiro-v0": (Ant, Push, "hiro", 32),
    "shes/AntFall-v0": (Ant, Fall, "shes", 37),
    "shes/AntFallHiro-v0": (Ant, Fall, "hiro", 33),
    "shes/AntFlagrun-v0": (Ant, Flagrun, "shes", 32),
    "shes/AntFlagrunHiro-v0": (Ant, Flagrun, "hiro", 32),
    "shes/PointGather-v0": (Point, Gather, "shes", 25),
    "shes/PointGatherHiro-v0": (Point, Gather, "hiro", 25),
    "shes/PointMaze-v0": (Point, Maze, "shes", 7),
    "shes/PointMazeHiro-v0": (Point, Maze, "hiro", 7),
    "shes/PointPush-v0": (Point, Push, "shes", 11),
    "shes/PointPushHiro-v0": (Point, Push, "hiro", 7),
    "shes/PointFall-v0": (FallingPoint, Fall, "shes", 14),
    "shes/PointFallHiro-v0": (FallingPoint, Fall, "hiro", 10),
    "shes/PointFlagrun-v0": (Point, Flagrun, "shes", 7),
    "shes/PointFlagrunHiro-v0": (Point, Flagrun, "hiro", 7),
}
"""Id, body, task, specification, and observed values as the specification counts them."""


@pytest.mark.parametrize("env_id", IDS)
def test_an_id_makes_the_environment_of_its_name(env_id):
    body, kind, spec, size = IDS[env_id]
    for made in (gymnasium.make(env_id), gymnasium.make_vec(env_id, num_envs=2)):
        task = task_of(made)
        assert (type(task.body), type(task), task.options.spec) == (body, kind, spec)
        assert made.observation_space.shape[-1] == task.observation_size == size
    assert gymnasium.spec(env_id).max_episode_steps == 500


def test_every_environment_has_its_id_in_both_specifications_and_no_id_is_missing():
    assert {each.id for each in VARIANTS} == set(IDS)
    assert len(IDS) == 2 * len(ENVIRONMENTS)


def test_there_is_no_hiro_id_of_a_task_without_that_specification(monkeypatch):
    monkeypatch.setattr("gymnasium.envs.registration.registry", dict(gymnasium.registry))
    monkeypatch.setattr(gymnasium, "registry", gymnasium.envs.registration.registry)
    monkeypatch.setattr("shes.envs.gymnasium_ids.SPECS_OF", {})
    register_ids("point-corner", Corner.specs)
    assert "shes/PointCorner-v0" in gymnasium.registry
    assert "shes/PointCornerHiro-v0" not in gymnasium.registry


# A MuJoCo upgrade silently changing a task's outcome.


def test_the_pinned_mujoco_is_the_one_of_the_golden_trajectories():
    constraints = Path(__file__).parents[2] / "constraints.txt"
    pinned = re.search(r"^mujoco==(\S+)$", constraints.read_text(encoding="utf-8"), re.MULTILINE)[1]
    assert {trajectories.load(each)["mujoco"] for each in VARIANTS} == {pinned}
    assert mujoco.__version__ == pinned


@over(lambda name: name.endswith(("-maze", "-push")))
def test_a_change_of_the_physics_fails_with_advice(variant, monkeypatch):
    """Imitates an upgrade: a physics step is one per cent shorter, and the stored version differs."""
    check_golden(variant)
    kind = type(variant.make_task(1))
    build = kind.build_world

    def build_otherwise(body, options):
        spec = build(body, options)
        spec.option.timestep *= 0.99
        return spec

    monkeypatch.setattr(kind, "build_world", staticmethod(build_otherwise))
    monkeypatch.setattr(mujoco, "__version__", "99.0.0")
    with pytest.raises(AssertionError, match=r"moves differently with MuJoCo 99\.0\.0.*python -m tests\.golden"):
        check_golden(variant)


@over(lambda name: name.endswith("-push"))
def test_a_change_of_contact_margins_fails_with_advice(variant, monkeypatch):
    """MuJoCo 4.0 changed how the margins of two geoms combine."""
    kind = type(variant.make_task(1))
    build = kind.build_world

    def build_otherwise(body, options):
        spec = build(body, options)
        for geom in spec.geoms:
            geom.margin /= 2
        return spec

    monkeypatch.setattr(kind, "build_world", staticmethod(build_otherwise))
    with pytest.raises(AssertionError, match="no longer moves as its golden trajectory says"):
        check_golden(variant)
