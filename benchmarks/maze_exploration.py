"""Ways to explore Ant Maze, whose reward leads into a dead end, on equal environment steps.

`python benchmarks/maze_exploration.py --out results/learning/maze.csv`: a linear controller on the shipped
`ant-walker`, 20 generations of 200 policies. Its last policy is evaluated on 100 fresh episodes of the task as
specified: success rate, and metres of the way around the wall that lie behind the ant at the end (the target is at
48 m). Rows that the file has are not measured again. About two minutes of two cores for each run.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from run import write_csv

import shes
from shes.training.build import open_run

OWN = {"target": (0.0, 16.0)}
BASE: dict[str, Any] = {
    "primitive": "ant-walker",
    "hidden": (),
    "controller_view": "observation",
    "controller_output": "vector",
    "output_weights": "zero",
    "minimum_goal_distance": False,
    "population_size": 200,
    "sigma": 0.1,
    "learning_rate": 0.05,
    "weight_decay": 0.0,
    "horizon": 500,
    "evaluation_interval": 10_000,
}
GENERATIONS = 20
WAYS: dict[str, tuple[dict[str, Any], ...]] = {
    "the task's target": (OWN,),
    "random targets": ({},),
    "random free targets": ({"target_sampling": "free_cells"},),
    "novelty alone": (OWN | {"novelty": "ns"},),
    "half novelty": (OWN | {"novelty": "nsr"},),
    "adaptive novelty": (OWN | {"novelty": "nsra"},),
    "goals within 8 m": (OWN | {"goal_distance": 8.0},),
    "waypoints": (OWN | {"waypoints": (16.0, 0.0, 16.0, 16.0)},),
    "curriculum of targets": ({"target": (16.0, 16.0)}, {"target": (8.0, 16.0)}, OWN),
}
"""Settings over the base. Parts share the generations, and each continues with the controller of the one before."""


def metres_behind(position: np.ndarray) -> np.ndarray:
    """Return how far along the middle of the U-shaped corridor positions [N, 2] are, in metres."""
    x, y = position.T
    return np.where(y > 12, 48 - x, np.where(x > 12, 16 + y, x))


def final_positions(run: Path, episodes: int = 100) -> np.ndarray:
    """Return where the last policies of `run` are after an episode of evaluation [N, 2], in metres."""
    problem, agent = open_run(run, "last").algorithm.problem, shes.load(run, checkpoint="last", num_envs=episodes)
    task, robots = problem.env.make(episodes, problem.evaluation), np.arange(episodes)
    task.reset(robots, robots.tolist())
    for _ in range(500):
        task.step(robots, agent.control(task.observe(), task.position, task.heading))
    position = task.position.copy()
    task.close()
    return position


def measure(way: str, seed: int) -> dict[str, Any]:
    """Train and evaluate one run; return its row."""
    parts = WAYS[way]
    with TemporaryDirectory() as folder:
        start: dict[str, Any] = {}
        for number, part in enumerate(parts):
            generations = GENERATIONS * (number + 1) // len(parts) - GENERATIONS * number // len(parts)
            settings = {**BASE, **part, **start, "generations": generations, "seed": seed}
            run = shes.train("ant-maze", out=Path(folder) / f"part-{number}", progress=False, **settings)
            start = {"controller": run.path, "controller_checkpoint": "last"}
        found = shes.evaluate(run.path, checkpoint="last", episodes=100, num_workers=2).summary()
        behind = metres_behind(final_positions(run.path))
    return {
        "way": way,
        "seed": seed,
        "success_rate": found["success_rate"],
        "metres_behind_mean": round(float(behind.mean()), 2),
        "metres_behind_max": round(float(behind.max()), 2),
    }


def main() -> None:
    """Measure the rows that the file lacks; write after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="CSV file to write or to continue")
    parser.add_argument("--seeds", type=int, default=2, help="number of seeds")
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = list(csv.DictReader(asked.out.open())) if asked.out.exists() else []
    done = {(row["way"], int(row["seed"])) for row in rows}
    for seed in range(1, 1 + asked.seeds):
        for way in WAYS:
            if (way, seed) not in done:
                rows.append(measure(way, seed))
                print(rows[-1], flush=True)
                write_csv(asked.out, rows)


if __name__ == "__main__":
    main()
