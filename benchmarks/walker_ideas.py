"""Ideas for a better walker that are not options of the package, or that combine what the learning study varies alone.

`python benchmarks/walker_ideas.py --out results/learning/ideas.csv`: Ant Flagrun on the base of `shes experiment
learning` (660,000 environment steps, the last policy over 50 fresh episodes), five seeds; also the speed towards a goal
8 m ahead. Rows that the file has are not measured again. About a minute of two cores for each run.

- `smoothed controls`: motors with a first-order lag of 50 ms, which MuJoCo integrates.
- `64 x 64, low-rank`: the perturbation of a weight matrix is the outer product of two noise vectors, in rollout and
  gradient (Sarkar et al. 2025, Evolution Strategies at the Hyperscale).
"""

from __future__ import annotations

import argparse
import csv
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import mujoco
import numpy as np
from run import write_csv

import shes
from shes.envs.bodies.ant import Ant
from shes.envs.tasks.flagrun import Flagrun
from shes.es import level
from shes.es.noise import NoiseTable
from shes.studies.learning import learning
from shes.training.build import open_run

ENV_STEPS = 660_000
SEEDS = range(1, 6)
LAG_S = 0.05
BASE = next(cell.settings for cell in learning("laptop", 1).cells if cell.variant == "base")
SHORT = {"intervals": 1}
IDEAS: dict[str, dict[str, Any]] = {
    "base": {},
    "one interval": SHORT,
    "one interval, learning rate 0.04": SHORT | {"learning_rate": 0.04},
    "one interval, clock 1.2 Hz": SHORT | {"clock_frequency": 1.2},
    "one interval, metres, clock 1.2 Hz": SHORT | {"primitive_reward": "metres", "clock_frequency": 1.2},
    "smoothed controls": {},
    "64 x 64, low-rank": {"hidden": (64, 64)},
}


class SmoothAnt(Ant):
    """The ant, whose torques follow its controls with a lag."""

    name: ClassVar[str] = "smooth-ant"

    def add_to(self, spec: mujoco.MjSpec, ground_m: float = 0.0) -> None:
        """Add the ant with motors that lag."""
        super().add_to(spec, ground_m)
        for motor in spec.actuators:
            motor.dyntype = mujoco.mjtDyn.mjDYN_FILTEREXACT
            motor.dynprm[0] = LAG_S


def low_rank_noise(values: np.ndarray, index: int, sizes: tuple[int, ...]) -> np.ndarray:
    """Return the noise [D] of a network with layers of `sizes`: of unit variance, with matrices of rank one."""
    parts = []
    for fan_in, fan_out in pairwise(sizes):
        stop = index + fan_in + 2 * fan_out
        left, right, bias = np.split(values[index:stop], [fan_in, fan_in + fan_out])
        parts += [np.outer(left, right).ravel(), bias]
        index = stop
    return np.concatenate(parts)


def perturb_in_low_rank(sizes: tuple[int, ...]) -> None:
    """Replace the package's noise vectors by those of `low_rank_noise`, in this process and for good."""

    def weighted_sum(table: Any, noise_index: Any, weights: Any, dim: int, pool: Any = None) -> np.ndarray:  # noqa: ARG001
        total = np.zeros(dim, np.float32)
        for group in np.flatnonzero(weights):
            total += weights[group] * low_rank_noise(table.values, int(noise_index[group]), sizes)
        return total

    NoiseTable.slice = lambda table, index, _: low_rank_noise(table.values, index, sizes)
    level.weighted_noise_sum = weighted_sum


def speed_ahead(run: Path, num_robots: int = 64, steps: int = 150, skipped: int = 30) -> float:
    """Return the mean speed in m/s towards goals 8 m ahead, after `skipped` steps, of robots that have not fallen."""
    problem, agent = open_run(run, "last").algorithm.problem, shes.load(run, checkpoint="last", num_envs=num_robots)
    task = problem.env.make(num_robots, problem.evaluation)
    robots = np.arange(num_robots)
    task.reset(robots, robots.tolist())
    angle = np.random.default_rng(0).uniform(-np.pi, np.pi, num_robots)
    ahead = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    walks, speeds = np.ones(num_robots, bool), []
    for step in range(steps):
        before = task.position.copy()
        task.step(robots, agent.control(task.observe(), before, task.heading, before + 8 * ahead))
        walks &= ~task.terminated & (np.abs(task.position).max(axis=1) < 11)  # the field ends at 12 m
        if step >= skipped:
            speeds.append(10 * ((task.position - before) * ahead).sum(axis=1)[walks])
    task.close()
    return float(np.concatenate(speeds).mean())


def measure(idea: str, seed: int, env_steps: int) -> dict[str, Any]:
    """Train and evaluate one run; return its row."""
    settings = {**BASE, **IDEAS[idea], "env_steps": env_steps, "evaluation_interval": 10_000}
    env = "smooth-ant-flagrun" if idea == "smoothed controls" else "ant-flagrun"
    if "low-rank" in idea:
        settings["backend"] = "serial"  # the replaced noise is that of this process
    with TemporaryDirectory() as folder:
        run = shes.train(env, preset="smoke", out=Path(folder) / "run", seed=seed, **settings)
        found = shes.evaluate(run.path, checkpoint="last", episodes=50, num_workers=2).summary()
        ahead = speed_ahead(run.path)
    return {
        "idea": idea,
        "seed": seed,
        "return_mean": round(found["return_mean"], 2),
        "episode_steps_mean": round(found["episode_steps_mean"], 1),
        "speed_ahead_m_s": round(ahead, 3),
    }


def main() -> None:
    """Measure the rows that the file lacks; write after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="CSV file to write or to continue")
    parser.add_argument("--only", nargs="*", choices=list(IDEAS), default=list(IDEAS), help="ideas to measure")
    parser.add_argument("--env-steps", type=int, default=ENV_STEPS, help="environment steps of training")
    asked = parser.parse_args()
    shes.register_environment("smooth-ant-flagrun", SmoothAnt, Flagrun)
    rows: list[dict[str, Any]] = list(csv.DictReader(asked.out.open())) if asked.out.exists() else []
    done = {(row["idea"], int(row["seed"])) for row in rows}
    for idea in sorted(asked.only, key=lambda name: "low-rank" in name):  # last: it replaces the package's noise
        if "low-rank" in idea:
            perturb_in_low_rank((30, *IDEAS[idea]["hidden"], 8))
        for seed in SEEDS:
            if (idea, seed) not in done:
                rows.append(measure(idea, seed, asked.env_steps))
                print(rows[-1], flush=True)
                write_csv(asked.out, rows)


if __name__ == "__main__":
    main()
