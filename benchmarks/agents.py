"""Agents on fresh episodes: `python benchmarks/agents.py --out results/learning/agents.csv` for those shipped.

`python benchmarks/agents.py results/gpu/ant-gather results/gpu/ant-push --out results/gpu/agents.csv` for run folders.
Each agent's own evaluation (`shes info AGENT`) has 200 episodes. Where an agent is the best of several seeds, those
episodes chose it. These 400 others selected neither a checkpoint nor a seed. Two minutes on two cores.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from run import write_csv

import shes
from shes.runs.shipped import shipped_names

EPISODES, SEED = 400, 1000
AGENTS = shipped_names()


def measure(agent: str) -> dict[str, Any]:
    """Return the row of an agent."""
    found = shes.evaluate(agent, episodes=EPISODES, seed=SEED).summary()
    keys = ("score_mean", "score_std", "return_mean", "success_rate", "episode_steps_mean")
    return {"agent": agent, "episodes": EPISODES, "seed": SEED, **{key: found[key] for key in keys}}


def main() -> None:
    """Evaluate, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("agents", nargs="*", default=AGENTS, metavar="AGENT", help="names or run folders; default: all")
    parser.add_argument("--out", type=Path, required=True, help="CSV file to write")
    asked = parser.parse_args()
    rows = []
    for agent in asked.agents:
        rows.append(measure(agent))
        print(rows[-1], flush=True)
    write_csv(asked.out, rows)


if __name__ == "__main__":
    main()
