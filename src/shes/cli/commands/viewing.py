"""`shes plot`, `render` and `watch`: learning curves, videos, and a window."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.progress import Progress

from shes.cli.output import make_console, print_line
from shes.cli.parsing import Checkpoint, Run

TERMINATED = 143
"""Exit code after SIGTERM."""


def plot(
    runs: Annotated[tuple[str, ...], tyro.conf.arg(metavar="RUN [RUN ...]")],
    *,
    out: Path = Path("curves.png"),
    x: Literal["env_steps", "generation", "wall_time_s"] = "env_steps",
) -> int:
    """Plot learning curves. Runs that differ only in the seed become a mean with a 95 % interval.

    shes plot runs/seeds runs/other --out mean.pdf --x generation

    Args:
        runs: Run folders, folders of runs, or names of shipped agents.
        out: The figure: .png, .pdf or .svg.
        x: Horizontal axis.
    """
    from shes.viewing.plot import plot as draw

    print_line(f"Learning curves: {draw(runs, out, x=x)}")
    return 0


def render(
    run: Run,
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

    Needs no screen: EGL or OSMesa draws, whichever works (MUJOCO_GL decides if it is set); without either the pictures
    are flat. Without a graphics card 500 control steps take a minute or two.

    shes render runs/first --checkpoint 0 best --camera follow

    Args:
        out: The video: .mp4 or .gif.
        checkpoint: Checkpoints: best, last or numbers of generations. Several are drawn side by side.
        camera: Camera.
        episode: Index of the episode, among those of shes evaluate.
        seed: Seed of the episodes; that of shes evaluate if none.
        size: Width and height of one view in pixels.
        steps: Maximum number of control steps; the whole episode if none.
    """
    from shes.viewing.render import render as draw

    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))  # so that ffmpeg and its files are removed
    view = {"camera": camera, "episode": episode, "seed": seed, "size": size, "steps": steps}
    console = make_console(stderr=True)
    with Progress(
        console=console, transient=True, disable=not console.is_terminal or console.is_dumb_terminal
    ) as progress:
        task = progress.add_task("drawing", total=None)

        def show(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        video = draw(run, out, checkpoints=checkpoint, on_step=show, **view)
    print_line(f"Video: {video}")
    return 0


def watch(run: Run, *, checkpoint: Checkpoint = "best", seed: int | None = None) -> int:
    """Watch a run's policy in a window, episode after episode. It needs a display.

    Args:
        seed: Seed of the episodes; that of shes evaluate if none.
    """
    from shes.viewing.watch import watch as show

    show(run, checkpoint=checkpoint, seed=seed)
    return 0
