"""The limit that networks of 3 × 256 set to a rollout: where the time of a policy goes, and what could be left of it.

`python benchmarks/policy_limit.py --out results/policy_limit.csv`, three minutes on an idle machine. A rollout of Ant
Gather at the paper's size is compared with bare `mj_step` (`shes bench rollout`), and the forward passes in it are
timed. Then a forward pass of as many policies is timed alone, on one core, in ways that leave out one cost each. A row
is microseconds for an environment step, and the ratio to bare `mj_step` that the rollout would have if its forward
passes took only that:

- `in the rollout`: lanes of five episodes, each with weights of its own, more than fit the core's cache
- `alone`: the same without physics, which need the cache, too
- `weights in cache`: one lane again and again
- `only its products`: without biases and activations
- `one read of the weights`: a single pass over the weights of all lanes, by a sum: the speed of memory alone
- `noise shared by 20 rows`: the four mirrored members of a group in one lane, x W + s (x N)
- `low rank`: the mean's product alone, for the rows of all lanes at once
- `products at peak`: the same operations at the speed of a product of two 2000 × 2000 matrices
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

from collections.abc import Callable
from itertools import islice, pairwise
from time import perf_counter
from unittest.mock import patch

import numpy as np
from run import PAPER, bench, write_csv

from shes.algorithms.worker import lanes_that_fit
from shes.bench.evolution import evolution_strategy, evolve
from shes.cores import on_one_core
from shes.policies.mlp import MLP, Layers, aligned_rows
from shes.runs.build import build_backend
from shes.training.make_config import make_config

INPUTS, OUTPUTS, HIDDEN = 53, 8, (256, 256, 256)
EPISODES = 5
PEAK = 2000


def microseconds(work: Callable[[], object], seconds: float = 2.0) -> float:
    """Return the median duration of `work` in microseconds."""
    work()
    times: list[float] = []
    end = perf_counter() + seconds
    while perf_counter() < end:
        start = perf_counter()
        work()
        times.append(perf_counter() - start)
    return 1e6 * float(np.median(times))


def microseconds_in_rollouts(generations: int = 5) -> float:
    """Return the median microseconds of forward passes for an environment step of a rollout."""
    spent = 0.0
    forward = MLP.forward

    def timed(policy: MLP, layers: Layers, observation: np.ndarray) -> np.ndarray:
        nonlocal spent
        start = perf_counter()
        outputs = forward(policy, layers, observation)
        spent += perf_counter() - start
        return outputs

    settings = {"backend": "serial", "population_size": 40, "noise_table_size": 25_000_000}
    config = make_config("ant-gather", "paper", settings)
    algorithm = evolution_strategy(config)
    times: list[float] = []
    with build_backend(config, algorithm.plan()) as backend, patch.object(MLP, "forward", timed):
        for report in islice(
            evolve(algorithm.start(1), algorithm.hyperparameters, algorithm.table, backend), generations
        ):
            times.append(1e6 * spent / report.num_steps)
            spent = 0.0
    return float(np.median(times))


def policy_times() -> dict[str, float]:
    """Return the microseconds of a forward pass for one episode and step, by the ways above."""
    policy, rng = MLP(INPUTS, HIDDEN, OUTPUTS), np.random.default_rng(0)
    lanes = lanes_that_fit(2 * policy.num_params, EPISODES)  # two levels share the cache
    theta = aligned_rows(lanes, policy.num_params)
    theta[:] = 0.05 * rng.standard_normal(theta.shape)

    def rows(number: int, each: int) -> np.ndarray:
        return rng.standard_normal((number, each, INPUTS)).astype(np.float32)

    def products(layers: Layers, layer: np.ndarray) -> None:
        for weights, _ in layers:
            layer = layer @ weights

    many, one = rows(lanes, EPISODES), rows(1, EPISODES)
    layers, first, mean = policy.layers(theta), policy.layers(theta[:1]), policy.layers(theta[-1:])
    shared, groups = rows(max(1, lanes // 4), 4 * EPISODES), max(1, lanes // 4)
    noise = policy.layers(theta[:groups])
    scaled = tuple(
        (np.full((groups, 4 * EPISODES, size), 0.02, np.float32), np.zeros((groups, 4 * EPISODES, size), np.float32))
        for size in policy.sizes[1:]
    )
    together = many.reshape(1, -1, INPUTS)
    square = rng.standard_normal((PEAK, PEAK)).astype(np.float32)
    operations = 2 * sum(a * b for a, b in pairwise(policy.sizes))
    peak_s = microseconds(lambda: square @ square) / 1e6
    return {
        "alone": microseconds(lambda: policy.forward(layers, many)) / (lanes * EPISODES),
        "weights in cache": microseconds(lambda: policy.forward(first, one)) / EPISODES,
        "only its products": microseconds(lambda: products(first, one)) / EPISODES,
        "one read of the weights": microseconds(lambda: theta.sum(axis=1)) / (lanes * EPISODES),
        "noise shared by 20 rows": microseconds(lambda: policy.forward_around(mean, noise, scaled, shared))
        / (groups * 4 * EPISODES),
        "low rank": microseconds(lambda: policy.forward(mean, together)) / (lanes * EPISODES),
        "products at peak": 1e6 * operations * peak_s / (2 * PEAK**3),
    }


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="CSV file for the numbers")
    asked = parser.parse_args()
    measured = bench(f"rollout ant-gather --workers 1 {PAPER} --seconds 60")
    bare, whole = 1e6 / measured["bare_steps_per_s"], 1e6 / measured["bare_steps_per_s"] / measured["ratio"]
    with on_one_core():
        times = {"in the rollout": microseconds_in_rollouts(), **policy_times()}
    others = whole - bare - times["in the rollout"]
    found = [
        {"part": "bare mj_step", "us_per_step": bare, "ratio": 1.0},
        {"part": "the rollout", "us_per_step": whole, "ratio": measured["ratio"]},
        {
            "part": "the rollout without forward passes",
            "us_per_step": bare + others,
            "ratio": bare / (bare + others),
        },
    ]
    found += [
        {"part": f"forward pass: {name}", "us_per_step": time, "ratio": bare / (bare + others + time)}
        for name, time in times.items()
    ]
    for row in found:
        print(f"{row['part']:45} {row['us_per_step']:7.1f} us  {row['ratio']:.3f}")
    if asked.out:
        write_csv(asked.out, found)


if __name__ == "__main__":
    main()
