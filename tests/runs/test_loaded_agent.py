"""Trained agents: shapes, goals held for c steps, episodes begun one by one."""

import copy
import pickle
import re

import gymnasium
import numpy as np
import pytest

from shes.envs.gymnasium_ids import gymnasium_id
from shes.runs.evaluate import evaluate, evaluation_seeds
from shes.runs.loaded_agent import load
from shes.streams import Purpose
from tests.e2e import runs


def test_an_observation_becomes_an_action_in_the_unit_box(tiny_run, monkeypatch, tmp_path):
    monkeypatch.setenv("SHES_CACHE_DIR", str(tmp_path / "cache"))
    agent = load(tiny_run)
    action = agent.act(np.full(25, 9.0))
    assert (action.shape, action.dtype) == ((2,), np.float64)
    assert (np.abs(action) <= 1).all()
    assert agent.act(np.zeros((1, 25))).shape == (1, 2)
    assert list(tmp_path.iterdir()) == []  # it needs no noise table


PLAYED = {
    "flat with clock": ("point-maze", {"algorithm": "es", "clock_frequency": 0.8}),
    "primitive alone": ("point-flagrun", {"controller_interval": 7, "goal_distance": 2.5}),
    "controller and clock": ("point-push", {"clock_frequency": 0.8, "controller_interval": 6}),
}


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Return a function that returns the folder of a tiny run of one of `PLAYED`."""
    kinds = {kind: (env, {"generations": 2, **settings}) for kind, (env, settings) in PLAYED.items()}
    return runs.trained_once(tmp_path_factory.mktemp("played"), kinds)


@pytest.mark.parametrize("kind", PLAYED)
def test_an_agent_earns_in_gymnasium_what_its_evaluation_says(played, kind):
    path = played(kind)
    expected = evaluate(path, episodes=3, num_workers=1, seed=11)
    agent = load(path)
    config = agent.config  # an environment under the conditions of the run's evaluation
    own = ("controller_interval", "goal_distance") if config.run.env.endswith("flagrun") else ()
    options = {"max_episode_steps": config.episodes.evaluation_horizon, **{name: config.values[name] for name in own}}
    env = gymnasium.make(gymnasium_id(config.run.env), evaluation=True, **options)
    for seed, earned in zip(evaluation_seeds(11, 0, 3, Purpose.FRESH_EPISODES), expected.returns, strict=True):
        agent.reset()
        observation, _ = env.reset(seed=seed)
        total, is_over = 0.0, False
        while not is_over:
            observation, reward, terminated, truncated, _ = env.step(agent.act(observation))
            total, is_over = total + float(reward), terminated or truncated
        assert total == pytest.approx(earned, rel=1e-6, abs=1e-6)
    assert len(set(expected.returns)) > 1
    assert (agent.goal is None) == kind.startswith("flat")


@pytest.mark.parametrize("kind", ["flat with clock", "controller and clock"])
def test_every_environment_is_played_as_if_it_were_alone(played, kind):
    """Its goal and its clock begin anew with `reset`."""
    path = played(kind)
    together, alone = load(path, num_envs=3), [load(path) for _ in range(3)]
    for step, seen in enumerate(np.random.default_rng(0).normal(size=(40, 3, together.observation_size))):
        if step == 15:
            together.reset(1)
            alone[1] = load(path)
        if step == 26:
            together.reset()
            alone = [load(path) for _ in range(3)]
        expected = np.stack([agent.act(row) for agent, row in zip(alone, seen, strict=True)])
        np.testing.assert_array_equal(together.act(seen), expected)
        if together.goal is not None:
            np.testing.assert_array_equal(together.goal, np.concatenate([agent.goal for agent in alone]))
            together.goal[:] = 99  # a copy


@pytest.mark.parametrize("copied", [lambda agent: pickle.loads(pickle.dumps(agent)), copy.copy])  # noqa: S301 - our own
@pytest.mark.parametrize("run", ["tiny", "ant-gather"])
def test_an_agent_is_copied_with_its_running_episodes(tiny_run, run, copied):
    agent = load(tiny_run if run == "tiny" else run, num_envs=2)
    seen = np.random.default_rng(0).normal(size=(60, 2, agent.observation_size))
    for rows in seen[:30]:  # into the second goal
        agent.act(rows)
    agent.reset(1)
    other = copied(agent)
    np.testing.assert_array_equal(other.goal, agent.goal)
    for rows in seen[30:]:
        np.testing.assert_array_equal(other.act(rows), agent.act(rows))
    agent.reset()
    agent.act(seen[0])
    assert not np.array_equal(other.goal, agent.goal)  # each has goals of its own


def test_an_agent_shows_parameters_and_statistics_of_every_level(tiny_run):
    agent = load(tiny_run, checkpoint="2")
    assert list(agent.levels) == ["controller", "primitive"]
    for level in runs.state(tiny_run, "2").levels:
        shown = agent.levels[level.name]
        for found, expected in ((shown.theta, level.theta), (shown.mean, level.statistics.mean)):
            np.testing.assert_array_equal(found, expected)
        np.testing.assert_allclose(1 / shown.inverse_std, level.statistics.std)
    assert re.fullmatch(
        r"<Agent of point-gather: controller of \d+ parameters, primitive of \d+ parameters; num_envs 1>", repr(agent)
    )
