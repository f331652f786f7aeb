"""How far the ants of Figure 5 come on their way around the obstacles of Maze and Push.

`python benchmarks/metres_behind.py --study runs/paper --out results/paper/metres_behind.csv`: the last policies of
every run of `shes experiment fig5` on Ant Maze and Ant Push whose folder is there, on 100 fresh episodes: metres of
the way that lie behind the ant at the end, of `way_m` to the target. Rows that the file has are kept.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import Any

import numpy as np
from play import play
from run import write_csv

from shes.studies.paper import figure_5
from shes.studies.study_tables import Cell

_PLACE = ("env", "group", "variant", "seed")
WAYS = {
    "ant-maze": ((0, 0), (16, 0), (16, 16), (0, 16)),
    "ant-push": ((0, 0), (-6, 4), (-5, 8), (0, 9), (0, 19)),
}
"""Corners of the way from the start to the target in metres, by task."""


def metres_behind(position: np.ndarray, corners: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Return how far along the way through `corners` [C, 2] its points nearest to positions [N, 2] are, in metres."""
    starts, ends = np.array(corners[:-1], dtype=float), np.array(corners[1:], dtype=float)
    legs = ends - starts
    lengths = np.linalg.norm(legs, axis=1)
    share = ((position[:, None] - starts) * legs).sum(axis=2) / lengths**2  # [N, C - 1]
    share = share.clip(0, 1)
    nearest = np.linalg.norm(position[:, None] - (starts + share[..., None] * legs), axis=2).argmin(axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)[:-1]]) + share * lengths
    return along[np.arange(len(position)), nearest]


def final_positions(run: Path, episodes: int = 100) -> np.ndarray:
    """Return where the last policies of `run` are after an episode of evaluation [N, 2], in metres."""
    return [task.position.copy() for task in play(run, "last", episodes)][-1]


def measure(cell: Cell, run: Path) -> dict[str, Any]:
    """Return the row of the run of `cell` in the folder `run`."""
    way = WAYS[cell.env]
    behind = metres_behind(final_positions(run), way)
    return {
        **{name: getattr(cell, name) for name in _PLACE},
        "way_m": round(float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()), 1),
        "metres_behind_mean": round(float(behind.mean()), 2),
        "metres_behind_max": round(float(behind.max()), 2),
    }


def main() -> None:
    """Measure the runs that the file lacks, and write it after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", type=Path, required=True, help="folder of the study")
    parser.add_argument("--out", type=Path, required=True, help="CSV file to write or to continue")
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = list(csv.DictReader(asked.out.open())) if asked.out.exists() else []
    done = {tuple(str(row[name]) for name in _PLACE) for row in rows}
    for cell in figure_5().cells:
        run = asked.study / cell.name
        is_new = tuple(str(getattr(cell, name)) for name in _PLACE) not in done
        if cell.env in WAYS and is_new and (run / "summary.json").is_file():
            rows.append(measure(cell, run))
            print(rows[-1], flush=True)
            write_csv(asked.out, rows)


if __name__ == "__main__":
    main()
