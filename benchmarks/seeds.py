"""Tasks of the ant from nothing, over seeds and ways: `python benchmarks/seeds.py gather --out runs/gather`.

- `transfer`: a walker (`shes train ant-flagrun`, for Push and Fall with `--stiff-contacts`, with the specification and
  the integrator of the task), then a controller on it (`shes train ant-gather --primitive WALKER`;
  other tasks: `--generations 60`).
- `coevolved`: both levels together (`shes train ant-gather`).

Every run can be interrupted at any time: the same command goes on. `--results FOLDER` also writes the tables:
`gather_runs.csv` (best checkpoint of each run over 200 fresh episodes of the task as specified; environment steps and
wall-clock include the walker's) and `gather_curves.csv` (every evaluation). In Gather about five minutes of two cores
for each seed and way, in the others up to half an hour.

`--spec hiro` trains and evaluates on the tasks of the HIRO authors; the tables are then `gather_hiro_runs.csv` and
`gather_hiro_curves.csv`. Their integrator is RK4, unless `--integrator euler` is given.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from run import write_csv

import shes
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv, read_wall_time
from shes.training.make_config import make_config
from shes.training.train import finish_run

EPISODES = 200
"""Fresh episodes on which the best checkpoint of a run is evaluated."""
WAYS = ("transfer", "coevolved")
WALKERS = {"gather": {}, "maze": {}, "push": {"stiff_contacts": True}, "fall": {"stiff_contacts": True}}
"""Settings of the walker, by task."""


def finished(env: str, path: Path, **settings: Any) -> Path:
    """Return the folder of a run that has ended: begun, or gone on with, unless it has."""
    finish_run(make_config(env, overrides=settings), path)
    return path


def runs(task: str, settings: dict[str, Any], way: str, seed: int, out: Path) -> list[Path]:
    """Return the runs of a seed, which are finished first; that of the task, which has `settings`, is last."""
    env, path, settings = f"ant-{task}", out / way / f"seed_{seed}", {**settings, "seed": seed}
    if way == "coevolved":
        return [finished(env, path, **settings)]
    walker = finished("ant-flagrun", out / "walker" / f"seed_{seed}", **settings, **WALKERS[task])
    if task != "gather":
        settings["generations"] = 60
    return [walker, finished(env, path, **settings, primitive=walker)]


def results(way: str, seed: int, paths: list[Path]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return a row about the best checkpoint of a seed, and a row for each evaluation of its last run."""
    found = shes.evaluate(paths[-1], episodes=EPISODES)
    tables = [read_csv(path / "progress.csv") for path in paths]
    before_steps = sum(int(table["env_steps"][-1]) for table in tables[:-1])
    before_s = sum(read_wall_time(RunFolder(path).progress) for path in paths[:-1])
    summary = found.summary()
    row = {
        "way": way,
        "seed": seed,
        "generations": int(tables[-1]["generation"][-1]),
        "env_steps": before_steps + int(tables[-1]["env_steps"][-1]),
        "wall_time_s": round(before_s + read_wall_time(RunFolder(paths[-1]).progress)),
        **{
            name: summary[name]
            for name in ("score_mean", "score_std", "success_rate", "return_mean", "episode_steps_mean")
        },
    }
    table = read_csv(paths[-1] / "evaluation.csv")
    names = ("generation", "env_steps", "wall_time_s", "score_mean", "score_std")
    curve = []
    for values in zip(*(table[name] for name in names), strict=True):
        point = dict(zip(names, values, strict=True))
        point["generation"] = int(point["generation"])
        point["env_steps"] = before_steps + int(point["env_steps"])
        point["wall_time_s"] = round(before_s + point["wall_time_s"], 1)
        curve.append({"way": way, "seed": seed, **point})
    return row, curve


def main() -> None:
    """Train what is left of the runs asked for, then write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=tuple(WALKERS))
    parser.add_argument("--spec", choices=("shes", "hiro"), default="shes", help="specification of the task")
    parser.add_argument("--integrator", choices=("euler", "implicitfast", "rk4"), help="instead of the task's own")
    parser.add_argument("--out", type=Path, help="folder of the runs; by default runs/TASK, or runs/TASK_hiro")
    parser.add_argument("--only", nargs="+", choices=WAYS, default=list(WAYS), help="ways to train")
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(1, 6)), help="seeds")
    parser.add_argument("--results", type=Path, help="folder of the tables")
    asked = parser.parse_args()
    name = asked.task if asked.spec == "shes" else f"{asked.task}_{asked.spec}"
    out = asked.out or Path("runs") / name
    settings = {"spec": asked.spec} | ({"integrator": asked.integrator} if asked.integrator else {})
    rows, curves = [], []
    for way in asked.only:
        for seed in asked.seeds:
            row, curve = results(way, seed, runs(asked.task, settings, way, seed, out))
            print(f"{way}, seed {seed}: score {row['score_mean']:.2f} after {row['wall_time_s']} s", flush=True)
            rows.append(row)
            curves += curve
    if asked.results is not None:
        asked.results.mkdir(parents=True, exist_ok=True)
        write_csv(asked.results / f"{name}_runs.csv", rows)
        write_csv(asked.results / f"{name}_curves.csv", curves)


if __name__ == "__main__":
    main()
