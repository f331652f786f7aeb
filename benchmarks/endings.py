"""How episodes end: shipped agents and other runs, over 200 fresh episodes of 500 steps of the task as specified.

`python benchmarks/endings.py --out results/learning/endings.csv`: every shipped agent (`shes list`), and the runs that
are named as well, e.g. `runs/gather/walker/seed_*`. An episode of Flagrun or Gather ends with a fall; in Maze, Push and
Fall a robot that has fallen stays where it is until time is up. About ten seconds of two cores for each agent.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from run import write_csv

import shes
from shes.runs.build import open_run
from shes.runs.folder import RunFolder
from shes.runs.shipped import shipped_names
from shes.runs.tables import last_value, read_csv

EPISODES = 200
STEPS = 500
LYING = 0.5
"""Cosine of the tilt below which a robot lies on its side or on its back: it is tilted by more than 60°."""


def play(
    run: Path | str, episodes: int, steps: int, goal: Callable[[Any], np.ndarray] = lambda task: task.goal
) -> Iterator[Any]:
    """Yield the evaluation's task [episodes] after every step of the best checkpoint, with seeds 0, 1, ...

    Robots whose episodes have ended go on.

    `goal` returns the goals [episodes, 2] in metres that the agent has in a task that sets goals.
    """
    problem, agent = open_run(run).algorithm.problem, shes.load(run, num_envs=episodes)
    task, robots = problem.env.make(episodes, problem.evaluation), np.arange(episodes)
    task.reset(robots, robots.tolist())
    for _ in range(steps):
        task.step(robots, agent.control(task.observe(), task.position, task.heading, goal(task)))
        yield task
    task.close()


def speed_ahead(run: Path | str, num_robots: int = 64, steps: int = 150, skipped: int = 30) -> float:
    """Return the mean speed in m/s towards goals 8 m ahead, after `skipped` steps, of robots that have not fallen."""
    angle = np.random.default_rng(0).uniform(-np.pi, np.pi, num_robots)
    ahead = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    walks, speeds = np.ones(num_robots, bool), []
    before = np.zeros((num_robots, 2))
    for step, task in enumerate(play(run, num_robots, steps, lambda task: task.position + 8 * ahead)):
        walks &= ~task.terminated & (np.abs(task.position).max(axis=1) < 11)  # the field ends at 12 m
        if step >= skipped:
            speeds.append(10 * ((task.position - before) * ahead).sum(axis=1)[walks])
        before = task.position.copy()
    return float(np.concatenate(speeds).mean())


def endings(run: str | Path) -> dict[str, Any]:
    """Return the shares of the ways in which the episodes of the best checkpoint end, with score and successes."""
    steps, success = np.full(EPISODES, STEPS), np.zeros(EPISODES, bool)
    score, lies = np.zeros(EPISODES), np.zeros(EPISODES, bool)
    runs_on = np.ones(EPISODES, bool)
    for step, task in enumerate(play(run, EPISODES, STEPS), start=1):
        success[runs_on], score[runs_on] = task.success[runs_on], task.score[runs_on]
        lies[runs_on] = (task.body.cos_tilt(task.sim.qpos) < LYING)[runs_on]
        steps[runs_on & task.terminated] = step
        runs_on &= ~task.terminated
    return {
        "score_mean": round(float(score.mean()), 3),
        "success_rate": round(float(success.mean()), 3),
        "upright_to_the_end": round(float((runs_on & ~lies).mean()), 3),
        "ended_by_a_fall": round(float((~runs_on).mean()), 3),
        "lying_at_the_end": round(float((runs_on & lies).mean()), 3),
        "lying_without_success": round(float((runs_on & lies & ~success).mean()), 3),
        "upright_without_success": round(float((runs_on & ~lies & ~success).mean()), 3),
        "steps_mean": round(float(steps.mean()), 1),
    }


def about(run: str | Path, *, is_shipped: bool) -> dict[str, Any]:
    """Return the row of a run: what it took, unless it is shipped, and how its episodes end."""
    env = open_run(run).config.run.env
    row: dict[str, Any] = {"agent": str(run), "env": env, "env_steps": "", "wall_time_s": ""}
    if not is_shipped:
        progress = RunFolder.open(run).progress
        row |= {
            "env_steps": int(read_csv(progress)["env_steps"][-1]),
            "wall_time_s": round(last_value(progress, "wall_time_s")),
        }
    row |= {"episodes": EPISODES, **endings(run)}
    return row | {"speed_ahead_m_s": round(speed_ahead(run), 2) if env == "ant-flagrun" else ""}


def main() -> None:
    """Measure the shipped agents and the runs named; print and write their rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="*", type=Path, help="further runs")
    parser.add_argument("--out", type=Path, required=True, help="CSV file to write")
    asked = parser.parse_args()
    rows = []
    for run in (*shipped_names(), *asked.runs):
        rows.append(about(run, is_shipped=isinstance(run, str)))
        print(rows[-1], flush=True)
    write_csv(asked.out, rows)


if __name__ == "__main__":
    main()
