"""`make demo`: train Point Gather for two to three minutes, evaluate it, draw its learning curves, make a video."""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path

from rich.console import Console

from shes.errors import ShesError
from shes.experiments.evaluate import evaluate
from shes.experiments.plot import plot
from shes.experiments.progress import ProgressDisplay
from shes.experiments.render import render
from shes.experiments.train import train

__all__ = ["main"]

ENV = "point-gather"
EPISODES = 50
VIDEO_STEPS = 200


def main() -> int:
    """Run the demo in the working directory; return the exit code."""
    console = Console()
    path = Path("runs") / f"demo-{datetime.now().astimezone():%Y%m%d-%H%M%S}"
    console.print(
        "A point robot learns, by evolution, to collect food (+1) and leave poison (-1): a controller that sets goals, "
        "and a primitive that reaches them. Two to three minutes on two cores; Ctrl-C stops and keeps everything.",
        highlight=False,
    )
    display = ProgressDisplay(console)
    try:
        with display:
            train(ENV, out=path, listener=display)
        before = evaluate(path, episodes=EPISODES, checkpoint="0")
        after = evaluate(path, episodes=EPISODES)
        curves = plot([path], path / "curves.png")
        console.print("Drawing 20 seconds of the untrained and the trained agent ...", highlight=False)
        video = render(path, path / "before-after.mp4", checkpoints=("0", "best"), size=320, steps=VIDEO_STEPS)
    except KeyboardInterrupt:
        console.print(f"Stopped. Go on: .venv/bin/shes resume {path}", highlight=False, soft_wrap=True)
        return 130
    except ShesError as error:
        Console(stderr=True).print(f"Error: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
        return error.exit_code
    console.print(
        f"\nScore over {EPISODES} fresh episodes: {after.scores.mean():.2f}, "
        f"before training {before.scores.mean():.2f} (8 is the most there is).\n"
        f"Learning curves: {curves}\n"
        f"Video, before and after: {video}\n"
        f"Next: .venv/bin/shes train ant-gather   (the ant: results/README.md says how far an hour gets)\n"
        f"      .venv/bin/shes evaluate {path} --episodes 200\n"
        "      .venv/bin/shes --help",
        highlight=False,
        soft_wrap=True,
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
