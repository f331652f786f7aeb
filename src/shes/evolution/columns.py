"""Columns of `progress.csv` for a generation of an evolution strategy. `docs/algorithm.md` explains them."""

from __future__ import annotations

from typing import Any

import numpy as np

from shes.es.level import select_fitness
from shes.evolution.algorithm import GenerationReport
from shes.rollout.episodes import PARTS
from shes.types import F64Array, IntArray


def columns(report: GenerationReport) -> dict[str, Any]:
    """Return the row of `progress.csv` for a generation, by column.

    `physics_s`, `policy_s` and `task_s` are summed over the workers. Values that do not exist are NaN.
    """
    episodes, *pairs = report.populations
    results, levels = episodes.results, report.state.levels
    row: dict[str, Any] = {}
    for level, (population, i) in zip(levels, report.sources, strict=True):
        fitness = population.results.fitness[i]
        row[f"{level.name}_return_mean"] = float(fitness.mean())
        row[f"{level.name}_return_max"] = float(fitness.max())
    row |= {
        "score_mean": float(results.score.mean()),
        "success_rate": float(results.success.mean()),
        "episode_steps_mean": float(results.steps.mean()),
        "terminated_rate": float(results.has_terminated.mean()),
        "diverged_rate": float(results.has_diverged.mean()),
        "diverged_episodes": int(results.has_diverged.sum()),
        "episodes_per_policy": results.score.shape[1],
        "sigma": episodes.generation.sigma,
        "learning_rate": episodes.learning_rate,
    }
    if any(level.name == "primitive" for level in levels):
        row["goals_reached_mean"] = float(results.goals_reached.mean())
    for level, update, (population, i) in zip(levels, report.updates, report.sources, strict=True):
        signs = population.signs[:, :, i]
        indices = population.noise_index[i][signs.any(axis=1)]
        row |= {
            f"{level.name}_noise_distinct": len(np.unique(indices)),
            f"{level.name}_noise_overlapping": _overlapping(indices, len(level.theta)),
            f"{level.name}_rank_ties": _tied(select_fitness(population.results.fitness[i], signs)),
            f"{level.name}_gradient_norm": update.gradient_norm,
            f"{level.name}_halves_cosine": update.halves_cosine,
            f"{level.name}_update_ratio": update.update_ratio,
            f"{level.name}_theta_norm": float(np.linalg.norm(level.theta.astype(np.float64))),
        }
    archive = report.state.archive
    if archive is not None:
        row |= {
            "exploration_steps": archive.env_steps,
            "cells": len(archive.cells),
            "way_steps": archive.way_steps or float("nan"),
        }
    for each in pairs:
        row |= {
            "branch_steps_mean": float(each.results.steps.mean()),
            "branch_terminated_rate": float(each.results.has_terminated.mean()),
            "primitive_sigma": each.generation.sigma,
            "primitive_learning_rate": each.learning_rate,
        }
    row |= {"rollout_s": round(report.rollout_s, 4), "update_s": round(report.update_s, 4)}
    seconds = np.sum([each.results.seconds for each in report.populations], axis=0)
    return row | {f"{part}_s": round(float(s), 4) for part, s in zip(PARTS, seconds, strict=True)}


def _tied(fitness: F64Array) -> float:
    """Return the fraction of members whose fitness another member has as well; NaN if there are no members."""
    if not len(fitness):
        return float("nan")
    _, counts = np.unique(fitness, return_counts=True)
    return float(counts[counts > 1].sum() / len(fitness))


def _overlapping(indices: IntArray, dim: int) -> int:
    """Return how many of the noise vectors that start at `indices` overlap with another one in the table."""
    ordered = np.sort(indices)
    touches = np.diff(ordered) < dim
    return int((np.concatenate([touches, [False]]) | np.concatenate([[False], touches])).sum())
