"""The benches run and say what they promise. How fast they are is no test."""

import math
import time

import pytest

from shes.bench import bench_rollout, bench_update
from shes.training.presets import make_config

TINY = {"population_size": 8, "hidden": (4,), "horizon": 10, "evaluation_horizon": 10}


@pytest.mark.parametrize(
    ("env", "settings"),
    [
        ("point-gather", {}),
        ("ant-gather", {}),
        ("point-flagrun", {}),
        ("point-gather", {"algorithm": "es"}),
        ("point-gather", {"novelty": "nsr", "perturbation": "one_to_many", "clock_frequency": 1.0}),
    ],
)
def test_the_rollout_bench_compares_whole_generations_with_bare_physics(env, settings, monkeypatch):
    monkeypatch.setattr("shes.bench._REPLAY_S", 0.02)  # how exact it is does not matter here
    config = make_config(env, "smoke", {**TINY, "backend": "serial", **settings})
    found = bench_rollout(config, repeats=2)
    assert list(found) == [
        "env",
        "hidden",
        "integrator",
        "population_size",
        "episodes_per_policy",
        "device",
        "num_workers",
        "generations",
        "env_steps_per_s",
        "bare_steps_per_s",
        "ratio",
    ]
    assert (found["env"], found["hidden"], found["population_size"], found["num_workers"]) == (env, [4], 8, 1)
    assert all(math.isfinite(found[name]) and found[name] > 0 for name in list(found)[-3:])


def test_the_rollout_bench_goes_on_for_as_long_as_it_is_asked_to(monkeypatch):
    monkeypatch.setattr("shes.bench._REPLAY_S", 0.02)
    config = make_config("point-gather", "smoke", {**TINY, "backend": "serial"})
    start = time.perf_counter()
    found = bench_rollout(config, repeats=1, seconds=0.5)
    assert time.perf_counter() - start >= 0.5
    assert found["generations"] > 2


def test_the_update_bench_tells_the_parts():
    config = make_config("point-gather", "smoke", {**TINY, "num_workers": 2})
    found = bench_update(config, repeats=2)
    assert list(found) == [
        "parameters",
        "noise_vectors",
        "total_ms",
        "rank_ms",
        "gradient_ms",
        "optimizer_ms",
        "checkpoint_ms",
    ]
    assert found["noise_vectors"] == 2
    assert found["parameters"] > 100
    assert all(math.isfinite(value) and value > 0 for value in found.values())
