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
from tests.contracts.variants import VARIANTS
from tests.e2e.own_classes import Corner
from tests.golden import trajectories


def over(*endings):
    """Return a parametrization over the variants whose names end so."""
    return pytest.mark.parametrize("variant", [each for each in VARIANTS if each.name.endswith(endings)], ids="-".join)


@over("point-gather")
def test_a_random_point_finds_food_and_poison(variant):
    """A sparse reward that is always zero gives evolution no signal at the start."""
    env = variant.make_vector(50)
    env.reset(seed=0)
    rng, rewards = np.random.default_rng(0), []
    for step in range(100):
        if step % 10 == 0:
            action = rng.uniform(-1, 1, env.action_space.shape)
        rewards.append(env.step(action)[1])
    assert {-1, 1} <= set(np.unique(rewards))
    assert (np.sum(rewards, axis=0) != 0).mean() > 0.5


@over("-maze", "-push", "-fall")
def test_no_evaluation_begins_at_the_target(variant):
    _, info = variant.make_vector(50, evaluation=True).reset(seed=0)
    assert info["distance"].min() > 15
    assert not (info["success"] | (info["score"] > 0)).any()


@over("-gather")
def test_no_object_of_gather_begins_within_reach(variant):
    env = variant.make_vector(50)
    env.reset(seed=0)
    assert np.linalg.norm(env.task.objects - env.task.position[:, None, None], axis=-1).min() > 1
    assert not env.step(np.zeros(env.action_space.shape))[1].any()


@over("-maze", "-push", "-fall")
def test_neither_posture_nor_height_ends_an_episode(variant):
    """Health checks of other tasks end such episodes at once."""
    env = variant.make_env()
    env.reset(seed=0)
    task, rng, heights = env.unwrapped.task, np.random.default_rng(0), []
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


SIZES = {
    "AntGather": (50, 50), "AntMaze": (32, 32), "AntPush": (36, 32), "AntFall": (37, 33), "AntFlagrun": (32, 32),
    "PointGather": (25, 25), "PointMaze": (7, 7), "PointPush": (11, 7), "PointFall": (14, 10), "PointFlagrun": (7, 7),
}  # fmt: skip
"""Observed values as the two specifications, shes and hiro, count them."""


@pytest.mark.parametrize("variant", VARIANTS, ids="-".join)
def test_an_id_makes_the_environment_of_its_name(variant):
    name = variant.id.removeprefix("shes/").removesuffix("-v0").removesuffix("Hiro")
    body = Ant if name.startswith("Ant") else FallingPoint if name == "PointFall" else Point
    task, spec = re.findall("[A-Z][a-z]+", name)[1].lower(), "hiro" if "Hiro" in variant.id else "shes"
    for made in (gymnasium.make(variant.id).unwrapped, gymnasium.make_vec(variant.id, num_envs=2)):
        assert (type(made.task.body), made.task.name, made.task.options.spec) == (body, task, spec)
        assert made.observation_space.shape[-1] == made.task.observation_size == SIZES[name][spec == "hiro"]
    assert gymnasium.spec(variant.id).max_episode_steps == 500


def test_every_environment_has_its_id_in_both_specifications():
    assert {each.id for each in VARIANTS} == {f"shes/{name}{spec}-v0" for name in SIZES for spec in ("", "Hiro")}


def test_a_task_without_hiro_specification_has_no_such_id(monkeypatch):
    monkeypatch.setattr("gymnasium.envs.registration.registry", dict(gymnasium.registry))
    monkeypatch.setattr(gymnasium, "registry", gymnasium.envs.registration.registry)
    monkeypatch.setattr("shes.envs.gymnasium_ids.SPECS_OF", {})
    register_ids("point-corner", Corner.specs)
    assert "shes/PointCorner-v0" in gymnasium.registry
    assert "shes/PointCornerHiro-v0" not in gymnasium.registry


def test_the_pinned_mujoco_is_the_golden_trajectories():
    """An upgrade of MuJoCo must not change a task's outcome silently."""
    constraints = Path(__file__).parents[2] / "constraints.txt"
    pinned = re.search(r"^mujoco==(\S+)$", constraints.read_text(encoding="utf-8"), re.MULTILINE)[1]
    assert {trajectories.load(each)["mujoco"] for each in VARIANTS} == {pinned} == {mujoco.__version__}
