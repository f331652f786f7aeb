"""Ideas for a better walker that are not options of the package, or that combine what the learning study varies alone.

`python benchmarks/walker_ideas.py --out results/learning/ideas.csv`: Ant Flagrun on the base of `shes experiment
learning` (660,000 environment steps, the last policy over 50 fresh episodes), five seeds; also the speed towards a goal
8 m ahead. Rows that the file has are not measured again. About a minute of two cores for each run.

- `smoothed controls`: motors with a first-order lag of 50 ms, which MuJoCo integrates.
- `64 x 64, low-rank`: the perturbation of a weight matrix is the outer product of two noise vectors, in rollout and
  gradient (Sarkar et al. 2025, Evolution Strategies at the Hyperscale).
- `one interval, terminal values`: the fitness of a branch is its return plus an estimate of the next
  interval's return, from the state at its end by ridge regression on the egocentric view and its products; 0 after a
  fall.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import mujoco
import numpy as np
from play import play
from run import write_csv

import shes
from shes.algorithms.evolution import populations
from shes.envs.bodies.ant import Ant
from shes.envs.tasks.flagrun import Flagrun
from shes.es import level
from shes.es.noise import NoiseTable
from shes.studies.walker_study import learning

ENV_STEPS = 660_000
SEEDS = range(1, 6)
LAG_S = 0.05
BASE = next(cell.settings for cell in learning("laptop", 1).cells if cell.variant == "base")
SHORT = {"intervals": 1}
IDEAS: dict[str, dict[str, Any]] = {
    "one interval, learning rate 0.04": SHORT | {"learning_rate": 0.04},
    "one interval, metres, clock 1.2 Hz": SHORT | {"primitive_reward": "metres", "clock_frequency": 1.2},
    "smoothed controls": {},
    "one interval, terminal values": SHORT,
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


class TerminalValues:
    """Value of the state at the end of a branch: the expected return of the next interval, by ridge regression."""

    forgetting = 0.8
    """Weight of the earlier generations' data, for each generation."""

    def __init__(self) -> None:
        """Start without data: all values are zero."""
        self._body = Ant()
        self._view_size = len(self._body.egocentric)
        self._scale: np.ndarray | None = None
        self._pairs = np.triu_indices(self._view_size)
        size = 1 + self._view_size + len(self._pairs[0])
        self._gram, self._cross = np.zeros((size, size)), np.zeros(size)

    def features(self, states: np.ndarray) -> np.ndarray:
        """Return 1, the egocentric view and its products [N, F] of physics `states` [N, S]."""
        body, view = self._body, np.zeros((len(states), self._view_size))
        qpos, qvel = np.split(states[:, 1 : 1 + body.num_qpos + body.num_qvel], [body.num_qpos], axis=1)
        body.write_egocentric(qpos, qvel, body.frame_angle(qpos), view)
        self._scale = view.std(axis=0) + 1e-3 if self._scale is None else self._scale
        view = np.clip(view / self._scale, -5, 5)
        left, right = self._pairs
        return np.concatenate([np.ones((len(states), 1)), view, view[:, left] * view[:, right]], axis=1)

    def learn(self, states: np.ndarray, returns: np.ndarray) -> None:
        """Add the `returns` [N] of intervals that started from `states` [N, S]."""
        features = self.features(states)
        self._gram = self.forgetting * self._gram + features.T @ features
        self._cross = self.forgetting * self._cross + features.T @ returns

    def __call__(self, states: np.ndarray) -> np.ndarray:
        """Return the values [N] of `states` [N, S]."""
        weights = np.linalg.solve(self._gram + 10 * np.eye(len(self._gram)), self._cross)
        return self.features(states) @ weights


@contextmanager
def terminal_values() -> Iterator[None]:
    """Add values to the returns of branches while the context lasts. The ends of both branches of a pair are needed.

    A rollout keeps one of them, so each pair runs a second time, which keeps the other; its steps are not counted.
    """
    original, values = populations._roll_out_pairs, TerminalValues()

    def roll_out(state: Any, estimate: Any, work: Any, backend: Any) -> Any:
        swapped = replace(work, tasks=[replace(task, kept_slot=1 - task.kept_slot) for task in work.tasks])
        twin = original(state, estimate, swapped, backend)
        population = original(state, estimate, work, backend)
        returns = population.results.outcomes["returns"][:, 0, 0]  # a view [n]
        starts = [task for task in work.tasks if task.start is not None]
        if starts:
            pairs = np.array([returns[task.member : task.member + 2].mean() for task in starts])
            values.learn(np.stack([task.start.state for task in starts]), pairs)
        ends = population.results.snapshots | twin.results.snapshots  # of branches that did not fall
        members, states = np.array([member for member, _ in ends]), np.stack([end.state for end in ends.values()])
        returns[members] += values(states)
        return population

    populations._roll_out_pairs = roll_out
    try:
        yield
    finally:
        populations._roll_out_pairs = original


def speed_ahead(run: Path | str, checkpoint: str, num_robots: int = 64, steps: int = 150, skipped: int = 30) -> float:
    """Return the mean speed in m/s towards goals 8 m ahead, after `skipped` steps, of robots that have not fallen."""
    angle = np.random.default_rng(0).uniform(-np.pi, np.pi, num_robots)
    ahead = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    walks, speeds = np.ones(num_robots, bool), []
    before = np.zeros((num_robots, 2))
    for step, task in enumerate(play(run, checkpoint, num_robots, steps, lambda task: task.position + 8 * ahead)):
        walks &= ~task.terminated & (np.abs(task.position).max(axis=1) < 11)  # the field ends at 12 m
        if step >= skipped:
            speeds.append(10 * ((task.position - before) * ahead).sum(axis=1)[walks])
        before = task.position.copy()
    return float(np.concatenate(speeds).mean())


def measure(idea: str, seed: int, env_steps: int) -> dict[str, Any]:
    """Train and evaluate one run; return its row."""
    settings = {**BASE, **IDEAS[idea], "env_steps": env_steps, "evaluation_interval": 10_000}
    env = "smooth-ant-flagrun" if idea == "smoothed controls" else "ant-flagrun"
    if "low-rank" in idea:
        settings["backend"] = "serial"  # the replaced noise is that of this process
    with TemporaryDirectory() as folder, terminal_values() if "terminal values" in idea else nullcontext():
        run = shes.train(env, preset="smoke", out=Path(folder) / "run", seed=seed, **settings)
        found = shes.evaluate(run.path, checkpoint="last", episodes=50, num_workers=2).summary()
        ahead = speed_ahead(run.path, "last")
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
