"""`shes evaluate`: how good a checkpoint is."""

from __future__ import annotations

from typing import Annotated, Literal

import tyro

from shes.cli.output import print_facts
from shes.training.evaluate import evaluate as run_episodes


def evaluate(
    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
    *,
    episodes: int = 50,
    checkpoint: str = "best",
    num_workers: Annotated[int, tyro.conf.arg(name="workers", aliases=("--num-workers",))] = 0,
    device: Literal["cpu", "warp-cpu", "cuda"] = "cpu",
    nconmax: int | None = None,
    njmax: int | None = None,
    seed: int | None = None,
    targets: Literal["evaluation", "training"] = "evaluation",
    json: bool = False,
) -> int:
    """Evaluate a checkpoint of a run on fresh episodes, without noise.

    shes evaluate runs/first --episodes 100

    Args:
        run: The run folder, or the name of a shipped agent.
        episodes: Number of episodes.
        checkpoint: Which checkpoint: best, last or the number of a generation.
        num_workers: Worker processes; 0 is one for every core.
        device: What computes the physics, whatever the run was trained on.
        nconmax: Contacts that a device has room for, per simulation; the run's setting if none.
        njmax: Constraint rows that a device has room for, per simulation; the run's setting if none.
        seed: Seed of the episodes; a stream of the run's own, apart from its training, if none.
        targets: Whose targets and reset noise: those of evaluation, or of training, such as the maze's random targets.
        json: Print one JSON object.
    """
    found = run_episodes(
        run,
        episodes=episodes,
        checkpoint=checkpoint,
        num_workers=num_workers,
        device=device,
        nconmax=nconmax,
        njmax=njmax,
        seed=seed,
        targets=targets,
    )
    print_facts({"run": run, "checkpoint": checkpoint, **found.summary()}, as_json=json)
    return 0
