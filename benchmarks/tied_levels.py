"""The effect of an update on a controller whose members all tie.

`python benchmarks/tied_levels.py --out results/learning/tied.csv`: Ant Gather with episodes of 15 steps, in which
nobody can collect anything, so that all members of the controller are worth the same. Thirty generations, five seeds,
four ways to treat the weight decay. A minute on one core.
"""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import shes
from shes.runs.tables import read_csv

CASES: dict[str, dict[str, Any]] = {
    "decay in the gradient (as published)": {"hold_tied": False},
    "decoupled decay (AdamW)": {"hold_tied": False, "weight_decay_form": "decoupled"},
    "no decay": {"hold_tied": False, "weight_decay": 0.0},
    "held": {"hold_tied": True},
}
SETTINGS: dict[str, Any] = {
    "population_size": 16,
    "horizon": 15,
    "hidden": (32,),
    "generations": 30,
    "learning_rate": 0.01,
    "weight_decay": 0.005,
    "evaluation_interval": 30,
    "evaluation_episodes": 1,
    "backend": "serial",
}
SEEDS = range(1, 6)


def measure(name: str, seed: int) -> dict[str, Any]:
    """Return a row: the controller's length after one generation and after all, and the share of tied members."""
    with TemporaryDirectory() as folder:
        run = shes.train("ant-gather", preset="smoke", out=Path(folder) / "run", seed=seed, **SETTINGS | CASES[name])
        table = read_csv(run.path / "progress.csv")
    lengths = table["controller_theta_norm"]
    return {
        "case": name,
        "seed": seed,
        "theta_norm_first": round(lengths[0], 4),
        "theta_norm_last": round(lengths[-1], 4),
        "tied": min(table["controller_rank_ties"]),
    }


def main() -> int:
    """Measure every case, print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="CSV file to write")
    out = parser.parse_args().out
    rows = [measure(name, seed) for name in CASES for seed in SEEDS]
    writer = csv.DictWriter(sys.stdout, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    if out is not None:
        with out.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
