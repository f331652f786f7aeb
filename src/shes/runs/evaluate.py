"""Evaluation of the mean policies without noise, on fresh episodes. Source: SHES paper, III."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from shes.algorithms.contract import Algorithm, AnyState
from shes.backends.backend import Backend
from shes.envs.tasks.task import FallOptions
from shes.errors import ConfigError
from shes.rollout.episodes import Decisions, EpisodeTask, Generation
from shes.rollout.roll_out import PopulationResults, lower_diverged, roll_out_tasks
from shes.runs.build import build_backend, check_limits, most_episodes, open_run
from shes.runs.folder import RunFolder
from shes.runs.make_config import check_effects
from shes.settings import Ge, checked
from shes.streams import Purpose, stream
from shes.types import F64Array, Listing, facts_listing

logger = logging.getLogger("shes.run")
"""Receives what happens in a run; `log.txt` has it."""

ControllerName: TypeAlias = Literal["trained", "constant", "random"]
"""The controller of an evaluation: the trained one, the best of nine constant ones, or random directions."""
_DEGREES = (0, 45, 90, 135, 180, -135, -90, -45)
_DECISIONS: dict[ControllerName, dict[str, Decisions | None]] = {
    "trained": {"trained": None},
    "constant": {
        "constant: weights at zero": "zero",
        **{f"constant: {degrees} degrees": radians(degrees) for degrees in _DEGREES},
    },
    "random": {"random": "random"},
}
"""The controllers of an evaluation, of which the best counts, with their decisions."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Results of K episodes of the mean policies."""

    scores: F64Array
    """Score of the task [K]."""
    returns: F64Array
    """Return of the environment [K]."""
    primitive_returns: F64Array | None
    """Intrinsic return of the primitive [K]; None without a primitive."""
    goals_reached: F64Array
    """Goals that the primitive reached [K]."""
    successes: F64Array
    """1 if the task was solved, else 0 [K]."""
    steps: F64Array
    """Environment steps [K]."""
    diverged: F64Array
    """1 if the simulation diverged, else 0 [K]."""
    run: str = ""
    """The run, if it was evaluated by `evaluate`."""
    checkpoint: str = ""
    controller: str | None = None
    """`trained`, `random`, or the best of the constant controllers; None for a run without a controller.

    `constant: 45 degrees` is a goal in that direction at full distance, counter-clockwise from the heading or, if the
    outputs are in the world frame, from the x axis.
    """

    def listing(self) -> Listing:
        """Return the listing of the run, the checkpoint, the controller if there is one, and the summary."""
        controller = {} if self.controller is None else {"controller": self.controller}
        return facts_listing({"run": self.run, "checkpoint": self.checkpoint, **controller, **self.summary()})

    def summary(self) -> dict[str, Any]:
        """Return means and standard deviations by column name, as tables show them."""
        primitive: dict[str, float] = {}
        if self.primitive_returns is not None:
            primitive["primitive_return_mean"] = float(self.primitive_returns.mean())
            primitive["goals_reached_mean"] = float(self.goals_reached.mean())
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
    """Return the seeds of the episodes of an evaluation after `generation`; they differ between generations."""
    return stream(seed, purpose, generation).integers(0, 2**63, episodes).tolist()


def fresh_seeds(state: AnyState, episodes: int, seed: int | None = None) -> list[int]:
    """Return seeds of episodes that training does not use: derived from `seed`, or from the run if None."""
    key = (state.seed, state.generation) if seed is None else (seed, 0)
    return evaluation_seeds(*key, episodes, Purpose.FRESH_EPISODES)


def evaluate_state(
    algorithm: Algorithm[Any],
    state: Any,
    seeds: Sequence[int],
    backend: Backend,
    controller: ControllerName = "trained",
) -> Evaluation:
    """Run an episode of the agent of `state` for every seed and return the results.

    A diverged episode counts as the worst of the others. The episodes run in blocks of `episodes_in_lockstep`, the
    number of rows of a policy's matmul in training, so that results do not depend on the distribution of the blocks.
    Of the constant controllers, the one with the highest mean score counts, then mean return; of equal ones, the first.
    """
    parameters, rows, design = algorithm.parameters(state), algorithm.episodes_in_lockstep, algorithm.design
    zeros, found = (0,) * len(parameters), list[Evaluation]()
    tasks = [
        EpisodeTask(
            member=number,
            noise_index=zeros,
            signs=(zeros,),
            slots=tuple(range(len(block))),
            seeds=tuple(block),
            records_statistics=False,
        )
        for number, block in enumerate(seeds[first : first + rows] for first in range(0, len(seeds), rows))
    ]
    for name, decisions in _DECISIONS[controller].items():
        levels = parameters
        if decisions is not None:  # a network with parameters of 0 returns 0
            pairs = zip(design.networks, parameters, strict=True)
            levels = tuple(level.at_zero() if own == "controller" else level for own, level in pairs)
        generation = Generation(
            levels=levels, sigma=0.0, episodes_per_policy=rows, kind="evaluation", decisions=decisions
        )
        results = roll_out_tasks(tasks, generation, backend)
        found.append(replace(_evaluation(results, len(seeds), is_paid=design.has_intrinsic_reward), controller=name))
    return max(found, key=lambda each: (each.scores.mean(), each.returns.mean()))


def _evaluation(results: PopulationResults, count: int, *, is_paid: bool) -> Evaluation:
    """Return the first `count` episodes of `results`: the last block may be shorter, with unused slots at its end."""

    def column(values: np.ndarray) -> F64Array:
        return values.ravel()[:count].astype(np.float64)

    has_diverged = results.has_diverged.ravel()[:count]
    return Evaluation(
        scores=lower_diverged(column(results.score), has_diverged),
        returns=lower_diverged(column(results.environment_returns), has_diverged),
        primitive_returns=column(results.returns[-1]) if is_paid else None,
        goals_reached=column(results.goals_reached),
        successes=column(results.success),
        steps=column(results.steps),
        diverged=has_diverged.astype(np.float64),
    )


@checked
def evaluate(
    run: Path | str,
    *,
    episodes: Annotated[int, Ge(1)] = 50,
    checkpoint: str = "best",
    num_workers: int = 0,
    device: Literal["cpu", "cuda", "warp-cpu"] = "cpu",
    nconmax: int | None = None,
    njmax: int | None = None,
    deterministic: bool = False,
    seed: Annotated[int, Ge(0)] | None = None,
    targets: Literal["evaluation", "training"] = "evaluation",
    controller: ControllerName = "trained",
) -> Evaluation:
    """Evaluate a checkpoint of a run on episodes that its training did not use, not even to choose the checkpoint.

    shes evaluate runs/first --episodes 100

    Args:
        run: The run folder, or the name of a shipped agent.
        episodes: Number of episodes.
        checkpoint: Checkpoint: `best`, `last` or the number of a generation.
        num_workers: Worker processes on this machine, wherever the run was trained; 0 is one for every core. Does not
            change results.
        device: Device of the physics, whichever the run was trained on.
        nconmax: Contact buffer of a device, per simulation; that of the run if none.
        njmax: Constraint buffer of a device, in rows per simulation; that of the run if none.
        deterministic: Whether a device repeats its results bit by bit; always if that of the run did.
        seed: Seed of the episodes; derived from that of the run if none.
        targets: Targets and reset noise: those of evaluation, or of training, such as random targets in the maze.
        controller: The trained controller; `random`, which sets a goal in a random direction at every decision; or
            `constant`, the one with the best score of nine that always set the same goal. A score that these reach as
            well was not learned.
    """
    given = {"num_workers": num_workers, "device": device, "nconmax": nconmax, "njmax": njmax}
    given["deterministic"] = deterministic or None
    execution = {name: value for name, value in given.items() if value is not None}
    if device == "cpu" and RunFolder.open(run).read_config().workers.backend != "serial":
        execution["backend"] = "processes"  # the cluster that trained the run need not be there
    opened = open_run(run, checkpoint, **execution, evaluation_episodes=episodes)
    config, algorithm, levels = opened.config, opened.algorithm, opened.config.level_names
    if controller != "trained" and "controller" not in levels:
        raise ConfigError(
            f"controller is {controller!r}, but {run} has no controller (levels: {', '.join(levels)}), so that only "
            "'trained' is allowed. Omit --controller, or choose a run of two levels."
        )
    check_effects(config, execution)
    check_limits(config, algorithm.design, is_evaluation=True)
    plan = algorithm.plan()
    if targets == "training":
        own = {"max_tilt": None} if isinstance(plan.training, FallOptions) else {}  # no target of training
        plan = replace(plan, evaluation=replace(plan.training, **own))
    with build_backend(config, plan, most_episodes(config, is_evaluation=True)) as backend:
        backend.on_event = logger.warning  # of silent or lost workers; on standard error, unless logging is set up
        seeds = fresh_seeds(opened.state, episodes, seed)
        found = evaluate_state(algorithm, opened.state, seeds, backend, controller)
    shown = found.controller if "controller" in levels else None
    return replace(found, run=str(run), checkpoint=checkpoint, controller=shown)
