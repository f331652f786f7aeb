"""Runs of HIRO and flat TD3, to compare with SHES: `python benchmarks/hiro_runs.py --out runs/hiro`.

Every run can be interrupted at any time: the same command goes on. A run ends after its environment steps or minutes,
whichever are first, or when it diverges; the minutes of earlier calls count. `--only td3-point-maze` makes some of the
groups. `--results FOLDER` also writes the tables of the runs in `--out`: `runs.csv` (best checkpoint of each run on
fresh episodes) and `curves.csv` (every evaluation); rows of other groups in them are kept. One process per run; two at
a time suit two cores: `taskset -c 0` before the command keeps one on its core, because JAX uses all that are idle.

The ants have the tasks and the settings of the HIRO authors, and 40 minutes of one core per run: two hours of two cores
in all. With more `--minutes` a run that has ended goes on. Gather has the Euler integrator, as have the runs of SHES
that it is compared with.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from run import write_csv

import shes
from shes.errors import DivergenceError
from shes.runs.folder import RunFolder
from shes.runs.make_config import make_config
from shes.runs.tables import read_csv
from shes.runs.train import finish_run

EPISODES = 50
"""Fresh episodes on which the best checkpoint of a run is evaluated."""


class Group(NamedTuple):
    """Runs that differ in their seeds."""

    env: str
    seeds: range
    settings: dict[str, Any]
    preset: str = "laptop"


_HIRO = {"algorithm": "hiro"}
GROUPS = {
    "td3-point-maze": Group("point-maze", range(1, 6), {"algorithm": "td3", "env_steps": 500_000}),
    "hiro-point-maze": Group("point-maze", range(1, 6), {**_HIRO, "env_steps": 500_000}),
    "hiro-point-push": Group("point-push", range(1, 6), {**_HIRO, "env_steps": 500_000}),
    "hiro-ant-gather": Group("ant-gather", range(1, 4), {"minutes": 40.0, "integrator": "euler"}, "hiro-paper"),
    "hiro-ant-maze": Group("ant-maze", range(1, 4), {"minutes": 40.0}, "hiro-paper"),
}


def train(group: Group, seed: int, path: Path, minutes: float | None) -> None:
    """Begin the run at `path`, or go on with it, unless it has ended; `minutes` replaces those of the group."""
    settings = {**group.settings, **({} if minutes is None else {"minutes": minutes})}
    config = make_config(group.env, group.preset, {**settings, "seed": seed, "num_workers": 1})
    try:
        finish_run(config, path)
    except DivergenceError as error:
        print(f"{path}: {error}", flush=True)  # up to there it counts


def results(name: str, seed: int, path: Path) -> tuple[dict[str, Any], Iterator[dict[str, Any]]]:
    """Return a row about the best checkpoint of a run, and a row for each of its evaluations."""
    found, last = shes.evaluate(path, episodes=EPISODES).summary(), read_csv(path / "progress.csv")
    keys = ("score_mean", "return_mean", "success_rate")
    row = {
        "group": name,
        "seed": seed,
        "env_steps": int(last["env_steps"][-1]),
        "wall_time_s": round(last["wall_time_s"][-1]),
        **{key: found[key] for key in keys},
    }
    table = read_csv(path / "evaluation.csv")
    names = ("env_steps", "wall_time_s", *keys)
    rows = zip(*(table[key] for key in names), strict=True)
    return row, ({"group": name, "seed": seed, **dict(zip(names, values, strict=True))} for values in rows)


def main() -> None:
    """Train what is left of the runs asked for, then write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/hiro"), help="folder of the runs")
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=list(GROUPS), help="groups of runs")
    parser.add_argument("--seeds", nargs="+", type=int, help="seeds, of those of the group")
    parser.add_argument("--minutes", type=float, help="minutes of each run, instead of those of its group")
    parser.add_argument("--results", type=Path, help="folder of the tables")
    asked = parser.parse_args()
    places = {(name, seed): asked.out / name / f"seed_{seed}" for name, group in GROUPS.items() for seed in group.seeds}
    for name in asked.only:
        for seed in asked.seeds or GROUPS[name].seeds:
            train(GROUPS[name], seed, places[name, seed], asked.minutes)
            print(f"{name}, seed {seed}: ended", flush=True)
    if asked.results is not None:
        asked.results.mkdir(parents=True, exist_ok=True)
        of_asked = {place: path for place, path in places.items() if place[0] in asked.only}
        rows = [results(*place, path) for place, path in of_asked.items() if RunFolder(path).evaluation.is_file()]
        write_groups(asked.results / "runs.csv", [row for row, _ in rows])
        write_groups(asked.results / "curves.csv", [row for _, curve in rows for row in curve])


def write_groups(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write the rows of some groups to the table at `path`; rows of other groups in it are kept."""
    made = {row["group"] for row in rows}
    if path.is_file():
        with path.open(newline="", encoding="utf-8") as lines:
            rows = [*(row for row in csv.DictReader(lines) if row["group"] not in made), *rows]
    order = [*GROUPS, *(row["group"] for row in rows)]  # a table may have groups of an earlier version
    write_csv(path, sorted(rows, key=lambda row: order.index(row["group"])))


if __name__ == "__main__":
    main()
