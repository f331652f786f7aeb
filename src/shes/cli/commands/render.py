"""`shes render`: a video of a run's policy."""

from __future__ import annotations

import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from shes.cli.command import Command
from shes.cli.options import Group, Shown, options_of
from shes.cli.output import print_line

TERMINATED = 143
"""Exit code after SIGTERM."""


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What `shes render` takes."""

    run: Annotated[str, Shown(metavar="RUN", noun="a run folder", is_run=True)]
    """The run folder, or the name of a shipped agent."""
    out: Path = Path("walk.mp4")
    """The video: .mp4 or .gif."""
    checkpoint: Annotated[tuple[str, ...], Shown(metavar="{best,last,NUMBER}", choices=("best", "last"))] = ("best",)
    """Which checkpoint; a number is that of a generation. Several are drawn side by side."""
    camera: Annotated[str, Shown(choices=("both", "follow", "top"))] = "both"
    """Where to look from."""
    episode: int = 0
    """Which of the episodes that `shes evaluate` runs, from 0."""
    seed: int | None = None
    """Seed of the episodes; that of `shes evaluate` if none."""
    size: int = 480
    """Pixels of one view, in each direction."""
    steps: int | None = None
    """Control steps at most; the whole episode if none."""


def _run(values: dict[str, Any]) -> int:
    from rich.console import Console
    from rich.progress import Progress

    from shes.viewing.render import render

    given = Arguments(**values)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))  # so that ffmpeg and its files are cleared away
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("drawing", total=None)
        video = render(
            given.run,
            given.out,
            checkpoints=given.checkpoint,
            camera=given.camera,
            episode=given.episode,
            seed=given.seed,
            size=given.size,
            steps=given.steps,
            on_step=lambda done, total: progress.update(task, completed=done, total=total),
        )
    print_line(f"Video: {video}")
    return 0


COMMAND = Command(
    name="render",
    description=(
        "Make a video of a run's policy. Needs no screen: EGL or OSMesa draws, whichever works (MUJOCO_GL decides if "
        "set); without either the pictures are flat. Without a graphics card 500 control steps take a minute or two."
    ),
    examples=("shes render runs/first --out walk.mp4", "shes render runs/first --checkpoint 0 best --camera follow"),
    groups=(Group(heading="run and flags", options=options_of(Arguments)),),
    run=_run,
)
