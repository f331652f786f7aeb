"""`shes plot`, `render`, `watch` and `export`: learning curves, videos, a window, and files that need no SHES."""

from __future__ import annotations

import signal
import sys
from typing import Annotated, Any

import tyro
from rich.progress import Progress

import shes
from shes.cli.output import make_console, print_line

TERMINATED = 143
"""Exit code after SIGTERM."""
_Runs = Annotated[tuple[str, ...], tyro.conf.arg(metavar="RUN [RUN ...]", help_behavior_hint="(required)")]


def plot(runs: _Runs, **options: Annotated[Any, "shes.viewing.plot.plot"]) -> int:
    """Plot learning curves. Runs that differ only in the seed become a mean with a 95 % interval.

    shes plot runs/seeds runs/other --out mean.pdf --x generation
    """
    print_line(f"Learning curves: {shes.plot(runs, **options)}")
    return 0


def render(runs: _Runs, **options: Annotated[Any, "shes.viewing.render.render"]) -> int:
    """Make a video of a run's policy, or of several policies side by side.

    Needs no screen: EGL or OSMesa draws, whichever works (MUJOCO_GL decides if it is set); without either the pictures
    are flat. Without a graphics card 500 control steps take a minute or two.

    shes render runs/first --checkpoint 0 best --camera follow

    shes render runs/first ant-gather --labels "my ant" shipped
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED))  # so that ffmpeg and its files are removed
    console = make_console(stderr=True)
    is_silent = not console.is_terminal or console.is_dumb_terminal
    with Progress(console=console, transient=True, disable=is_silent) as progress:
        task = progress.add_task("drawing", total=None)

        def show(done: int, total: int) -> None:
            progress.update(task, completed=done, total=total)

        video = shes.render(runs, **options, on_step=show)
    print_line(f"Video: {video}")
    return 0


def watch(**options: Annotated[Any, "shes.viewing.watch.watch"]) -> int:
    """Watch a run's policy in a window, episode after episode. It needs a display."""
    shes.import_module("shes.viewing.watch").watch(**options)
    return 0


def export(**options: Annotated[Any, "shes.training.export.export"]) -> int:
    """Write a run's policy, with its normalisation, to a file that needs no SHES.

    The program examples/run_exported.py acts from an npz file with NumPy alone.

    shes export ant-gather --format onnx --out gather.onnx
    """
    for path in shes.export(**options):
        print_line(f"Policy: {path}")
    return 0
