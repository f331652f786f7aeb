"""Golden trajectories: short episodes of every environment, stored as JSON beside this file.

Write them anew with

    python -m tests.golden.trajectories

from the root of the repository, on purpose only: after a change that is meant to change numbers (say so in
CHANGELOG.md) or with a new version of MuJoCo, once the difference has been looked at.
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np

from shes.envs.registry import ENVIRONMENTS, make_task

FOLDER = Path(__file__).parent
SEEDS = (11, 12, 13)
NUM_STEPS = 20
STORED_EVERY = 4
"""Observations are stored after every so many control steps, the start included."""
DECIMALS = 12


def golden_file(name):
    """Return where the golden trajectory of environment `name` lies."""
    return FOLDER / f"trajectory_{name}.json"


def smooth_actions(num_actions, control_limit):
    """Return slow sine waves [step, action] of 80 % of the control range, each control with its own phase."""
    step, control = np.arange(NUM_STEPS)[:, None], np.arange(num_actions)[None, :]
    return 0.8 * control_limit * np.sin(0.25 * step + 1.3 * control + 0.9)


def play(name, shift=0.0):
    """Play environment `name` and return its trajectory; `shift` is added to the first velocity at the start."""
    task = make_task(name, len(SEEDS))
    ids = np.arange(len(SEEDS))
    task.reset(ids, SEEDS)
    task.sim.qvel[:, 0] += shift
    observations, rewards = [task.observe().copy()], []
    for step, action in enumerate(smooth_actions(task.action_size, task.control_limit), start=1):
        task.step(ids, np.tile(action, (len(ids), 1)))
        rewards.append(task.reward.copy())
        if step % STORED_EVERY == 0:
            observations.append(task.observe().copy())
    return {
        "environment": name,
        "mujoco": mujoco.__version__,
        "seeds": list(SEEDS),
        "rewards": np.array(rewards).T.tolist(),
        "scores": task.score.tolist(),
        "observations": np.array(observations).transpose(1, 0, 2).round(DECIMALS).tolist(),
    }


def load(name):
    """Return the stored trajectory of environment `name`."""
    return json.loads(golden_file(name).read_text(encoding="utf-8"))


def write(name):
    """Store the trajectory of environment `name`: one line per observation, so that a difference can be read."""
    trajectory = play(name)
    lines = [f' "{key}": {json.dumps(trajectory[key])},' for key in trajectory if key != "observations"]
    rows = [",\n  ".join(json.dumps(row) for row in episode) for episode in trajectory["observations"]]
    episodes = "],\n [".join(f"\n  {episode}" for episode in rows)
    golden_file(name).write_text(
        "{\n" + "\n".join(lines) + f'\n "observations": [\n [{episodes}]\n ]\n' + "}\n", encoding="utf-8"
    )


if __name__ == "__main__":
    for each in ENVIRONMENTS:
        write(each)
        sys.stdout.write(f"wrote {golden_file(each)}\n")
