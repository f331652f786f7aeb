"""Learners of the same walking task on the same cores: return over wall-clock and over environment steps.

`python benchmarks/peers/learning.py --out results/peers` (an idle machine; 5 minutes for each of the runs, three seeds)
trains on Ant Flagrun, or with `--robot FILE` on Flagrun with a robot, with

- `shes`: this package, preset `laptop`, with more generations;
- `ppo`: a single file of PPO over our vector environment, with the view of our walker (`ppo.py`);
- `sb3-ppo`: PPO of Stable-Baselines3 with the settings that RL Zoo publishes for Ant, which are its defaults and
  normalisation, in two processes;
- `evotorch-pgpe`: PGPE of EvoTorch with ClipUp on `GymNE`, as its authors publish it for Walker2d (`rl_clipup.py`,
  with horizon 500 instead of 1000, and without its bonus for staying alive, which this task does not have).

The last two see the environment's own observations, as their users would. Evaluations (50 fresh episodes, 100 of a
robot, deterministic policies) do not count as training time, nor do imports and the start of workers, but for `shes`.
Writes `learning.csv`, with a robot `FILE.csv`, and its figure; runs that the table has are not made again. In an
environment of its own:

    pip install torch==2.13.0 stable-baselines3 evotorch shes
"""

# pyright: reportMissingImports=false

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from walking import Act, Walk

sys.path.append(str(Path(__file__).parents[1]))
from run import write_csv
from versions import write_versions

import shes
from shes.runs.tables import read_csv

POINTS = 15
"""Evaluations of a run."""


class Watch:
    """Counts the seconds of training, and evaluates at even intervals."""

    def __init__(self, walk: Walk, seconds: float) -> None:
        """Let training be over after `seconds`."""
        self.rows: list[dict[str, float]] = []
        self.walk, self.seconds, self._every, self._paused = walk, seconds, seconds / POINTS, 0.0
        self.begin()

    def begin(self) -> None:
        """Begin to count."""
        self._start = perf_counter()

    def is_over(self, env_steps: int, make_act: Callable[[], Act]) -> bool:
        """Evaluate if it is time to; return whether training is over."""
        seconds = perf_counter() - self._start - self._paused
        if seconds < self._every * (len(self.rows) + 1):
            return False
        self.note(seconds, env_steps, make_act())
        self._paused = perf_counter() - self._start - seconds
        return seconds >= self.seconds

    def note(self, seconds: float, env_steps: int, act: Act) -> None:
        """Evaluate."""
        self.rows.append({"seconds": round(seconds, 1), "env_steps": env_steps, **self.walk.evaluate(act)})
        print(self.rows[-1], file=sys.stderr, flush=True)


def train_shes(seed: int, watch: Watch) -> None:
    """Train by the preset, and evaluate the checkpoints afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run"
        settings: dict[str, Any] = {"evaluation_interval": 1_000_000, "keep_checkpoints": 1, "generations": 1_000_000}
        settings |= {**watch.walk.robot, "seed": seed, "minutes": watch.seconds / 60}
        shes.train(watch.walk.name, out=path, progress=False, **settings)
        table = read_csv(path / "progress.csv")
        times = table["wall_time_s"]
        for due in watch.seconds * np.arange(1, POINTS + 1) / POINTS:
            row = min(int(np.searchsorted(times, due)), len(times) - 1)
            agent = shes.load(path, checkpoint=str(int(table["generation"][row])), num_envs=watch.walk.episodes)
            watch.note(float(times[row]), int(table["env_steps"][row]), agent.act)


def train_ppo(seed: int, watch: Watch) -> None:
    """Train by `ppo.py`."""
    import ppo

    watch.begin()
    for env_steps, policy in ppo.train(watch.walk, seed):
        if watch.is_over(env_steps, lambda policy=policy: ppo.act(watch.walk, policy)):
            return


def train_sb3(seed: int, watch: Watch) -> None:
    """Train by PPO of Stable-Baselines3."""
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import SubprocVecEnv, VecNormalize

    class Watching(BaseCallback):
        def _on_step(self) -> bool:
            return not watch.is_over(self.num_timesteps, lambda: act)

    def act(observation: np.ndarray) -> np.ndarray:
        return model.predict(envs.normalize_obs(observation), deterministic=True)[0]

    own = make_vec_env(
        watch.walk.env,
        2,
        seed=seed,
        env_kwargs=watch.walk.robot,
        vec_env_cls=SubprocVecEnv,
        vec_env_kwargs={"start_method": "spawn"},
    )
    envs = VecNormalize(own)
    model = PPO("MlpPolicy", envs, n_steps=1024, seed=seed, device="cpu")
    envs.reset()
    watch.begin()
    model.learn(10**9, callback=Watching())
    envs.close()


def make_env(walk: Walk) -> Any:
    """Return the environment; EvoTorch calls this in its actors."""
    import gymnasium

    robot: dict[str, Any] = walk.robot
    return gymnasium.make(walk.env, **robot)


def train_evotorch(seed: int, watch: Watch) -> None:
    """Train by PGPE of EvoTorch."""
    os.environ["RAY_ADDRESS"] = "local"  # not a cluster that happens to run here
    import torch
    from evotorch.algorithms import PGPE
    from evotorch.neuroevolution import GymNE

    torch.manual_seed(seed)
    speed, size = 0.015, 100
    problem = GymNE(
        partial(make_env, watch.walk), "Linear(obs_length, act_length)", observation_normalization=True, num_actors=2
    )
    searcher = PGPE(
        problem,
        popsize=size,
        popsize_max=8 * size,
        num_interactions=int(0.75 * watch.walk.horizon * size),
        center_learning_rate=0.75 * speed,
        stdev_learning_rate=0.1,
        stdev_max_change=0.2,
        radius_init=15 * speed,
        optimizer="clipup",
        optimizer_config={"max_speed": speed, "momentum": 0.9},
    )

    def make_act() -> Act:
        policy = problem.to_policy(searcher.status["center"])

        @torch.no_grad()
        def act(observation: np.ndarray) -> np.ndarray:
            return policy(torch.as_tensor(observation, dtype=torch.float32)).clamp(-1, 1).numpy()

        return act

    problem.evaluate(problem.generate_batch(2))  # starts the actors
    watch.begin()
    while True:
        searcher.step()
        if watch.is_over(int(problem.status["total_interaction_count"]), make_act):
            break
    problem.kill_actors()


LEARNERS = {"shes": train_shes, "ppo": train_ppo, "sb3-ppo": train_sb3, "evotorch-pgpe": train_evotorch}


def draw(rows: list[dict[str, str]], path: Path) -> None:
    """Draw the median return of each learner, and the range of its seeds, over seconds and over environment steps."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(10, 4), sharey=True)
    labels = {"seconds": "seconds of two cores", "env_steps": "environment steps"}
    for axis, (name, label) in zip(panels, labels.items(), strict=True):
        for learner in LEARNERS:
            own = [row for row in rows if row["learner"] == learner]
            seeds = sorted({row["seed"] for row in own})
            curves = [
                [(float(row[name]), float(row["return_mean"])) for row in own if row["seed"] == seed] for seed in seeds
            ]
            if not curves:
                continue
            length = min(map(len, curves))
            points = np.array([curve[:length] for curve in curves])
            x, y = np.median(points[..., 0], axis=0), points[..., 1]
            (line,) = axis.plot(x, np.median(y, axis=0), label=learner)
            axis.fill_between(x, y.min(axis=0), y.max(axis=0), alpha=0.2, color=line.get_color(), linewidth=0)
        axis.set_xlabel(label)
        axis.grid(alpha=0.3)
    panels[1].set_xscale("log")
    panels[0].set_ylabel("return of Flagrun")
    panels[0].legend()
    figure.tight_layout()
    figure.savefig(path, dpi=150)


def main() -> None:
    """Train what the table lacks, and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the table and the figure")
    parser.add_argument("--robot", help="MJCF file of a robot; by default the ant")
    parser.add_argument("--only", nargs="+", choices=LEARNERS, default=list(LEARNERS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3])
    parser.add_argument("--seconds", type=float, default=300.0, help="seconds of training of each run")
    parser.add_argument("--one", nargs=2, metavar=("LEARNER", "SEED"), help="train one run, and print its rows")
    asked = parser.parse_args()
    if asked.one:
        learner, seed = asked.one
        watch = Watch(Walk(asked.robot, 100 if asked.robot else 50), asked.seconds)
        LEARNERS[learner](int(seed), watch)
        for row in watch.rows:
            print("row", *(f"{name}={value}" for name, value in row.items()))
        return
    asked.out.mkdir(parents=True, exist_ok=True)
    table = asked.out / (f"{Path(asked.robot).stem}.csv" if asked.robot else "learning.csv")
    rows: list[dict[str, Any]] = []
    if table.exists():
        with table.open(newline="") as file:
            rows = list(csv.DictReader(file))
    for seed in asked.seeds:
        for learner in asked.only:
            if any((row["learner"], int(row["seed"])) == (learner, seed) for row in rows):
                continue
            command = [sys.executable, __file__, "--out", str(asked.out), "--one", learner, str(seed)]
            command += ["--seconds", str(asked.seconds), *(["--robot", asked.robot] if asked.robot else [])]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
            found = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("row ")]
            rows += [{"learner": learner, "seed": seed, **dict(pair.split("=") for pair in row)} for row in found]
            write_csv(table, [{name: row.get(name, "") for name in rows[-1]} for row in rows])
    write_versions(table.with_name(f"{table.stem}_versions.csv"))
    with table.open(newline="") as file:
        draw(list(csv.DictReader(file)), table.with_suffix(".png"))


if __name__ == "__main__":
    main()
