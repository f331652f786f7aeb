"""Experience of both levels against a plain loop over one environment, and the rules about the end of an episode."""

from itertools import count

import gymnasium
import numpy as np
import pytest

from shes.baselines.collector import Actor
from shes.envs.named_environments import register_external
from shes.errors import DivergenceError
from shes.runs.build import build_algorithm
from shes.runs.make_config import make_config
from tests.envs.episodes import make_task

INTERVAL, HORIZON = 4, 10
SETTINGS = {"hidden": (5,), "horizon": HORIZON, "generation_steps": 50}


def algorithm(name="hiro", env="point-gather", **settings):
    goals = {"controller_interval": INTERVAL} if name == "hiro" else {}
    return build_algorithm(make_config(env, "smoke", {"algorithm": name, **SETTINGS, **goals, **settings}))


def collector_of(learner, *, is_random=True):
    """Return a collector, its environments and its actors, which are untrained. It needs no JAX."""
    batch = learner.problem.env.make(learner.settings.num_envs, learner.problem.training)
    actors = [Actor(level) for level in learner.levels]
    for actor, level in zip(actors, learner.levels, strict=True):
        state = level.start(np.random.default_rng(0))
        actor.use(state.learner["actor"], state.statistics)
        actor.is_random = is_random
    return learner.collector(batch, learner.design, actors, learner.problem.horizon, learner.settings), batch, actors


def collect(learner, num_steps=1):
    """Return the transitions of a generation by level, and the collector."""
    collector, _, _ = collector_of(learner)
    blocks = list(collector.run(num_steps, count(), np.random.default_rng(0)))
    joined = {
        name: {key: np.concatenate([block[name][key] for block in blocks]) for key in blocks[0][name]}
        for name in blocks[0]
    }
    return joined, collector


def test_a_goal_of_the_ant_is_all_of_its_coordinates():
    env = "ant-push"  # which observes a block, too
    design, task = algorithm(env=env, spec="hiro").design, make_task(env, 1, spec="hiro")
    assert design.half_range == (10, 10, 0.5, 1, 1, 1, 1, 0.5, 0.3, 0.5, 0.3, 0.5, 0.3, 0.5, 0.3)
    task.reset(np.array([0]), [1])
    np.testing.assert_array_equal(design.coordinates(task.observe(), task.position), task.sim.qpos[:, :15])
    seen = [task.observation_names[i] for i in design.primitive_view.indices]
    assert seen == [*(each.name for each in (*task.robot.pose[2:], *task.robot.velocity)), "time"]
    assert len(seen) == 28  # 30 in HIRO, where x and y are zero


def test_a_goal_of_other_robots_is_their_position():
    register_external("pendulum-in-a-plane", lambda: gymnasium.make("Pendulum-v1"), locate=lambda o, _: (*o[:2], 0))
    position = np.array([[3.0, 4.0]])
    for env, columns in (("point-fall", (0, 1)), ("pendulum-in-a-plane", None)):
        design = algorithm(env=env, goal_distance=3.0).design
        assert (design.half_range, design.columns) == ((3.0, 3.0), columns)
        assert design.coordinates(np.array([[3.0, 4.0, 5.0]]), position).tolist() == position.tolist()


def test_episodes_begin_until_the_steps_are_made_and_all_end():
    """No time limit cuts a return, not even one of the environment's own."""
    rows, collector = collect(algorithm("td3", num_envs=2), num_steps=25)
    assert collector.num_steps == len(rows["policy"]["reward"]) == 40  # two at a time take 20 steps, then 40
    assert [episode["steps"] for episode in collector.episodes] == [HORIZON] * 4
    register_external("pendulum-of-7-steps", lambda: gymnasium.make("Pendulum-v1", max_episode_steps=7))
    rows, collector = collect(algorithm("td3", "pendulum-of-7-steps", horizon=50), num_steps=14)
    assert rows["policy"]["goes_on"].tolist() == [1] * 14
    assert [(each["steps"], each["terminated"]) for each in collector.episodes] == [(7, 0), (7, 0)]


FALLS = {"env": "ant-gather", "spec": "hiro", "horizon": 200}


@pytest.mark.parametrize("bootstraps", [False, True])
def test_a_fall_ends_the_return_of_a_flat_policy(bootstraps):
    collector, batch, _ = collector_of(algorithm("td3", **FALLS, bootstrap_terminal=bootstraps))
    made = []
    for block in collector.run(1, count(), np.random.default_rng(0)):
        made.append(block["policy"]["goes_on"][0])
        if len(made) == 2:
            batch.sim.qpos[0, 2] = 5.0  # it falls in the next step, the last of the episode
    assert made == [1.0, 1.0, float(bootstraps)]


def test_steps_of_a_diverged_simulation_are_left_out():
    collector, batch, _ = collector_of(algorithm("td3", "ant-maze"))
    sizes = []
    for block in collector.run(1, count(), np.random.default_rng(0)):
        sizes.append(len(block["policy"]["reward"]))
        if len(sizes) == 3:
            batch.sim.qvel[0] = np.nan
    assert sizes == [1, 1, 1, 0]
    assert collector.episodes[0]["diverged"] == 1
    assert all(np.isfinite(value) for value in collector.episodes[0].values())


@pytest.mark.parametrize("settings", [{"env": "point-maze"}, FALLS, {**FALLS, "bootstrap_terminal": True}])
def test_intervals_are_the_steps_of_the_primitive(settings):
    """Three environments at once, in one every step has a reward, in the others falls come at any time."""
    num_envs, scale, horizon = 3, 0.5, 61 if "spec" in settings else 60
    learner = algorithm(**{**settings, "horizon": horizon, "num_envs": num_envs, "reward_scale": scale})
    collector, batch, _ = collector_of(learner)
    size, steps, played, following, ends = len(learner.design.half_range), np.zeros(num_envs), [[], [], []], {}, []
    distances, returns = [], np.zeros(2)
    for number, block in enumerate(collector.run(400, count(), np.random.default_rng(0))):
        running = np.flatnonzero(collector.steps != steps)
        steps, reward, fallen = collector.steps.copy(), batch.reward.copy(), batch.terminated.copy()
        intervals = iter(range(len(block["controller"]["reward"])))
        for i, row in enumerate(running):
            step = {name: values[i] for name, values in block["primitive"].items()}
            if steps[row] > 1:
                np.testing.assert_array_equal(step["inputs"], following[row])
            following[row] = step["next_inputs"]
            assert step["goes_on"] == 1  # it would learn to fall
            played[row].append({**step, "earned": reward[row]})
            returns += reward[row], step["reward"]  # as they are, not scaled
            if steps[row] % INTERVAL == 0:
                distances.append(-step["reward"])
            if fallen[row] or steps[row] % INTERVAL == 0:
                made = {name: values[k] for k in [next(intervals)] for name, values in block["controller"].items()}
                own = {name: np.array([each[name] for each in played[row]]) for name in played[row][0]}
                length, goals = len(own["earned"]), own["inputs"][:, :size]
                assert made["reward"] == pytest.approx(scale * own["earned"].sum(), rel=1e-5, abs=1e-6)
                assert made["is_step"].tolist() == [1] * length + [0] * (INTERVAL - length)
                assert made["goes_on"] == (not fallen[row] or "bootstrap_terminal" in settings)
                np.testing.assert_array_equal(made["actions"][:length], own["action"])
                np.testing.assert_array_equal(made["view"][:length], own["inputs"][:, size:])
                # h(s, g, s') from the start of the interval; the reward is minus the distance that is left.
                np.testing.assert_allclose(goals, made["goal"] - made["moved"][:length], atol=2e-4)
                left = np.linalg.norm([*goals[1:], made["goal"] - made["change"]], axis=1)
                np.testing.assert_allclose(own["reward"], -left, rtol=1e-3)
                ends.append((fallen[row], own["earned"][:-1].any()))
                played[row].clear()
            if steps[row] == horizon:  # an interval is cut short; no new goal is set
                played[row].clear()
                assert np.linalg.norm(step["next_inputs"][:size]) == pytest.approx(-step["reward"], rel=1e-3)
        assert next(intervals, None) is None
        if number % 17 == 5 and "spec" in settings:
            batch.sim.qpos[number % num_envs, 2] = 5.0  # it falls by the rule of the task
    np.testing.assert_allclose(collector.goal_distances, distances, rtol=1e-6)
    episodes = [[each["controller_return"], each["primitive_return"]] for each in collector.episodes]
    np.testing.assert_allclose(np.sum(episodes, axis=0), returns, rtol=1e-5)
    falls, dense = np.sum(ends, axis=0)
    assert len(ends) > 90
    assert falls > 5 if "spec" in settings else dense == len(ends)


def test_exploration_is_within_the_range_and_as_wide_as_asked():
    learner = algorithm("td3", "ant-maze", exploration_noise=0.2)
    _, _, actors = collector_of(learner, is_random=False)
    inputs, rng = np.zeros((1, learner.design.observation_sizes[0])), np.random.default_rng(0)
    drawn = np.concatenate([actors[-1].act(inputs, rng) for _ in range(2000)])
    assert drawn.std() == pytest.approx(0.2 * 30, rel=0.05)
    actors[-1].is_random = True
    drawn = np.concatenate([actors[-1].act(inputs, rng) for _ in range(2000)])
    assert (drawn.min(), drawn.max()) == (pytest.approx(-30, abs=0.1), pytest.approx(30, abs=0.1))
    raw = algorithm("td3", "ant-maze", noise_unit="raw", exploration_noise=1.0).levels[0]
    assert raw.exploration_std.tolist() == [1.0] * 8
    controller = algorithm("hiro", "ant-maze", goal_noise=0.1).levels[0]
    assert controller.exploration_std == pytest.approx(0.1 * np.array(controller.half_range))


@pytest.mark.parametrize(("name", "scale"), [("td3", 1e39), ("hiro", 1e308)])  # single or double precision overflows
def test_a_reward_that_is_too_large_ends_the_run(name, scale):
    with pytest.raises(DivergenceError, match=r"larger than 3.4e38.*--reward-scale"):
        collect(algorithm(name, "point-maze", reward_scale=scale))
