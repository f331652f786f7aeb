"""Choices of walkers and gatherers, one changed at a time: `python benchmarks/choices.py --out FILE.csv`.

- `walker`: `shes train ant-flagrun`, 0.9 million environment steps.
- `transfer`: a controller in Gather on the shipped `ant-walker`, 1.3 million (1.2 and the rest of the last generation).
- `coevolved`: both levels in Gather from scratch, 2 million.

Five seeds of each choice over preset `laptop`; the last policies are evaluated on 100 fresh episodes of the task as
specified. Rows that the file has are not measured again. On two cores about a minute for each run.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from run import write_csv

import shes

EPISODES = 100
SEEDS = range(1, 6)
WAYS: dict[str, tuple[str, dict[str, Any]]] = {
    "walker": ("ant-flagrun", {"env_steps": 890_000}),
    "transfer": ("ant-gather", {"env_steps": 1_200_000, "primitive": "ant-walker"}),
    "coevolved": ("ant-gather", {"env_steps": 2_000_000}),
}
"""Environment and settings over the preset by way."""
PLAIN = {"controller_network": "mlp", "hidden": (32,), "primitive_hidden": (64, 64)}
CHOICES: dict[str, dict[str, dict[str, Any]]] = {
    "walker": {
        "preset": {},
        "600 policies": {"population_size": 600},
        "fall price 2": {"fall_price": 2.0},
        "max tilt 45": {"max_tilt": 45.0},
    },
    "transfer": {
        "preset": {},
        "a plain network of the same inputs": {"controller_network": "mlp", "hidden": (32,)},
        "egocentric": {**PLAIN, "controller_view": "egocentric"},
        "observation, vector": {**PLAIN, "controller_view": "observation", "controller_output": "vector"},
        "goals for 2.5 s": {"controller_interval": 25},
    },
    "coevolved": {
        "preset": {},
        # Both levels then share population, sigma and learning rate: those of whole episodes in the learning study.
        "whole episodes": {"primitive_estimate": "episode", "sigma": 0.05, "learning_rate": 0.02},
        "one interval": {"intervals": 1},
        "egocentric": {**PLAIN, "controller_view": "egocentric"},
    },
}
"""Settings over those of the way; `preset` is the base of each."""


def measure(way: str, choice: str, seed: int) -> dict[str, Any]:
    """Train and evaluate one run; return its row."""
    env, settings = WAYS[way]
    lasting = {"seed": seed, "generations": 100_000, "evaluation_interval": 100_000, "progress": False}
    with TemporaryDirectory() as folder:
        run = shes.train(env, out=Path(folder) / "run", **settings, **CHOICES[way][choice], **lasting)
        found = shes.evaluate(run.path, checkpoint="last", episodes=EPISODES).summary()
        env_steps = int(run.progress["env_steps"][-1])
    keys = ("score_mean", "score_std", "episode_steps_mean")
    return {"way": way, "choice": choice, "seed": seed, "env_steps": env_steps, **{key: found[key] for key in keys}}


def main() -> None:
    """Measure the rows that the file lacks; write after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="CSV file to write or to continue")
    parser.add_argument("--only", nargs="+", choices=list(WAYS), default=list(WAYS), help="ways to measure")
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = list(csv.DictReader(asked.out.read_text().splitlines())) if asked.out.exists() else []
    done = {(row["way"], row["choice"], int(row["seed"])) for row in rows}
    for seed in SEEDS:
        for way in asked.only:
            for choice in CHOICES[way]:
                if (way, choice, seed) not in done:
                    rows.append(measure(way, choice, seed))
                    print(rows[-1], flush=True)
                    write_csv(asked.out, rows)


if __name__ == "__main__":
    main()
