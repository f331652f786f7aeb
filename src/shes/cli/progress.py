"""What `train` and `resume` show: progress while they work, then what came of it or how to go on."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from shes.cli.output import print_line, quote
from shes.cli.progress_display import ProgressDisplay
from shes.runs.folder import RunFolder
from shes.training.train import Run

__all__ = ["show_progress"]


def show_progress(work: Callable[[ProgressDisplay], Run], path: Path | None) -> int:
    """Run `work` with a progress display; after Ctrl-C, say how to go on.

    Args:
        work: Trains, and tells the display of it.
        path: The run folder, where it is known before.
    """
    display = ProgressDisplay(Console())
    try:
        with display:
            run = work(display)
    except KeyboardInterrupt:
        path = display.path or path
        # Before the first generation the display knows no path yet; the run can be resumed if its record is there.
        if path is not None and RunFolder(path).config.is_file():
            print_line(
                f"Stopped; everything up to the last finished generation is kept. Go on: shes resume {quote(path)}"
            )
        raise
    best = "no evaluation yet"
    if run.best.generation >= 0:
        best = f"best evaluation score {run.best.score:.2f} (generation {run.best.generation})"
    found = quote(run.path)
    print_line(f"Done: {run.generation} generations, {best}.")
    print_line(f"Next: shes evaluate {found} · shes render {found} · shes plot {found}")
    return 0
