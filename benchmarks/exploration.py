"""Ways to explore Ant Maze, Push and Fall, whose rewards lead into dead ends, on equal environment steps.

`python benchmarks/exploration.py --out results/learning/exploration.csv`: a controller on a shipped walker, with the
settings of preset `laptop` unless a row says otherwise, 20 generations of 200 policies (2 million steps). Its last
policy is evaluated on 100 fresh episodes of the task as specified: success rate, and metres of the way around the
obstacles that lie behind the ant at the end. Rows that the file has are not measured again. About 90 seconds of two
cores for each run.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from play import play
from run import write_csv

import shes

GENERATIONS = 20


@dataclass(frozen=True)
class Course:
    """A task, its walker, and the way around its obstacles."""

    primitive: str
    way: tuple[tuple[float, float], ...]
    """Corners of the way from the start to the target in metres."""
    waypoints: tuple[float, ...]
    curriculum: tuple[tuple[float, ...], ...]
    """Targets before the task's own."""
    height: tuple[float, ...] = ()
    """Height of the target, in Fall."""

    @property
    def target(self) -> tuple[float, ...]:
        """The task's own target."""
        return (*self.way[-1], *self.height)


COURSES = {
    "ant-maze": Course(
        primitive="ant-walker",
        way=((0, 0), (16, 0), (16, 16), (0, 16)),
        waypoints=(16, 0, 16, 16),
        curriculum=((16, 16), (8, 16)),
    ),
    "ant-push": Course(
        primitive="ant-walker-stiff",
        way=((0, 0), (-6, 4), (-5, 8), (0, 9), (0, 19)),
        waypoints=(-6, 4, -5, 9, -1, 11),
        curriculum=((-6, 4), (-5, 9), (-1, 11)),
    ),
    "ant-fall": Course(
        primitive="ant-walker-stiff",
        way=((0, 0), (8, 0), (8, 24), (0, 27)),
        waypoints=(8, 0, 4.75, 8, 12, 4.75, 8, 24, 4.75),
        curriculum=((8, 0, 4.75), (8, 12, 4.75), (8, 24, 4.75)),
        height=(4.5,),
    ),
}
LINEAR_IN_THE_WORLD = {
    "hidden": (),
    "controller_view": "observation",
    "controller_output": "vector",
    "controller_interval": 25,
}
"""The controller that the preset had first."""


def ways(course: Course) -> dict[str, tuple[dict[str, Any], ...]]:
    """Return the settings of each way over the preset's.

    Parts share the generations, and each continues with the controller of the one before.
    """
    random = {"target": None, "waypoints": None, "max_tilt": None}
    own = random | {"target": course.target}
    guided = own | {"waypoints": course.waypoints}
    return {
        "the task's target": (own,),
        "random targets": (random,),
        "random free targets": (random | {"target_sampling": "free_cells"},),
        "goals within 8 m": (own | {"goal_distance": 8.0},),
        "goals for 2.5 s": (own | {"controller_interval": 25},),
        "curriculum of targets": (*(random | {"target": target} for target in course.curriculum), own),
        "waypoints": (guided,),
        "waypoints, linear": (guided | {"hidden": ()},),
        "waypoints, view observation": (guided | {"controller_view": "observation"},),
        "waypoints, output vector": (guided | {"controller_output": "vector"},),
        "waypoints, goals for 2.5 s": (guided | {"controller_interval": 25},),
        "waypoints, none of these": (guided | LINEAR_IN_THE_WORLD,),
    }


def suits(env: str, way: str) -> bool:
    """Return whether `env` has this way: only Maze draws training's targets."""
    return env == "ant-maze" or not way.startswith("random")


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


def measure(env: str, way: str, seed: int, generations: int = GENERATIONS) -> dict[str, Any]:
    """Train and evaluate one run; return its row."""
    course = COURSES[env]
    parts = ways(course)[way]
    with TemporaryDirectory() as folder:
        start: Mapping[str, Any] = {}
        for number, part in enumerate(parts):
            share = generations * (number + 1) // len(parts) - generations * number // len(parts)
            settings = {"primitive": course.primitive, "evaluation_interval": 10_000, **part, **start}
            settings |= {"generations": share, "seed": seed}
            run = shes.train(env, out=Path(folder) / f"part-{number}", progress=False, **settings)
            start = {"controller": run.path, "controller_checkpoint": "last"}
        found = shes.evaluate(run.path, checkpoint="last", episodes=100).summary()
        behind = metres_behind(final_positions(run.path), course.way)
    return {
        "env": env,
        "way": way,
        "seed": seed,
        "env_steps": generations * 100_000,
        "success_rate": found["success_rate"],
        "metres_behind_mean": round(float(behind.mean()), 2),
        "metres_behind_max": round(float(behind.max()), 2),
    }


def main() -> None:
    """Measure the rows that the file lacks; write after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="CSV file to write or to continue")
    parser.add_argument("--envs", nargs="+", choices=list(COURSES), default=list(COURSES), help="tasks")
    parser.add_argument("--only", nargs="+", help="ways; all if none")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds")
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = list(csv.DictReader(asked.out.open())) if asked.out.exists() else []
    done = {(row["env"], row["way"], int(row["seed"])) for row in rows}
    for seed in range(1, 1 + asked.seeds):
        for env in asked.envs:
            for way in asked.only or ways(COURSES[env]):
                if suits(env, way) and (env, way, seed) not in done:
                    rows.append(measure(env, way, seed))
                    print(rows[-1], flush=True)
                    write_csv(asked.out, rows)


if __name__ == "__main__":
    main()
