"""`shes plot`: learning curves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from shes.cli.command import Command
from shes.cli.options import Group, Shown, options_of

X_AXES = ("env_steps", "generation", "wall_time_s")  # those of `viewing.plot`, which imports matplotlib


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What `shes plot` takes."""

    runs: Annotated[tuple[str, ...], Shown(metavar="RUN ...", noun="at least one run folder", is_run=True)]
    """Run folders, or names of shipped agents."""
    out: Path = Path("curves.png")
    """The picture: .png, .pdf or .svg."""
    x: Annotated[str, Shown(choices=X_AXES)] = "env_steps"
    """What to draw over."""


def _run(values: dict[str, Any]) -> int:
    from shes.viewing.plot import plot

    given = Arguments(**values)
    print(f"Learning curves: {plot(given.runs, given.out, x=given.x)}")
    return 0


COMMAND = Command(
    name="plot",
    description="Draw learning curves; runs that differ in the seed alone become a mean with an interval of 95 %.",
    examples=("shes plot runs/first", "shes plot runs/seed1 runs/seed2 runs/seed3 --out mean.pdf --x generation"),
    groups=(Group(heading="runs and flags", options=options_of(Arguments)),),
    run=_run,
)
