"""`shes evaluate`: how good a checkpoint is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from shes.cli.command import Command
from shes.cli.options import Group, Shown, options_of
from shes.cli.output import print_facts


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What `shes evaluate` takes."""

    run: Annotated[str, Shown(metavar="RUN", noun="a run folder", is_run=True)]
    """The run folder, or the name of a shipped agent."""
    episodes: int = 50
    """Number of episodes."""
    checkpoint: Annotated[str, Shown(metavar="{best,last,NUMBER}", choices=("best", "last"))] = "best"
    """Which checkpoint; a number is that of a generation."""
    num_workers: Annotated[int, Shown(flags=("--workers", "--num-workers"))] = 0
    """Worker processes; 0 is one for every core."""
    device: Annotated[str, Shown(choices=("cpu", "warp-cpu", "cuda"))] = "cpu"
    """What computes the physics, whatever the run was trained on."""
    nconmax: int | None = None
    """Contacts that a device has room for, per simulation; the run's setting if none."""
    njmax: int | None = None
    """Constraint rows that a device has room for, per simulation; the run's setting if none."""
    seed: int | None = None
    """Seed of the episodes; a stream of the run's own, apart from its training, if none."""
    targets: Annotated[str, Shown(choices=("evaluation", "training"))] = "evaluation"
    """Whose targets and reset noise: those of evaluation, or of training, such as the maze's random targets."""
    json: bool = False
    """Print one JSON object."""


def _run(values: dict[str, Any]) -> int:
    from shes.training.evaluate import evaluate

    given = Arguments(**values)
    found = evaluate(
        given.run,
        episodes=given.episodes,
        checkpoint=given.checkpoint,
        num_workers=given.num_workers,
        device=given.device,
        nconmax=given.nconmax,
        njmax=given.njmax,
        seed=given.seed,
        targets=given.targets,
    )
    print_facts({"run": given.run, "checkpoint": given.checkpoint, **found.summary()}, as_json=given.json)
    return 0


COMMAND = Command(
    name="evaluate",
    description="Evaluate a checkpoint of a run on fresh episodes, without noise.",
    examples=("shes evaluate runs/first --episodes 100", "shes evaluate runs/first --checkpoint last --json"),
    groups=(Group(heading="run and flags", options=options_of(Arguments)),),
    run=_run,
)
