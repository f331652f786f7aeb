"""Experience of both levels against a plain loop over one environment, and the rules about the end of an episode."""

from itertools import count

import gymnasium
import numpy as np
import pytest

from shes.algorithms.hiro.collector import Actor
from shes.envs.registry import register_external
from shes.errors import DivergenceError
from shes.runs.build import build_algorithm
from shes.training.make_config import make_config

INTERVAL, HORIZON = 4, 10
SETTINGS = {"hidden": (5,), "controller_interval": INTERVAL, "horizon": HORIZON, "generation_steps": 50}


def algorithm(name="hiro", env="point-gather", **settings):
    values = {**SETTINGS, **settings}
    if name == "td3":
        del values["controller_interval"]
    return build_algorithm(make_config(env, "smoke", {"algorithm": name, **values}))


def start(learner):
    """Return a state of each level, without JAX."""
    return [level.start(np.random.default_rng(i)) for i, level in enumerate(learner.levels)]


def collector_of(learner, *, is_random=False):
    batch = learner.problem.env.make(learner.settings.num_envs, learner.problem.training)
    actors = {level.name: Actor(level, learner.design.input_clip) for level in learner.levels}
    for actor, state in zip(actors.values(), start(learner), strict=True):
        actor.use(state.parameters)
        actor.is_random = is_random
    return learner.make_collector(batch, actors), batch, actors


def collect(learner, num_steps=25, *, is_random=False):
    """Return the transitions of a generation by level, and the collector."""
    collector, _, _ = collector_of(learner, is_random=is_random)
    blocks = list(collector.run(num_steps, count(), np.random.default_rng(0)))
    joined = {
        name: {key: np.concatenate([block[name][key] for block in blocks]) for key in blocks[0][name]}
        for name in blocks[0]
    }
    return joined, collector


def test_episodes_begin_until_the_steps_are_made_and_all_end():
    rows, collector = collect(algorithm("td3", num_envs=2), num_steps=25)
    # Two at a time take 20 steps, then 40.
    assert collector.summary.num_steps == len(rows["policy"]["reward"]) == 40
    assert [episode["steps"] for episode in collector.summary.episodes] == [HORIZON] * 4
    assert set(rows) == {"policy"}


def test_the_transitions_of_a_flat_policy_are_those_of_a_plain_loop():
    learner = algorithm("td3", exploration_noise=0.0)
    rows, collector = collect(learner, num_steps=15)
    (state,), task = start(learner), learner.problem.make_task()
    seen, actions, rewards, following = [], [], [], []
    for seed in range(2):
        task.reset(np.array([0]), [seed])
        for _ in range(HORIZON):
            seen.append(task.observe()[0].copy())
            inputs = np.float32(seen[-1])[None, None]
            actions.append(learner.design.policy.act(state.parameters.theta[None], inputs)[0, 0])
            task.step(np.array([0]), actions[-1][None] * task.control_limit)
            rewards.append(task.reward[0])
            following.append(task.observe()[0].copy())
    made = rows["policy"]
    np.testing.assert_allclose(made["inputs"], seen, rtol=1e-6)
    np.testing.assert_allclose(made["action"], np.array(actions) * task.control_limit, rtol=1e-5)
    np.testing.assert_allclose(made["reward"], rewards, rtol=1e-6)
    np.testing.assert_allclose(made["next_inputs"], following, rtol=1e-6)
    assert (made["goes_on"] == 1).all()  # the time limit cuts nothing
    returns = [sum(rewards[:HORIZON]), sum(rewards[HORIZON:])]
    np.testing.assert_allclose([each["policy_return"] for each in collector.summary.episodes], returns)


def test_the_primitives_goal_moves_with_it_and_changes_at_every_interval():
    learner = algorithm()
    rows, _ = collect(learner, num_steps=1, is_random=True)
    size, made = learner.design.goals.size, rows["primitive"]
    goals, following = made["inputs"][:, :size], made["next_inputs"][:, :size]
    controller = rows["controller"]
    assert len(made["reward"]) == HORIZON
    assert len(controller["reward"]) == 2  # the third interval is cut short by the time limit
    starts = [0, 4, 8]
    np.testing.assert_allclose(goals[starts[:2]], controller["goal"], rtol=1e-6)
    for step in range(HORIZON):
        interval, inside = divmod(step, INTERVAL)
        if inside and interval < 2:  # h(s, g, s') from the start of the interval
            moved = controller["moved"][interval, inside]
            np.testing.assert_allclose(goals[step], goals[starts[interval]] - moved, atol=1e-5)
        if step + 1 < HORIZON:
            np.testing.assert_allclose(following[step], goals[step + 1], atol=1e-6)  # at the end: the new goal
    # The reward is minus the distance to the old goal, even where the next goal is another one.
    for step in (0, 1, 2, 4, 5, 6, 8, 9):
        assert made["reward"][step] == pytest.approx(-np.linalg.norm(following[step]), rel=1e-5)
    for interval in range(2):
        left = controller["goal"][interval] - controller["change"][interval]
        assert made["reward"][4 * interval + 3] == pytest.approx(-np.linalg.norm(left), rel=1e-5)


def test_an_interval_holds_what_its_steps_saw_and_did():
    learner = algorithm()
    rows, collector = collect(learner, num_steps=1, is_random=True)
    made, controller, size = rows["primitive"], rows["controller"], learner.design.goals.size
    first = slice(0, INTERVAL)
    np.testing.assert_array_equal(controller["view"][0], made["inputs"][first, size:])
    np.testing.assert_array_equal(controller["actions"][0], made["action"][first])
    np.testing.assert_array_equal(controller["is_step"], np.ones((2, INTERVAL)))
    np.testing.assert_array_equal(controller["next_inputs"][0], controller["inputs"][1])
    assert (controller["goes_on"] == 1).all()
    (episode,) = collector.summary.episodes
    assert len(collector.summary.goal_distances) == 2
    assert episode["primitive_return"] == pytest.approx(made["reward"].sum(), rel=1e-5)


def test_the_environments_reward_is_scaled_and_the_primitives_own_is_not():
    (one, _), (half, collector) = (
        collect(algorithm(env="point-maze", reward_scale=scale), num_steps=1, is_random=True) for scale in (1.0, 0.5)
    )
    np.testing.assert_allclose(half["controller"]["reward"], 0.5 * one["controller"]["reward"], rtol=1e-6)
    np.testing.assert_array_equal(half["primitive"]["reward"], one["primitive"]["reward"])
    assert collector.summary.episodes[0]["controller_return"] < 1.1 * half["controller"]["reward"].sum()  # unscaled
    flat, scaled = (collect(algorithm("td3", "point-maze", reward_scale=s), num_steps=1)[0] for s in (1.0, 0.5))
    np.testing.assert_allclose(scaled["policy"]["reward"], 0.5 * flat["policy"]["reward"], rtol=1e-6)


FALLS = {"env": "ant-gather", "spec": "hiro", "horizon": 200}


@pytest.mark.parametrize("bootstraps", [False, True])
def test_a_fall_ends_the_controllers_return_and_interval_unless_it_bootstraps(bootstraps):
    learner = algorithm(**FALLS, bootstrap_terminal=bootstraps)
    collector, batch, _ = collector_of(learner, is_random=True)
    made, controller = [], []
    for block in collector.run(1, count(), np.random.default_rng(0)):
        made.append(block["primitive"]["goes_on"])
        if len(block["controller"]["reward"]):
            controller.append({name: array[0] for name, array in block["controller"].items()})
        if len(made) == 6:
            batch.sim.qpos[0, 2] = 5.0  # it falls in the next step, the third of its interval
        if len(made) == 7:
            break
    assert [float(each[0]) for each in made] == [1.0] * 7  # the primitive would learn to fall
    assert len(controller) == 2
    assert (controller[0]["goes_on"], controller[1]["goes_on"]) == (1.0, float(bootstraps))
    assert controller[1]["is_step"].tolist() == [1, 1, 1, 0]
    assert controller[1]["reward"] == -10.0


@pytest.mark.parametrize("bootstraps", [False, True])
def test_a_fall_ends_the_return_of_a_policy_without_goals_unless_it_bootstraps(bootstraps):
    collector, batch, _ = collector_of(algorithm("td3", **FALLS, bootstrap_terminal=bootstraps), is_random=True)
    made = []
    for block in collector.run(1, count(), np.random.default_rng(0)):
        made.append(float(block["policy"]["goes_on"][0]))
        if len(made) == 2:
            batch.sim.qpos[0, 2] = 5.0  # it falls in the next step
        if len(made) == 3:
            break
    assert made == [1.0, 1.0, float(bootstraps)]


def test_the_steps_of_a_diverged_simulation_are_left_out():
    collector, batch, _ = collector_of(algorithm("td3", "ant-maze"))
    sizes = []
    for block in collector.run(1, count(), np.random.default_rng(0)):
        sizes.append(len(block["policy"]["reward"]))
        if len(sizes) == 3:
            batch.sim.qvel[0] = np.nan
    assert sizes == [1, 1, 1, 0]
    assert collector.summary.episodes[0]["diverged"] == 1
    assert all(np.isfinite(value) for value in collector.summary.episodes[0].values())


def test_exploration_is_within_the_range_and_as_wide_as_asked():
    learner = algorithm("td3", "ant-maze", exploration_noise=0.2)
    _, _, actors = collector_of(learner)
    inputs, rng = np.zeros((1, learner.design.policy.sizes[0])), np.random.default_rng(0)
    drawn = np.concatenate([actors["policy"].act(inputs, rng) for _ in range(2000)])
    assert drawn.std() == pytest.approx(0.2 * 30, rel=0.05)
    actors["policy"].is_random = True
    drawn = np.concatenate([actors["policy"].act(inputs, rng) for _ in range(2000)])
    assert (drawn.min(), drawn.max()) == (pytest.approx(-30, abs=0.1), pytest.approx(30, abs=0.1))
    raw = algorithm("td3", "ant-maze", noise_unit="raw", exploration_noise=1.0).levels[0]
    assert raw.exploration_std == (1.0,) * 8
    controller = algorithm("hiro", "ant-maze", goal_noise=0.1).levels[0]
    assert controller.exploration_std == pytest.approx(0.1 * np.array(controller.hyperparameters.half_range))


def test_a_time_limit_of_the_environments_own_does_not_cut_the_return():
    register_external("pendulum-of-7-steps", lambda: gymnasium.make("Pendulum-v1", max_episode_steps=7))
    rows, collector = collect(algorithm("td3", "pendulum-of-7-steps", horizon=50), num_steps=14)
    assert rows["policy"]["goes_on"].tolist() == [1] * 14
    assert [(each["steps"], each["terminated"]) for each in collector.summary.episodes] == [(7, 0), (7, 0)]


def test_environments_whose_episodes_end_at_different_times_keep_their_intervals_apart(monkeypatch):
    """Every interval of the controller is the steps of its primitive, with falls that come at any time."""
    interval, count_of = 4, 3
    learner = algorithm("hiro", "ant-gather", spec="hiro", num_envs=count_of, horizon=61, reward_scale=0.5)
    collector, batch, _ = collector_of(learner, is_random=True)
    size, given, kept = learner.design.goals.size, collector.transitions, []

    def transitions(step, rng):
        kept.append((step, batch.reward.copy(), given(step, rng)))
        return kept[-1][2]

    monkeypatch.setattr(collector, "transitions", transitions)
    for number, _ in enumerate(collector.run(400, count(), np.random.default_rng(0))):
        if number % 17 == 5:
            batch.sim.qpos[number % count_of, 2] = 5.0  # it falls by the rule of the task
    episodes, ends = {row: [] for row in range(count_of)}, []
    for step, reward, made in kept:
        intervals = [
            {name: values[i] for name, values in made["controller"].items()}
            for i in range(len(made["controller"]["reward"]))
        ]
        for i, row in enumerate(step.rows):
            primitive = {name: values[i] for name, values in made["primitive"].items()}
            assert primitive["goes_on"] == 1
            episodes[row].append((primitive, reward[row]))
            is_whole = len(episodes[row]) % interval == 0
            if is_whole or step.terminated[i]:
                found = intervals.pop(0)
                played = episodes[row][-(interval if is_whole else len(episodes[row]) % interval) :]
                goal, steps = found["goal"], len(played)
                assert found["reward"] == pytest.approx(0.5 * sum(earned for _, earned in played), rel=1e-5, abs=1e-6)
                assert found["is_step"].tolist() == [1] * steps + [0] * (interval - steps)
                assert found["goes_on"] == (not step.terminated[i])
                np.testing.assert_allclose(goal, played[0][0]["inputs"][:size], rtol=1e-6)
                for k, (each, _) in enumerate(played):
                    np.testing.assert_array_equal(found["actions"][k], each["action"])
                    np.testing.assert_array_equal(found["view"][k], each["inputs"][size:])
                    np.testing.assert_allclose(each["inputs"][:size], goal - found["moved"][k], atol=2e-4)
                assert played[-1][0]["reward"] == pytest.approx(-np.linalg.norm(goal - found["change"]), rel=1e-3)
                ends.append(bool(step.terminated[i]))
            if step.ended[i]:
                episodes[row].clear()
        assert intervals == []
    assert (len(ends) > 90, sum(ends) > 5) == (True, True)


@pytest.mark.parametrize("scale", [1e39, 1e308])  # -16 times which single and double precision do not hold
@pytest.mark.parametrize("name", ["td3", "hiro"])
def test_a_reward_that_is_too_large_ends_the_run(name, scale):
    learner = algorithm(name, "point-maze", reward_scale=scale)
    with pytest.raises(DivergenceError, match=r"larger than 3\.4e38.*--reward-scale"):
        collect(learner)
