"""`shes plot`: learning curves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from shes.viewing.plot import plot as draw


def plot(
    runs: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN [RUN ...]")],
    *,
    out: Path = Path("curves.png"),
    x: Literal["env_steps", "generation", "wall_time_s"] = "env_steps",
) -> int:
    """Draw learning curves; runs that differ in the seed alone become a mean with an interval of 95 %.

    shes plot runs/seed1 runs/seed2 runs/seed3 --out mean.pdf --x generation

    Args:
        runs: Run folders, or names of shipped agents.
        out: The picture: .png, .pdf or .svg.
        x: What to draw over.
    """
    print(f"Learning curves: {draw(runs, out, x=x)}")
    return 0
