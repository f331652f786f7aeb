"""Measure how Gather agents spend an episode: what they collect and how often they sense food, every ten seconds.

`python benchmarks/foraging.py RUN… --out FILE` plays the best checkpoint of runs or shipped agents of Gather on 200
fresh episodes of 500 steps of the task as specified. An episode that has ended counts as one that collects and senses
nothing. About ten seconds of two cores for each run.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from play import play
from run import write_csv

EPISODES = 200
STEPS = 500
WINDOW = 100
"""Steps of a row: ten seconds."""


def foraging(run: str, label: str) -> list[dict[str, Any]]:
    """Return a row for every ten seconds of the episodes of `run`."""
    runs_on = np.ones(EPISODES, bool)
    collected, senses, radius = np.zeros((STEPS + 1, 2, EPISODES)), np.zeros((STEPS, EPISODES), bool), []
    for step, task in enumerate(play(run, "best", EPISODES, STEPS)):
        now = np.stack([task.food, task.poison])
        collected[step + 1] = np.where(runs_on, now, collected[step])
        senses[step] = runs_on & (task.observe()[:, task.sensor_rings[0]].max(axis=1) > 0)
        radius.append(np.hypot(*task.position.T))
        runs_on &= ~task.terminated
    rows = []
    for start in range(0, STEPS, WINDOW):
        end = start + WINDOW
        food, poison = (collected[end] - collected[start]).mean(axis=1)
        rows.append({
            "agent": label,
            "episodes": EPISODES,
            "from_s": start // 10,
            "to_s": end // 10,
            "food": round(float(food), 3),
            "poison": round(float(poison), 3),
            "senses_food": round(float(senses[start:end].mean()), 3),
            "metres_from_origin": round(float(np.median(radius[end - 1])), 2),
        })  # fmt: skip
    return rows


def main() -> None:
    """Measure the runs and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", help="runs or shipped agents of Gather")
    parser.add_argument("--labels", nargs="+", help="their names in the table")
    parser.add_argument("--out", type=Path, required=True, help="CSV file to write")
    asked = parser.parse_args()
    rows = []
    for run, label in zip(asked.runs, asked.labels or asked.runs, strict=True):
        rows += foraging(run, label)
        for row in rows[-STEPS // WINDOW :]:
            print(row, flush=True)
    write_csv(asked.out, rows)


if __name__ == "__main__":
    main()
