"""Speed of the environments: every task in training, and Ant Gather in Gymnasium. On an idle machine.

Prints two tables and, with `--out FILE`, writes every number as CSV. Each task is `shes bench rollout` in a process of
its own. The Gymnasium environments are measured in alternation, so that the drift of the machine affects all equally.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium
import mujoco
import numpy as np
from run import SECONDS, bench, write_csv

import shes  # noqa: F401 - registers the environments
from shes.envs.named_environments import ENVIRONMENTS

NUM_ENVS = 64
STEPS = 40
REPEATS = 9
REQUIRED = 0.85


def tasks() -> list[dict[str, object]]:
    """Measure and print every task in training relative to bare `mj_step`: preset `laptop`, one worker."""
    print(f"| {'task':16} | env steps/s | bare mj_step/s | ratio | required |")
    print(f"|{'-' * 18}|------------:|---------------:|------:|---------:|")
    rows: list[dict[str, object]] = []
    for name in ENVIRONMENTS:
        found = bench(f"{name} --workers 1 {SECONDS}")
        speed, bare, ratio = found["env_steps_per_s"], found["bare_steps_per_s"], found["ratio"]
        print(f"| {name:16} | {speed:11,.0f} | {bare:14,.0f} | {ratio:5.2f} | {REQUIRED:>8} |", flush=True)
        rows.append({"what": name, "steps_per_s": speed, "bare_per_s": bare, "ratio": ratio})
    return rows


def bare_steps_per_s() -> float:
    """Return control steps per second of an `mj_step` loop on Ant Gather with random controls, without resets."""
    task = ENVIRONMENTS["ant-gather"].make(1)
    data = mujoco.MjData(task.sim.model)
    controls = np.random.default_rng(0).uniform(-30, 30, (NUM_ENVS * STEPS, task.action_size))
    start = perf_counter()
    for control in controls:
        data.ctrl[:] = control
        mujoco.mj_step(task.sim.model, data, nstep=task.body.frame_skip)
    return len(controls) / (perf_counter() - start)


def single_steps_per_s(env: Any) -> float:
    """Return steps per second of one environment with random actions."""
    actions = np.random.default_rng(0).uniform(-1, 1, (NUM_ENVS * STEPS, *env.action_space.shape)).astype(np.float32)
    env.reset(seed=0)
    start = perf_counter()
    for action in actions:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    return len(actions) / (perf_counter() - start)


def vector_steps_per_s(env: Any) -> float:
    """Return steps per second of all environments of `env` together with random actions."""
    actions = np.random.default_rng(0).uniform(-1, 1, (STEPS, *env.action_space.shape)).astype(np.float32)
    env.reset(seed=0)
    start = perf_counter()
    for action in actions:
        env.step(action)
    return STEPS * env.num_envs / (perf_counter() - start)


def gymnasium_environments() -> list[dict[str, object]]:
    """Measure and print Ant Gather in Gymnasium: single and vector environments."""
    identity = "shes/AntGather-v0"
    single = gymnasium.make(identity)
    vector = gymnasium.make_vec(identity, num_envs=NUM_ENVS)
    asynchronous = gymnasium.make_vec(identity, num_envs=NUM_ENVS, vectorization_mode="async")
    measures: dict[str, Callable[[], float]] = {
        "bare mj_step": bare_steps_per_s,
        "single environment": lambda: single_steps_per_s(single),
        f"AsyncVectorEnv, {NUM_ENVS}": lambda: vector_steps_per_s(asynchronous),
        f"vector environment, {NUM_ENVS}": lambda: vector_steps_per_s(vector),
    }
    found: dict[str, list[float]] = {name: [] for name in measures}
    for _ in range(REPEATS):
        for name, measure in measures.items():
            found[name].append(measure())
    for env in (single, vector, asynchronous):
        env.close()
    bare, alone, theirs, mine = found.values()
    print(f"\n| {'Ant Gather in Gymnasium':28} | env steps/s |")
    print(f"|{'-' * 30}|------------:|")
    for name, values in found.items():
        print(f"| {name:28} | {statistics.median(values):11,.0f} |")
    ratios = {
        "single / bare (required: 0.3)": statistics.median(np.divide(alone, bare)),
        "vector / AsyncVectorEnv (goal 3)": statistics.median(np.divide(mine, theirs)),
        "vector / bare": statistics.median(np.divide(mine, bare)),
    }
    for name, ratio in ratios.items():
        print(f"{name}: {ratio:.2f}")
    speeds = [{"what": name, "steps_per_s": statistics.median(values)} for name, values in found.items()]
    return [*speeds, *({"what": name, "ratio": ratio} for name, ratio in ratios.items())]


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="CSV file for the numbers")
    out = parser.parse_args().out
    rows = [*tasks(), *gymnasium_environments()]
    if out is not None:
        write_csv(out, rows)


if __name__ == "__main__":
    main()
