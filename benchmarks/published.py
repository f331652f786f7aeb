"""Settings for SHES as published: `python benchmarks/published.py point --results results/paper`.

Twenty-four settings, the ones of the paper's experiments here and 23 drawn at random, train Gather with two seeds each
and equal environment steps. The table has a row for each run: the scores of its best and its last checkpoint over
200 fresh episodes. Every run can be interrupted at any time: the same command goes on.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from run import write_csv

import shes
from shes.runs.make_config import make_config
from shes.runs.tables import read_csv
from shes.runs.train import finish_run

SEEDS = (31, 32)
SEARCHED: dict[str, tuple[Any, ...]] = {
    "population_size": (16, 40, 80, 160, 320),
    "sigma": (0.02, 0.05, 0.1, 0.2),
    "learning_rate": (0.005, 0.01, 0.02, 0.04, 0.08),
    "weight_decay": (0.0, 0.005),
    "controller_interval": (5, 10, 25),
    "hidden": ((), (32,), (64, 64)),
}
"""Values from which settings are drawn."""
FIRST: dict[str, tuple[Any, ...]] = {
    "point": (40, 0.1, 0.04, 0.005, 10, (32,)),
    "ant": (40, 0.02, 0.01, 0.005, 25, (64, 64)),
}
"""The settings of the paper's experiments here, by body."""
SHARED: dict[str, Any] = {
    "episodes_per_policy": 1,
    "statistics_fraction": 1.0,
    "reset_noise": 0.1,
    "horizon": 500,
    "evaluation_horizon": 500,
    "evaluation_episodes": 50,
    "noise_table_size": 25_000_000,
    "generations": 100_000,
    "num_workers": 1,
}
"""Settings over preset `paper`: its size, and what all methods here share."""


def settings(body: str, number: int = 24) -> list[dict[str, Any]]:
    """Return the first `number` settings, the same in every call."""
    drawn, draw = [FIRST[body]], np.random.default_rng(0)
    while len(drawn) < number:
        found = tuple(values[draw.integers(len(values))] for values in SEARCHED.values())
        drawn += [found] * (found not in drawn)
    return [dict(zip(SEARCHED, values, strict=True)) for values in drawn]


def row(place: tuple[int, int], body: str, steps: int, out: Path) -> dict[str, Any]:
    """Train what is left of a run of a setting and a seed, and return its row."""
    (number, seed), found = place, settings(body)[place[0]]
    interval = max(1, round(steps / (20 * found["population_size"] * SHARED["horizon"])))
    overrides = {**SHARED, **found, "seed": seed, "env_steps": steps, "evaluation_interval": interval}
    path = out / body / f"setting_{number}" / f"seed_{seed}"
    finish_run(make_config(f"{body}-gather", "paper", overrides), path)
    progress = read_csv(path / "progress.csv")
    scores = {
        f"{checkpoint}_score": shes.evaluate(path, episodes=200, checkpoint=checkpoint).summary()["score_mean"]
        for checkpoint in ("best", "last")
    }
    made = {name: int(progress[name][-1]) for name in ("generation", "env_steps")}
    made["seconds"] = round(progress["process_time_s"][-1])
    words = {**found, "hidden": " ".join(map(str, found["hidden"])) or "none"}
    print(f"{body}, setting {number}, seed {seed}: {scores}", flush=True)
    return {"body": body, "setting": number, **words, "seed": seed, **made, **scores}


def main() -> None:
    """Train what is left of the runs, then write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("body", choices=tuple(FIRST))
    parser.add_argument("--steps", type=int, default=3_000_000, help="environment steps of a run")
    parser.add_argument("--runs", type=int, default=2, help="runs at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/published"), help="folder of the runs")
    parser.add_argument("--results", type=Path, required=True, help="folder of the table")
    asked = parser.parse_args()
    places = [(number, seed) for seed in SEEDS for number in range(len(settings(asked.body)))]
    with ProcessPoolExecutor(asked.runs) as pool:
        rows = list(pool.map(partial(row, body=asked.body, steps=asked.steps, out=asked.out), places))
    asked.results.mkdir(parents=True, exist_ok=True)
    write_csv(asked.results / f"published_{asked.body}.csv", rows)


if __name__ == "__main__":
    main()
