"""Speed of HIRO's and TD3's learner: updates and environment steps per second on an idle machine.

`python benchmarks/hiro_speed.py --sb3-python PATH` measures our TD3 and Stable-Baselines3's of the same sizes. PATH
is the Python of a throwaway environment with stable-baselines3, psutil and this package's dependencies (torch stays out
of ours). Without it, ours alone is measured. Each measurement is a process of its own; their order alternates.
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from run import write_csv

ENV, BATCH, WARMUP, STEPS = "ant-maze", 100, 1000, 4000
SIZES = {"64 64": (64, 64), "300 300": (300, 300)}
"""Hidden layers of actor and critics."""
CASES = (("td3", 1, 10), ("td3", 1, 1), ("td3", 4, 10), ("hiro", 1, 10), ("sb3", 1, 1))
"""Learner, environments, and steps after which as many updates follow: ten by default, one in SB3 and as published."""


def ours(algorithm: str, hidden: tuple[int, ...], num_envs: int, update_interval: int) -> dict[str, float]:
    """Return the speeds of a run of this package, without the first generations, which compile.

    Updates are those of the acting level; the time of HIRO's includes the controller's, one for ten steps as published,
    and the correction of its goals.
    """
    import shes

    with tempfile.TemporaryDirectory() as folder:
        run = shes.train(
            ENV,
            algorithm=algorithm,
            hidden=hidden,
            num_envs=num_envs,
            update_interval=update_interval,
            batch_size=BATCH,
            warmup_steps=WARMUP,
            generation_steps=STEPS,
            horizon=500,
            generations=4,
            evaluation_interval=1000,
            evaluation_episodes=1,
            num_workers=1,
            out=Path(folder) / "run",
        )
        rows = run.progress
        level = "primitive" if algorithm == "hiro" else "policy"
        updates = rows[f"{level}_updates"][3] - rows[f"{level}_updates"][1]
        steps = rows["env_steps"][3] - rows["env_steps"][1]
        update_s, rollout_s = (rows[name][2:4].sum() for name in ("update_s", "rollout_s"))
    return {"updates_per_s": updates / update_s, "env_steps_per_s": steps / (update_s + rollout_s)}


def sb3(hidden: tuple[int, ...]) -> dict[str, float]:
    """Return the speeds of Stable-Baselines3's TD3, with one update per environment step."""
    from time import perf_counter

    import gymnasium
    from stable_baselines3 import TD3

    import shes  # noqa: F401 - registers the environments

    env = gymnasium.make("shes/AntMaze-v0")
    model = TD3(
        "MlpPolicy",
        env,
        batch_size=BATCH,
        learning_starts=WARMUP,
        policy_kwargs={"net_arch": list(hidden)},
        device="cpu",
        seed=0,
    )
    model.learn(WARMUP + 200)
    start = perf_counter()
    model.learn(STEPS, reset_num_timesteps=False)
    total_s = perf_counter() - start
    start = perf_counter()
    model.train(gradient_steps=1000, batch_size=BATCH)
    return {"updates_per_s": 1000 / (perf_counter() - start), "env_steps_per_s": STEPS / total_s}


def measure(python: str, *words: str) -> dict[str, float]:
    """Return what a process of its own measures."""
    source = str(Path(__file__).resolve().parents[1] / "src")
    done = subprocess.run(
        [python, __file__, "--measure", *words],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": source},
    )
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sb3-python", help="Python of an environment with stable-baselines3")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, help="CSV file for the numbers")
    parser.add_argument("--measure", nargs="+", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.measure:
        kind, size, *numbers = asked.measure
        found = sb3(SIZES[size]) if kind == "sb3" else ours(kind, SIZES[size], *map(int, numbers))
        print(json.dumps(found))
        return
    rows: list[dict[str, Any]] = []
    for size in SIZES:
        speeds: dict[tuple[str, int, int], list[dict[str, float]]] = {
            case: [] for case in CASES if case[0] != "sb3" or asked.sb3_python
        }
        for _ in range(asked.repeats):
            for (kind, *numbers), found in speeds.items():
                python = asked.sb3_python if kind == "sb3" else sys.executable
                found.append(measure(python, kind, size, *map(str, numbers)))
        for (kind, num_envs, update_interval), found in speeds.items():
            medians = {name: round(statistics.median(each[name] for each in found), 1) for name in found[0]}
            case = {"hidden": size, "learner": kind, "num_envs": num_envs, "update_interval": update_interval}
            rows.append({**case, **medians})
            print(rows[-1], flush=True)
        if asked.out is not None:
            write_csv(asked.out, rows)


if __name__ == "__main__":
    main()
