"""Evaluation: the mean policies without noise, on fresh episodes. Source: algorithm specification section 5."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from shes.algorithms.contract import Algorithm, AnyState
from shes.backends.backend import Backend
from shes.errors import ConfigError, UnknownNameError
from shes.es.streams import Purpose, stream
from shes.hierarchy.episodes import EpisodeTask, Generation
from shes.hierarchy.results import PopulationResults, lower_diverged
from shes.runs.device import check_asked_device
from shes.training.build import build_backend, open_run
from shes.types import F64Array

__all__ = ["TARGETS", "Evaluation", "evaluate", "evaluate_state", "evaluation_seeds", "fresh_seeds"]

StateT = TypeVar("StateT", bound=AnyState)

TARGETS = ("evaluation", "training")
"""Whose targets and reset noise an evaluation may have."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """K episodes of the mean policies."""

    scores: F64Array
    """Test score of the task [K]."""
    returns: F64Array
    """Summed reward of the environment [K]."""
    primitive_returns: F64Array | None
    """Summed reward for its goals that the primitive got [K]; none where there is no primitive."""
    goals_reached: F64Array
    """Goals that the primitive reached [K]."""
    successes: F64Array
    """1 where the task counts as solved, else 0 [K]."""
    steps: F64Array
    """Environment steps [K]."""
    diverged: F64Array
    """1 where the physics blew up, else 0 [K]."""

    def summary(self) -> dict[str, Any]:
        """Return the means and deviations that tables show."""
        primitive: dict[str, Any] = {}
        if self.primitive_returns is not None:
            primitive = {
                "primitive_return_mean": float(self.primitive_returns.mean()),
                "goals_reached_mean": float(self.goals_reached.mean()),
            }
        return {
            "episodes": len(self.scores),
            "score_mean": float(self.scores.mean()),
            "score_std": float(self.scores.std()),
            "return_mean": float(self.returns.mean()),
            "return_std": float(self.returns.std()),
            **primitive,
            "success_rate": float(self.successes.mean()),
            "episode_steps_mean": float(self.steps.mean()),
            "diverged_episodes": int(self.diverged.sum()),
        }


def evaluation_seeds(
    seed: int, generation: int, episodes: int, purpose: Purpose = Purpose.EVALUATION_EPISODES
) -> list[int]:
    """Return the episodes' seeds for an evaluation after `generation`: other ones at every generation."""
    return stream(seed, purpose, generation).integers(0, 2**63, episodes).tolist()


def fresh_seeds(state: AnyState, episodes: int, seed: int | None = None) -> list[int]:
    """Return the seeds of episodes that no training uses: by `seed`, or by the run's own in a stream apart if none."""
    first, generation = (state.seed, state.generation) if seed is None else (seed, 0)
    return evaluation_seeds(first, generation, episodes, Purpose.FRESH_EPISODES)


def evaluate_state(algorithm: Algorithm[StateT], state: StateT, seeds: Sequence[int], backend: Backend) -> Evaluation:
    """Run one episode of the agent of `state` for every seed; one that diverges counts as the worst of the others.

    The episodes go out in blocks of `episodes_in_lockstep`, the rows that a policy's matmul has in training: one number
    of rows serves both, and no result depends on how the blocks are spread.
    """
    parameters, rows = algorithm.parameters(state), algorithm.episodes_in_lockstep
    zeros = (0,) * len(parameters)
    blocks = [seeds[first : first + rows] for first in range(0, len(seeds), rows)]
    tasks = [
        EpisodeTask(
            member=number,
            noise_index=zeros,
            signs=(zeros,),
            slots=tuple(range(len(block))),
            seeds=tuple(block),
            records_statistics=False,
        )
        for number, block in enumerate(blocks)
    ]
    backend.broadcast(Generation(levels=parameters, sigma=0.0, episodes_per_policy=rows, is_evaluation=True))
    results = PopulationResults.empty(len(parameters), len(tasks), rows)
    for task, result in zip(tasks, backend.map(tasks), strict=True):
        results.add(task, result)
    count = len(seeds)  # the last block may be short: its unused slots are at the end

    def column(values: np.ndarray) -> F64Array:
        return values.ravel()[:count].astype(np.float64)

    has_diverged = results.has_diverged.ravel()[:count]
    names = algorithm.design.level_names
    primitive = names.index("primitive") if "primitive" in names else None
    return Evaluation(
        scores=lower_diverged(column(results.score), has_diverged),
        returns=lower_diverged(column(results.environment_returns), has_diverged),
        primitive_returns=None if primitive is None else column(results.returns[primitive]),
        goals_reached=column(results.goals_reached),
        successes=column(results.success),
        steps=column(results.steps),
        diverged=has_diverged.astype(np.float64),
    )


def evaluate(
    run: Path | str,
    *,
    episodes: int = 50,
    checkpoint: str = "best",
    num_workers: int = 0,
    device: Literal["cpu", "cuda", "warp-cpu"] = "cpu",
    nconmax: int | None = None,
    njmax: int | None = None,
    seed: int | None = None,
    targets: Literal["evaluation", "training"] = "evaluation",
) -> Evaluation:
    """Evaluate a checkpoint of a run on episodes that its training never used, not even to choose the checkpoint.

    Args:
        run: The run folder, or the name of a shipped agent.
        episodes: Number of episodes.
        checkpoint: `best`, `last` or the number of a generation.
        num_workers: Worker processes; 0 is one for every core. Never changes a number.
        device: What computes the physics, whatever the run was trained on: `cpu`, `cuda` or `warp-cpu`.
        nconmax: Contacts that a device has room for, per simulation; the run's setting if none.
        njmax: Constraint rows that a device has room for, per simulation; the run's setting if none.
        seed: Seed of the episodes; the run's own, in a stream apart, if none.
        targets: `evaluation`, or `training`: with training's targets and reset noise, as the maze's random targets.

    Raises:
        RunFolderError: `run` is neither a run folder nor a shipped agent.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: `episodes` is not positive, `seed` is negative, or there is no such device here.
        UnknownNameError: `targets` or `device` is not known.
        MissingExtraError: The device needs a package that is not installed.
    """
    if targets not in TARGETS:
        raise UnknownNameError("targets", targets, TARGETS, "Set --targets.")
    if episodes < 1:
        raise ConfigError(f"episodes must be at least 1, got {episodes}. Set --episodes.")
    if seed is not None and seed < 0:
        raise ConfigError(f"seed must be a whole number of at least 0, got {seed}. Set --seed.")
    buffers = {name: size for name, size in (("nconmax", nconmax), ("njmax", njmax)) if size is not None}
    execution = {"num_workers": num_workers, "device": device, **buffers}
    opened = open_run(run, checkpoint, **execution, evaluation_episodes=episodes)
    check_asked_device(opened.config, execution)
    plan = opened.algorithm.plan()
    if targets == "training":
        plan = replace(plan, evaluation=plan.training)
    with build_backend(opened.config, plan) as backend:
        return evaluate_state(opened.algorithm, opened.state, fresh_seeds(opened.state, episodes, seed), backend)
