"""Known complaints of users of such environments: one test for each, over all tasks concerned.

Most tests use the environment through Gymnasium, as users do. Other tests check the same properties in detail.
"""

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


def over(choose=None, slow=None):
    """Return a parametrization over the variants with the chosen names, by default all; some are marked slow."""
    return pytest.mark.parametrize(
        "variant",
        [
            pytest.param(each, id="-".join(each), marks=[pytest.mark.slow] if slow and slow(*each) else [])
            for each in VARIANTS
            if choose is None or choose(each.name)
        ],
    )


def is_ant_by_rk4(name, spec):
    return name.startswith("ant-") and spec == "hiro"


def has_target(name):
    return name.endswith(("-maze", "-push", "-fall"))


def task_of(env):
    """Return the task of a Gymnasium environment."""
    return env.unwrapped._adapter.task


def start(variant, **options):
    """Return an environment after its reset, and its task."""
    env = variant.make_env(**options)
    env.reset(seed=0)
    return env, task_of(env)


def still(env):
    """Return the action that does nothing."""
    return np.zeros(env.action_space.shape, dtype=np.float32)


def put(task, place):
    """Place the robot at (x, y) or (x, y, z), at rest."""
    task.sim.qpos[0, : len(place)] = place
    task.sim.qvel[0] = 0


def seen(task, observation, *names):
    """Return the observed values with these names."""
    places = [element.name for element in task.observation_spec]
    return np.array([observation[..., places.index(name)] for name in names]).T


# Ant passes through walls: see test_physics.py.

# A sparse reward that is always zero.


@over(lambda name: name.endswith("-gather"))
def test_the_sparse_reward_of_gather_comes_with_what_is_collected(variant):
    env, task = start(variant, reset_noise=0.0)
    task.objects[:] = 9.0
    task.objects[0, 0, :2], task.objects[0, 1, 0] = (0.0, 0.5), (0.0, -0.5)
    _, reward, _, _, info = env.step(still(env))
    assert reward == 1  # two pieces of food, one of poison
    assert (info["food"], info["poison"], info["score"], info["success"]) == (2, 1, 1, True)
    assert env.step(still(env))[1] == 0  # they are gone


def test_a_random_point_finds_food_and_poison():
    """Otherwise evolution has no signal at the start."""
    for variant in (each for each in VARIANTS if each.name == "point-gather"):
        env = variant.make_vector(NUM_ENVS)
        env.reset(seed=0)
        rng, rewards = np.random.default_rng(0), []
        for step in range(100):
            if step % 10 == 0:
                action = rng.uniform(-1, 1, env.action_space.shape)
            rewards.append(env.step(action)[1])
        assert {-1, 1} <= set(np.unique(rewards))
        assert (np.sum(rewards, axis=0) != 0).mean() > 0.5


@over(has_target)
def test_score_and_success_come_when_the_target_is_near(variant):
    env, task = start(variant, evaluation=True, reset_noise=0.0)
    reward, _, _, info = env.step(still(env))[1:]
    assert reward < -5
    assert (info["score"], info["success"]) == (0, False)
    target, axis = task.target[0], np.array([1, 0, 0] if variant.name.endswith("-maze") else [0, -1, 0])
    for away, expected in ((4.5, 1), (5.5, 0), (0.5, 1)):  # between the walls all the way
        put(task, target + away * axis[: len(target)])
        reward, _, _, info = env.step(still(env))[1:]
        assert reward == pytest.approx(-info["distance"])
        assert info["distance"] == pytest.approx(away, abs=0.4)
        assert (info["score"], info["success"]) == (expected, bool(expected))


@over(lambda name: name.endswith("-flagrun"))
def test_the_reward_of_flagrun_grows_on_the_way_to_the_goal(variant):
    env, task = start(variant, reset_noise=0.0)
    begin, goal = task.position[0].copy(), task.goal[0].copy()
    rewards = []
    for part in (-0.5, 0.0, 0.3, 0.6, 1.0):
        put(task, begin + part * (goal - begin))
        rewards.append(env.step(still(env))[1])
    np.testing.assert_allclose(rewards, [-0.5, 0, 0.3, rewards[3], 2], atol=0.1)
    assert rewards == sorted(rewards)


# A reset inside the goal radius.


@over(has_target)
def test_no_reset_of_evaluation_is_inside_the_goal_radius(variant):
    env = variant.make_vector(NUM_ENVS, evaluation=True)
    for seed in (0, 1000):
        _, info = env.reset(seed=seed)
        assert info["distance"].min() > 15
        assert not info["success"].any()
        assert not info["score"].any()


@over(has_target)
def test_a_target_that_is_drawn_near_the_start_scores_at_the_end_alone(variant):
    """In both specifications Maze's training targets are anywhere; success refers to the end of the episode."""
    env, task = start(variant, reset_noise=0.0)
    task.target[0] = [*task.sim.qpos[0, : task.target.shape[1]]]
    assert env.step(still(env))[4]["success"]
    put(task, task.target[0] - [6.0, *task.target[0, 1:] * 0])
    _, _, terminated, _, info = env.step(still(env))
    assert not terminated
    assert not info["success"]


@over(lambda name: name.endswith("-flagrun"), slow=is_ant_by_rk4)
def test_no_goal_of_flagrun_is_drawn_within_a_metre(variant):
    env = variant.make_vector(NUM_ENVS, controller_interval=1)
    distances = [env.reset(seed=0)[1]["distance"]]
    for _ in range(40):
        distances.append(env.step(env.action_space.sample() * 0)[4]["distance"])
    assert np.min(distances) > 1 - 1e-9
    assert np.max(distances) < np.sqrt(32) + 1e-9
    assert np.min(distances) < 1.1


@over(lambda name: name.endswith("-gather"))
def test_nothing_lies_within_reach_at_a_reset_of_gather(variant):
    env = variant.make_vector(NUM_ENVS)
    env.reset(seed=0)
    task = task_of(env)
    offset = task.objects - task.position[:, None, None]
    assert np.linalg.norm(offset, axis=-1).min() > 1
    assert not env.step(np.zeros(env.action_space.shape))[1].any()


# Stale desired goal after a goal change.


@over(lambda name: name.endswith("-maze"))
@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_after_a_reset_the_new_target_is_observed_and_paid_for(variant, mode):
    env = variant.make_vector(NUM_ENVS, autoreset_mode=mode, max_episode_steps=3)
    task = task_of(env)
    scale = 0.01 if variant.spec == "shes" else 1
    observation, _ = env.reset(seed=0)
    targets, changes = [], 0
    for _ in range(12):
        np.testing.assert_array_equal(seen(task, observation, "target_x", "target_y"), task.target * scale)
        targets.append(task.target.copy())
        shown = env.step(np.zeros(env.action_space.shape))
        is_new = np.any(task.target != targets[-1], axis=1)
        changes += is_new.all()
        assert is_new.all() == is_new.any()
        observation = shown[0]
        np.testing.assert_allclose(shown[4]["distance"], np.linalg.norm(task.position - task.target, axis=1))
        if not is_new.any():
            np.testing.assert_allclose(shown[1], -shown[4]["distance"])
    assert changes >= 3


@over(lambda name: name.endswith("-flagrun"), slow=is_ant_by_rk4)
def test_a_goal_of_flagrun_is_observed_as_soon_as_it_moves(variant):
    env = variant.make_vector(NUM_ENVS, controller_interval=4)
    task = task_of(env)
    observation, _ = env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-0.1, 0.1, (17, *env.action_space.shape))
    before, stands = task.goal.copy(), np.ones(NUM_ENVS, dtype=bool)
    for step in range(1, 17):
        offset = task.goal - task.position
        bearing = np.arctan2(offset[:, 1], offset[:, 0]) - task.heading
        expected = np.column_stack([np.sin(bearing), np.cos(bearing), np.linalg.norm(offset, axis=1) / 1000])
        shown = seen(task, observation, "goal_sin", "goal_cos", "goal_distance")
        np.testing.assert_allclose(shown, expected, atol=1e-12)
        observation, _, terminated, _, info = env.step(actions[step])
        stands &= ~terminated
        np.testing.assert_allclose(info["distance"], np.linalg.norm(task.goal - task.position, axis=1))
        assert ((task.goal != before).any(axis=1) == (step % 4 == 0))[stands].all()
        before = task.goal.copy()
    assert stands.mean() > 0.8


@over(lambda name: name.endswith("-flagrun"))
def test_success_of_flagrun_is_of_the_goal_that_the_step_was_for_even_where_a_new_one_is_drawn(variant):
    env, task = start(variant, reset_noise=0.0, controller_interval=5, max_episode_steps=5)
    assert not env.reset()[1]["success"]
    for step in range(1, 6):
        put(task, task.goal[0])
        _, reward, _, truncated, info = env.step(still(env))
        assert (info["success"], truncated) == (True, step == 5)
        assert reward > 1.5
    assert info["distance"] > 1 - 1e-9  # of the new goal, which the observation shows
    assert not env.reset()[1]["success"]


@over(lambda name: name.endswith("-flagrun"))
def test_away_from_its_goal_flagrun_is_no_success_even_if_the_new_one_were_near(variant):
    env, task = start(variant, reset_noise=0.0)
    assert not env.step(still(env))[4]["success"]
    task.goal[0] = task.position[0]
    assert not task.success[0]


# Locomotion reward returned instead of the task's.


@over(has_target)
def test_running_alone_pays_nothing_where_there_is_a_target(variant):
    env, task = start(variant, evaluation=True, reset_noise=0.0)
    rewards = []
    for speed in (-3.0, 0.0, 3.0):
        for effort in (0.0, 1.0):
            env.reset(seed=0)
            task.sim.qvel[0, 1] = speed  # toward the target's side, or away from it
            _, reward, _, _, info = env.step(np.full(env.action_space.shape, effort))
            assert reward == pytest.approx(-info["distance"])
            place = np.zeros(3)
            place[: len(task.target[0])] = task.sim.qpos[0, : len(task.target[0])]
            assert info["distance"] == pytest.approx(np.linalg.norm(place[: len(task.target[0])] - task.target[0]))
            rewards.append(reward)
    assert np.mean(rewards[:2]) < np.mean(rewards[2:4]) < np.mean(rewards[4:])


@over(lambda name: name.endswith("-gather"))
def test_running_alone_pays_nothing_in_gather(variant):
    env, task = start(variant, reset_noise=0.0)
    task.objects[:] = -9.0
    for _ in range(5):
        task.sim.qvel[0, :2] = 4.0
        _, reward, terminated, _, _ = env.step(np.ones(env.action_space.shape))
        assert reward == 0
        if terminated:
            break
    assert np.linalg.norm(task.position[0]) > 1


@over(lambda name: name.endswith("-flagrun"))
def test_running_alone_pays_nothing_in_flagrun(variant):
    for direction in (1, -1):
        env, task = start(variant, reset_noise=0.0)
        offset = task.goal[0] - task.position[0]
        task.sim.qvel[0, :2] = direction * 3 * offset / np.linalg.norm(offset)
        assert np.sign(env.step(still(env))[1]) == direction


# `done` never set at the time limit.


@over(slow=is_ant_by_rk4)
def test_an_episode_ends_at_the_time_limit(variant):
    env, _ = start(variant, reset_noise=0.0)
    action = still(env)
    for step in range(1, 501):
        terminated, truncated = env.step(action)[2:4]
        assert not terminated
        assert truncated == (step == 500)


@over()
def test_every_episode_of_a_vector_ends_at_the_time_limit(variant):
    env = variant.make_vector(3, max_episode_steps=4, reset_noise=0.0)
    env.reset(seed=0)
    for step in range(1, 5):
        assert env.step(np.zeros(env.action_space.shape))[3].all() == (step == 4)


# Fall's health check ending episodes at once.


@over(has_target)
def test_where_there_is_a_target_no_posture_and_no_height_ends_an_episode(variant):
    env, task = start(variant)
    rng = np.random.default_rng(0)
    heights = []
    for step in range(60):
        if step == 30 and task.body.quaternion is not None:
            task.sim.qpos[0, task.body.quaternion] = [0, 1, 0, 0]  # on its back, in the air
            task.sim.qpos[0, 2] += 1
        if step == 40 and variant.name.endswith("-fall"):
            put(task, [0.0, 16.0])  # over the chasm
        terminated = env.step(rng.uniform(-1, 1, env.action_space.shape))[2]
        assert not terminated, step
        heights.append(task.sim.qpos[0, 2] if task.body.num_qpos > 2 else 0.5)
    if variant.name.endswith("-fall"):
        assert heights[0] > 4  # what Gather calls fallen
        assert heights[-1] < 2


def test_where_falling_ends_an_episode_a_standing_ant_goes_on():
    for name in ("ant-gather", "ant-flagrun"):
        env, task = start(next(each for each in VARIANTS if each.name == name), reset_noise=0.0)
        for _ in range(20):
            assert not env.step(still(env))[2]
        task.sim.qpos[0, 2] = 1.5
        assert env.step(still(env))[2]


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
    assert set(IDS) <= set(gymnasium.registry)
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
