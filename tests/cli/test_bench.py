"""`shes bench`: what the bare loop replays is what was played. How fast they are is no test."""

import json
import math
from functools import partial
from itertools import count

import numpy as np
import pytest

from shes.cli import main
from shes.cli.bench import bench_rollout, record_generation
from shes.evolution.algorithm import evolve
from shes.runs.build import build_algorithm, build_backend
from shes.runs.make_config import make_config
from tests.e2e import runs

TINY = {"population_size": 8, "hidden": (4,), "horizon": 10, "evaluation_horizon": 10, "backend": "serial"}
ALONE = {"primitive_estimate": "interval", "controller_interval": 3}
BRANCHES = {**ALONE, "primitive_view": "proprioception", "primitive_population_size": 12}
ONCE = {"repeats": 1, "replay_s": 0.01}
SPEEDS = ("env_steps_per_s", "bare_steps_per_s", "ratio")


def tiny(env, **settings):
    return make_config(env, "smoke", {**TINY, **settings})


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
    config = tiny(env, **settings)
    algorithm = build_algorithm(config)
    with build_backend(config, algorithm.plan()) as backend:
        report = next(evolve(algorithm.start(1), algorithm.hyperparameters, algorithm.table, backend))
    physics = record_generation(algorithm, 1)
    assert len(physics.episodes) == episodes + branches
    assert sum(len(episode.controls) for episode in physics.episodes) == sum(
        int(each.results.steps.sum()) for each in report.populations
    )
    ended = []
    for episode in physics.episodes:
        physics.replay(episode)
        ended.append(physics.data.qpos[:2].copy())
    assert np.array_equal(ended, np.concatenate([each.results.final_position[:, 0] for each in report.populations]))


def test_part_of_a_generation_has_its_share_of_branches():
    episodes = record_generation(build_algorithm(tiny("point-gather", **BRANCHES)), 1, num_episodes=4).episodes
    assert [len(episode.controls) for episode in episodes] == [10] * 4 + [6] * 6
    times = [episode.start[0] for episode in episodes]  # branches begin with the state of a snapshot
    assert (set(times[:4]), max(times[4:]) > 0) == ({0.0}, True)


@pytest.mark.parametrize(
    ("env", "settings"), [("ant-gather", BRANCHES), ("point-gather", {"algorithm": "es", "clock_frequency": 1.0})]
)
def test_whole_generations_are_compared_with_bare_physics(capsys, monkeypatch, env, settings):
    monkeypatch.setattr("shes.cli.bench.bench_rollout", partial(bench_rollout, **ONCE))
    words = ["bench", "rollout", env, "--preset", "smoke", *runs.flags(**{**TINY, **settings})]
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    names = "env hidden integrator population_size episodes_per_policy device num_workers generations"
    assert list(found) == [*names.split(), *SPEEDS]
    expected = {"env": env, "hidden": [4], "population_size": 8, "num_workers": 1, "generations": 1}
    assert expected.items() <= found.items()
    assert all(math.isfinite(found[name]) and found[name] > 0 for name in SPEEDS)
    assert main(words) == 0
    table = capsys.readouterr().out
    assert all(name in table for name in SPEEDS)


def test_the_measurement_lasts_as_long_as_asked(monkeypatch):
    monkeypatch.setattr("shes.cli.bench.perf_counter", count().__next__)  # a second between any two looks at the clock
    assert bench_rollout(tiny("point-gather"), repeats=1, seconds=20, replay_s=1)["generations"] > 1
