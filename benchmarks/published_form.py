"""The ant as published at scale laptop, with other populations, σ and learning rates, in Gather.

`python benchmarks/published_form.py --out FILE.csv` trains each for two million environment steps and writes every
evaluation, of 20 episodes of the task as specified. On two cores a quarter of an hour.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory

from run import write_csv

import shes
from shes.studies.paper_scales import PUBLISHED, SCALES

HORIZON, BETWEEN_EVALUATIONS = 500, 200_000
SETTINGS = (
    *((200, 0.02, 0.01, 1), (40, 0.02, 0.005, 1), (40, 0.02, 0.01, 1), (40, 0.02, 0.01, 2), (40, 0.02, 0.02, 1)),
    *((40, 0.04, 0.02, 1), (40, 0.07, 0.02, 1), (40, 0.07, 0.05, 1)),
)
"""Population, σ, learning rate and seed; the third is that of the experiments."""
MEASURES = ("primitive_return_mean", "goals_reached_mean", "score_mean")


def main() -> None:
    """Train, and write the evaluations of all runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="CSV file of the evaluations")
    out = parser.parse_args().out
    rows: list[dict[str, object]] = []
    for population, sigma, learning_rate, seed in SETTINGS:
        own = {"population_size": population, "sigma": sigma, "learning_rate": learning_rate, "seed": seed}
        settings = {
            **SCALES["laptop"].form("ant", "gather", PUBLISHED),
            **own,
            "horizon": HORIZON,
            "evaluation_horizon": HORIZON,
            "evaluation_episodes": 20,
            "evaluation_interval": BETWEEN_EVALUATIONS // (population * HORIZON),
            "env_steps": 2_000_000,
            "generations": 100_000,
        }
        with TemporaryDirectory() as folder:
            run = shes.train("ant-gather", preset="paper", out=Path(folder) / "run", **settings)
            table = run.evaluations
            columns = [table[name].tolist() for name in ("env_steps", *MEASURES)]
        rows += [
            {**own, "env_steps": int(steps), **dict(zip(MEASURES, (round(value, 2) for value in values), strict=True))}
            for steps, *values in zip(*columns, strict=True)
        ]
        print(own, rows[-1]["score_mean"], flush=True)
    write_csv(out, rows)


if __name__ == "__main__":
    main()
