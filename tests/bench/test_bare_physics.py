"""The bare loop: what it replays is what the generation played, in whole episodes and in branches."""

import numpy as np
import pytest

from shes.algorithms.evolution.algorithm import evolve
from shes.bench.bare_physics import record_generation
from shes.runs.build import build_algorithm, build_backend
from shes.training.make_config import make_config

TINY = {"population_size": 8, "hidden": (4,), "horizon": 10, "evaluation_horizon": 10, "backend": "serial"}
ALONE = {"primitive_estimate": "interval", "controller_interval": 3}
BRANCHES = {**ALONE, "primitive_view": "proprioception", "primitive_population_size": 12}


def _parts(env, settings):
    """Return the plan, the state, the settings and the noise table of a tiny run."""
    config = make_config(env, "smoke", {**TINY, **settings})
    learner = build_algorithm(config)
    return config, learner.plan(), learner.start(config.run.seed), learner.hyperparameters, learner.table


@pytest.mark.parametrize(
    ("env", "settings", "episodes", "branches"),
    [
        ("ant-gather", {}, 8, 0),
        ("ant-gather", BRANCHES, 8, 12),
        ("point-flagrun", ALONE, 0, 8),
        ("point-gather", {**BRANCHES, "chunk_size": 4}, 8, 12),
    ],
)
def test_a_replay_ends_where_the_generation_did(env, settings, episodes, branches):
    config, plan, state, rules, table = _parts(env, settings)
    with build_backend(config, plan) as backend:
        report = next(evolve(state, rules, table, backend))
    physics = record_generation(plan, state, rules, table.size)
    assert len(physics.episodes) == episodes + branches
    assert sum(len(episode.controls) for episode in physics.episodes) == report.num_steps
    ended = []
    for episode in physics.episodes:
        physics.replay(episode)
        ended.append(physics.data.qpos[:2].copy())
    populations = [each for each in (report.population, report.branches) if each is not None]
    assert np.array_equal(ended, np.concatenate([each.results.final_position[:, 0] for each in populations]))


def test_a_replay_has_the_same_share_of_episodes_and_branches(monkeypatch):
    monkeypatch.setattr("shes.bench.bare_physics._REPLAYED", 4)
    _, plan, state, rules, table = _parts("point-gather", BRANCHES)
    lengths = [len(episode.controls) for episode in record_generation(plan, state, rules, table.size).episodes]
    assert lengths == [10] * 4 + [6] * 6


def test_branches_begin_with_whole_states_not_at_a_reset():
    """Time and the solver's warm start are part of them: without these a replay would go another way."""
    _, plan, state, rules, table = _parts("ant-gather", BRANCHES)
    episodes = record_generation(plan, state, rules, table.size).episodes
    times = [episode.start[-1] for episode in episodes]
    assert set(times[:8]) == {0.0}
    assert max(times[8:]) > 0
