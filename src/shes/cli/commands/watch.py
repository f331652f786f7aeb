"""`shes watch`: a run's policy in MuJoCo's window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from shes.cli.command import Command
from shes.cli.options import Group, Shown, options_of


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What `shes watch` takes."""

    run: Annotated[str, Shown(metavar="RUN", noun="a run folder", is_run=True)]
    """The run folder, or the name of a shipped agent."""
    checkpoint: Annotated[str, Shown(metavar="{best,last,NUMBER}", choices=("best", "last"))] = "best"
    """Which checkpoint; a number is that of a generation."""
    seed: int | None = None
    """Seed of the episodes; a stream of the run's own, apart from its training, if none."""


def _run(values: dict[str, Any]) -> int:
    from shes.viewing.watch import watch

    given = Arguments(**values)
    watch(given.run, checkpoint=given.checkpoint, seed=given.seed)
    return 0


COMMAND = Command(
    name="watch",
    description="Look at a run's policy in a window, episode after episode. It needs a display.",
    examples=("shes watch runs/first",),
    groups=(Group(heading="run and flags", options=options_of(Arguments)),),
    run=_run,
)
