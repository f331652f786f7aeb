"""Tasks over seeds: `python benchmarks/seeds.py gather --only frozen --results results/controllers`.

- `frozen`: a controller on a shipped walker (`shes train ant-gather --primitive ant-walker`).
- `coevolved`: both levels together from scratch (`shes train ant-gather`; with `--body point`, the point's twin).
- `without`: the same in Gather, for 60 generations, with everything and without one change at a time.

Every run can be interrupted at any time: the same command goes on, with several workers or runs at once. The
tables have rows for the best and the last checkpoint of each run over 200 fresh episodes of the task as specified, and
rows for the best of nine constant controllers and for random goals on the same primitive; on a shipped walker, which
all seeds share, these two once.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from run import write_csv

import shes
from shes.runs.make_config import make_config
from shes.runs.tables import read_csv
from shes.runs.train import finish_run

EPISODES = 200
"""Fresh episodes on which the best checkpoint of a run is evaluated."""
WAYS = ("frozen", "coevolved", "without")
CONTROLLERS = ("trained", "constant", "random")
WALKERS = {"gather": "ant-walker", "maze": "ant-walker", "push": "ant-walker-stiff", "fall": "ant-walker-stiff"}
"""The shipped walker of each task."""
FROZEN: dict[str, dict[str, Any]] = {
    "gather": {"generations": 75, "evaluation_interval": 15},
    "maze": {
        "learning_rate": 0.05,
        "learning_rate_end": 0.01,
        "schedule_generations": 40,
        "generations": 40,
        "evaluation_interval": 10,
    },
    "push": {
        "population_size": 120,
        "learning_rate": 0.03,
        "schedule_generations": 60,
        "generations": 60,
        "evaluation_interval": 20,
    },
    "fall": {"generations": 120, "evaluation_interval": 20},
}
"""Settings over the preset of a controller on a walker."""
LEFT_OUT: dict[str, dict[str, Any]] = {
    "everything": {},
    "no equivariant network": {"controller_network": "mlp", "controller_view": "observation", "hidden": (32,)},
    "no egocentric view": {"primitive_view": "proprioception", "symmetry": "none"},
    "no symmetry": {"symmetry": "none"},
    "no branches": {"primitive_estimate": "episode", "population_size": 240},
    "no zero output": {"output_weights": "glorot_normal"},
    "no clock": {"clock_frequency": None},
    "no price of falls": {"fall_price": 0.0},
    "no linear primitive": {"primitive_hidden": (64, 64)},
    "no short goals": {"controller_interval": 25},
}
"""Settings over the preset without one change. Whole episodes need more than 40 for a primitive."""
WITHOUT = {"env_steps": 3_350_000, "generations": 1000}
"""The budget of these runs: 60 generations of the preset."""


def settings_of(task: str, way: str, seed: int) -> dict[str, Any]:
    """Return the settings of a run over preset `laptop`."""
    if way in LEFT_OUT:
        return {"seed": seed, **WITHOUT, **LEFT_OUT[way]}
    own = {"primitive": WALKERS[task], "evaluation_episodes": 100, **FROZEN[task]} if way == "frozen" else {}
    return {"seed": seed, **own}


def results(way: str, seed: int, path: Path, controllers: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    """Return a row about each controller of a finished run's checkpoint, and one for each of its evaluations."""
    progress, table = read_csv(path / "progress.csv"), read_csv(path / "evaluation.csv")
    run = {
        "way": way,
        "seed": seed,
        "generations": int(progress["generation"][-1]),
        "env_steps": int(progress["env_steps"][-1]),
        "wall_time_s": round(progress["wall_time_s"][-1]),
    }
    rows = []
    for checkpoint, controller in [("last", "trained"), *(("best", each) for each in controllers)]:
        found = shes.evaluate(path, episodes=EPISODES, controller=controller, checkpoint=checkpoint)
        names = ("score_mean", "score_std", "success_rate", "return_mean", "episode_steps_mean")
        rows.append(
            {**run, "checkpoint": checkpoint, "controller": found.controller}
            | {name: found.summary()[name] for name in names}
        )
    names = ("generation", "env_steps", "wall_time_s", "score_mean", "score_std")
    curve = [
        {"way": way, "seed": seed, **dict(zip(names, values, strict=True))}
        for values in zip(*(table[name] for name in names), strict=True)
    ]
    return rows, curve


def main() -> None:
    """Train what is left of the runs asked for, then write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=tuple(WALKERS))
    parser.add_argument("--body", choices=("ant", "point"), default="ant", help="of the point: coevolved alone")
    parser.add_argument("--out", type=Path, help="folder of the runs; by default in runs")
    parser.add_argument("--only", nargs="+", choices=WAYS, default=WAYS[:2])
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(11, 21)), help="seeds (default: 11 to 20)")
    parser.add_argument("--workers", type=int, default=0, help="workers of a run; 0 is one for every core")
    parser.add_argument("--results", type=Path, help="folder of the tables")
    asked = parser.parse_args()
    if asked.body == "point" and "frozen" in asked.only:
        parser.error("no walker is shipped for the point: add --only coevolved")
    if "without" in asked.only and (asked.task, asked.body) != ("gather", "ant"):
        parser.error("`without` is for the ant in Gather")
    task = asked.task if asked.body == "ant" else f"{asked.body}_{asked.task}"
    out, rows, curves = asked.out or Path("runs") / task, list[Any](), list[Any]()
    ways = [name for way in asked.only for name in (LEFT_OUT if way == "without" else [way])]
    for way in ways:
        for seed in asked.seeds:
            path = out / way.replace(" ", "_") / f"seed_{seed}"
            settings = {**settings_of(asked.task, way, seed), "num_workers": asked.workers}
            finish_run(make_config(f"{asked.body}-{asked.task}", overrides=settings), path)
            if asked.results is not None:
                shares_primitive = way == "frozen" and seed != asked.seeds[0]
                found, curve = results(way, seed, path, CONTROLLERS[:1] if shares_primitive else CONTROLLERS)
                print(f"{way}, seed {seed}: score {found[1]['score_mean']:.2f}", flush=True)
                rows += found
                curves += curve
    if asked.results is not None:
        asked.results.mkdir(parents=True, exist_ok=True)
        name = f"{task}_{'_'.join(asked.only)}"
        write_csv(asked.results / f"{name}_runs.csv", rows)
        write_csv(asked.results / f"{name}_curves.csv", curves)


if __name__ == "__main__":
    main()
