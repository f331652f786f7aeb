"""The benches run and say what they promise. How fast they are is no test."""

import math
import time

import pytest

from shes.bench.measure import bench_rollout, bench_update
from shes.errors import ConfigError
from shes.runs.build import build_algorithm
from shes.training.make_config import make_config

BRANCHES = {"primitive_estimate": "interval", "primitive_view": "proprioception", "controller_interval": 3}
TINY = {"population_size": 8, "hidden": (4,), "horizon": 10, "evaluation_horizon": 10}


@pytest.mark.parametrize(
    ("env", "settings"),
    [
        ("point-gather", {}),
        ("ant-gather", {}),
        ("ant-gather", BRANCHES),
        ("point-flagrun", {}),
        ("point-flagrun", {"primitive_estimate": "interval"}),
        ("point-gather", {"algorithm": "es"}),
        ("point-gather", {"perturbation": "one_to_many", "clock_frequency": 1.0}),
    ],
)
def test_the_rollout_bench_compares_whole_generations_with_bare_physics(env, settings, monkeypatch):
    monkeypatch.setattr("shes.bench.measure._REPLAY_S", 0.02)  # how exact it is does not matter here
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
    monkeypatch.setattr("shes.bench.measure._REPLAY_S", 0.02)
    config = make_config("point-gather", "smoke", {**TINY, "backend": "serial"})
    start = time.perf_counter()
    bench_rollout(config, repeats=1, seconds=0.5)
    assert time.perf_counter() - start >= 0.5


@pytest.mark.parametrize(
    ("env", "settings", "noise_vectors"),
    [
        ("point-gather", {}, (2, 0)),
        ("point-gather", {"algorithm": "es"}, (4, 0)),
        ("point-gather", {"perturbation": "one_to_many"}, (2, 0)),
        ("point-gather", {**BRANCHES, "primitive_population_size": 12}, (4, 6)),
        ("point-flagrun", {"primitive_estimate": "interval"}, (0, 4)),
    ],
)
def test_the_update_bench_tells_the_parts(env, settings, noise_vectors):
    config = make_config(env, "smoke", {**TINY, "num_workers": 2, **settings})
    found = bench_update(config, repeats=3)
    assert list(found) == [
        "parameters",
        "noise_vectors",
        "branch_noise_vectors",
        "total_ms",
        "rank_ms",
        "gradient_ms",
        "optimizer_ms",
        "checkpoint_ms",
    ]
    assert (found["noise_vectors"], found["branch_noise_vectors"]) == noise_vectors
    assert found["parameters"] == sum(build_algorithm(config).design.dims)
    assert all(math.isfinite(value) and value > 0 for value in list(found.values())[3:])


def test_the_update_bench_goes_on_for_as_long_as_it_is_asked_to():
    start = time.perf_counter()
    bench_update(make_config("point-gather", "smoke", TINY), repeats=1, seconds=0.3)
    assert time.perf_counter() - start >= 0.3


@pytest.mark.parametrize("bench", [bench_rollout, bench_update])
def test_only_evolution_strategies_are_measured(bench):
    message = r"bench measures evolution strategies, got td3\. Set --algorithm shes or es\."
    with pytest.raises(ConfigError, match=message):
        bench(make_config("point-gather", "smoke", {"algorithm": "td3"}))


@pytest.mark.parametrize("bench", [bench_rollout, bench_update])
def test_what_does_not_fit_the_memory_is_refused(bench):
    config = make_config("point-gather", "smoke", {**TINY, "population_size": 10**12})
    with pytest.raises(ConfigError, match=r"population_size is 1,000.* Set --population-size \d+ or less"):
        bench(config)
