"""The effect of the weight decay on a controller whose members all tie.

`python benchmarks/tied_levels.py --out results/learning/tied.csv`: Ant Gather with episodes of 15 steps, in which
nothing can be collected. Thirty generations, five seeds, four treatments of the weight decay; a minute on one core.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from run import write_csv

import shes
from shes.runs.tables import read_csv

CASES: dict[str, dict[str, Any]] = {
    "ranked by index (as published)": {"rank_ties": "index"},
    "ranked by index, no decay": {"rank_ties": "index", "weight_decay": 0.0},
    "held": {"rank_ties": "average"},
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
    """Return the controller's parameter norm after the first and the last generation, and the fraction of ties."""
    with TemporaryDirectory() as folder:
        run = shes.train("ant-gather", preset="smoke", out=Path(folder) / "run", seed=seed, **SETTINGS | CASES[name])
        table = read_csv(run.path / "progress.csv")
    norms = table["controller_theta_norm"]
    return {
        "case": name,
        "seed": seed,
        "theta_norm_first": round(norms[0], 4),
        "theta_norm_last": round(norms[-1], 4),
        "tied": min(table["controller_rank_ties"]),
    }


def main() -> None:
    """Measure every case, print the rows and write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="CSV file to write")
    out = parser.parse_args().out
    rows = []
    for name in CASES:
        for seed in SEEDS:
            rows.append(measure(name, seed))
            print(rows[-1], flush=True)
    if out is not None:
        write_csv(out, rows)


if __name__ == "__main__":
    main()
