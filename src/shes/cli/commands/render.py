"""`shes render`: a video of a run's policy."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.progress import Progress

from shes.cli.output import print_line

TERMINATED = 143
"""Exit code after SIGTERM."""


def render(
    run: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")],
    *,
    out: Path = Path("walk.mp4"),
    checkpoint: tuple[str, ...] = ("best",),
    camera: Literal["both", "follow", "top"] = "both",
    episode: int = 0,
    seed: int | None = None,
    size: int = 480,
    steps: int | None = None,
) -> int:
    """Make a video of a run's policy.

    Needs no screen: EGL or OSMesa draws, whichever works (MUJOCO_GL decides if set); without either the pictures are
    flat. Without a graphics card 500 control steps take a minute or two.

    shes render runs/first --checkpoint 0 best --camera follow

    Args:
        run: The run folder, or the name of a shipped agent.
        out: The video: .mp4 or .gif.
        checkpoint: Which checkpoint: best, last or the number of a generation. Several are drawn side by side.
        camera: Where to look from.
        episode: Which of the episodes that shes evaluate runs, from 0.
        seed: Seed of the episodes; that of shes evaluate if none.
        size: Pixels of one view, in each direction.
        steps: Control steps at most; the whole episode if none.
    """
    from shes.viewing.render import render as draw

    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))  # so that ffmpeg and its files are cleared away
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("drawing", total=None)
        video = draw(
            run,
            out,
            checkpoints=checkpoint,
            camera=camera,
            episode=episode,
            seed=seed,
            size=size,
            steps=steps,
            on_step=lambda done, total: progress.update(task, completed=done, total=total),
        )
    print_line(f"Video: {video}")
    return 0
