"""Columns of `progress.csv` for a generation of HIRO or TD3. `docs/algorithm.md` explains them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from shes.algorithms.hiro.collector import Collected
from shes.algorithms.hiro.levels import LearnerState


def columns(
    levels: Mapping[str, tuple[LearnerState, Mapping[str, float]]], summary: Collected, total_s: float
) -> dict[str, Any]:
    """Return the row of `progress.csv` for a generation, by column: `levels` with their losses, `summary`, and times.

    Values that do not exist are NaN.
    """
    episodes = {name: np.array([episode[name] for episode in summary.episodes]) for name in summary.episodes[0]}
    row: dict[str, Any] = {}
    for name in levels:
        row[f"{name}_return_mean"] = float(episodes[f"{name}_return"].mean())
        row[f"{name}_return_max"] = float(episodes[f"{name}_return"].max())
    row |= {
        "score_mean": float(episodes["score"].mean()),
        "success_rate": float(episodes["success"].mean()),
        "episode_steps_mean": float(episodes["steps"].mean()),
        "terminated_rate": float(episodes["terminated"].mean()),
        "diverged_rate": float(episodes["diverged"].mean()),
        "diverged_episodes": int(episodes["diverged"].sum()),
    }
    if "primitive" in levels:
        row["goal_distance_mean"] = float(np.mean(summary.goal_distances)) if summary.goal_distances else float("nan")
    for name, (level, losses) in levels.items():
        row |= {f"{name}_{loss}": value for loss, value in losses.items()}
        row |= {f"{name}_updates": level.num_updates, f"{name}_replay_size": level.replay.size}
    rollout_s, physics_s = summary.rollout_s, summary.physics_s
    seconds = {"rollout_s": rollout_s, "update_s": total_s - rollout_s, "physics_s": physics_s}
    return row | {name: round(value, 4) for name, value in seconds.items()}
