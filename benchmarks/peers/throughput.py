"""Environment steps per second of a whole generation of flat S-ES on Ant Gather: SHES, EvoTorch, and a process pool.

`python benchmarks/peers/throughput.py --out results/peers/throughput.csv` (an idle machine; a quarter of an hour with
two cores). All evaluate a population of 240 policies, 64 x 64 units, for one episode of 500 steps of
`shes/AntGather-v0`, and make their update; observations are normalised. Every round measures, in processes of their own
and one after the other,

- `shes`: this package, flat S-ES;
- `evotorch`: PGPE on `GymNE` with a Ray actor for every core; `evotorch-pieces` gives the actors ten policies at a time
  instead of their halves of the population, `evotorch-more-actors` has an actor more than cores;
- `pool`: a plain Gymnasium loop with a NumPy policy in `multiprocessing.Pool`, without normalisation and update.

EvoTorch and the pool step the single Gymnasium environment of this package.

The first generation of each is not counted. Prints medians, and ratios in the same round. For its environment see
`learning.py`.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import argparse
import multiprocessing
import os
import statistics
import subprocess
import sys
from functools import cache, partial
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))
from run import write_csv
from versions import write_versions

ENV, POPULATION, STEPS, HIDDEN, SIGMA = "shes/AntGather-v0", 240, 500, 64, 0.02


def make_env() -> Any:
    """Return the environment."""
    import gymnasium

    import shes

    assert shes
    return gymnasium.make(ENV, max_episode_steps=STEPS)


def shes_speeds(cores: int, seconds: float) -> list[float]:
    """Return the steps per second of generations of SHES."""
    from shes.cli.bench import evolution_strategy
    from shes.evolution.algorithm import evolve
    from shes.runs.build import build_backend
    from shes.runs.make_config import make_config

    settings = {"algorithm": "es", "hidden": (HIDDEN, HIDDEN), "population_size": POPULATION, "horizon": STEPS}
    config = make_config("ant-gather", "laptop", {**settings, "num_workers": cores, "sigma": SIGMA})
    algorithm = evolution_strategy(config)
    state, steps, found = algorithm.start(1), 0, list[float]()
    with build_backend(config, algorithm.plan()) as backend:
        begun = perf_counter()
        for report in evolve(state, algorithm.hyperparameters, algorithm.table, backend):
            found.append((report.state.env_steps - steps) / (report.rollout_s + report.update_s))
            steps = report.state.env_steps
            if perf_counter() - begun > seconds:
                return found
    return found


def evotorch_speeds(cores: int, seconds: float, more_actors: int = 0, **options: int) -> list[float]:
    """Return the steps per second of generations of EvoTorch."""
    os.environ["RAY_ADDRESS"] = "local"  # not a cluster that happens to run here
    import torch
    from evotorch.algorithms import PGPE
    from evotorch.neuroevolution import GymNE

    torch.set_num_threads(1)
    layers = [f"Linear(obs_length, {HIDDEN})", f"Linear({HIDDEN}, {HIDDEN})", f"Linear({HIDDEN}, act_length)"]
    network = " >> Tanh() >> ".join(layers)
    problem = GymNE(make_env, network, observation_normalization=True, num_actors=cores + more_actors, **options)
    searcher = PGPE(
        problem,
        popsize=POPULATION,
        center_learning_rate=0.01,
        stdev_learning_rate=0.1,
        stdev_init=SIGMA,
        optimizer="clipup",
        optimizer_config={"max_speed": 0.02},
    )
    found, total, begun = list[float](), 0, perf_counter()
    while perf_counter() - begun < seconds or len(found) < 2:
        start = perf_counter()
        searcher.step()
        elapsed, now = perf_counter() - start, int(problem.status["total_interaction_count"])
        found.append((now - total) / elapsed)
        total = now
    problem.kill_actors()
    return found


own_env = cache(make_env)  # of a process of the pool


def run_policy(seed: int) -> int:
    """Run an episode with a random policy; return its steps."""
    env, rng = own_env(), np.random.default_rng(seed)
    observation, _ = env.reset(seed=seed)
    sizes = (len(observation), HIDDEN, HIDDEN, env.action_space.shape[0])
    layers = [SIGMA * rng.standard_normal((m, n)) for m, n in pairwise(sizes)]
    for step in range(1, STEPS + 1):
        action = observation
        for weights in layers:
            action = np.tanh(action @ weights)
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            return step
    return STEPS


def pool_speeds(cores: int, seconds: float) -> list[float]:
    """Return the steps per second of populations in a process pool."""
    found, begun = list[float](), perf_counter()
    with multiprocessing.get_context("spawn").Pool(cores) as pool:
        while perf_counter() - begun < seconds or len(found) < 2:
            start = perf_counter()
            steps = sum(pool.imap_unordered(run_policy, range(POPULATION)))
            found.append(steps / (perf_counter() - start))
    return found


WAYS = {
    "shes": shes_speeds,
    "evotorch": evotorch_speeds,
    "evotorch-pieces": partial(evotorch_speeds, subbatch_size=10),
    "evotorch-more-actors": partial(evotorch_speeds, more_actors=1),
    "pool": pool_speeds,
}


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="CSV file for the numbers")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=90.0, help="least duration of a measurement")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--measure", choices=WAYS, help="print the speed of one way")
    asked = parser.parse_args()
    if asked.measure:
        speeds = WAYS[asked.measure](asked.cores, asked.seconds)
        print("speed", statistics.median(speeds[1:]))
        return
    rows: list[dict[str, Any]] = []
    for number in range(asked.rounds):
        for way in WAYS:
            command = [sys.executable, __file__, "--measure", way, "--seconds", str(asked.seconds)]
            done = subprocess.run(
                [*command, "--cores", str(asked.cores)], check=True, stdout=subprocess.PIPE, text=True
            )
            speed = float(done.stdout.split("speed")[-1])
            rows.append({"way": way, "round": number, "cores": asked.cores, "env_steps_per_s": round(speed, 1)})
            print(rows[-1], flush=True)
    speeds = {way: [row["env_steps_per_s"] for row in rows if row["way"] == way] for way in WAYS}
    for way, found in speeds.items():
        ratio = statistics.median(own / each for own, each in zip(speeds["shes"], found, strict=True))
        print(f"{way}: {statistics.median(found):,.0f} steps/s; shes is {ratio:.1f} times as fast")
    if asked.out:
        write_csv(asked.out, rows)
        write_versions(asked.out.with_name("throughput_versions.csv"))


if __name__ == "__main__":
    main()
