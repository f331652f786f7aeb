"""`make demo`: an ant learns to walk and then to collect food, with results and videos before and after training.

`python -m shes.cli.demo point` does the same with a point robot. What takes seconds to import is imported where it is
used, so that Ctrl-C before is no traceback.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from time import monotonic
from typing import Any

from rich.console import Console

import shes
from shes.cli.program import INTERRUPTED, exit_code
from shes.console import LineConsole

__all__ = ["main"]

EPISODES = 50
GATHER_MINUTES = 1.25
"""Training time of the ant's controller; with that of the walker the demo stays below four minutes."""
_WALKING = {"camera": "follow", "steps": 100}
_GATHERING = {"camera": "top", "speed": 2.0}
"""Views of the videos. Without a GPU a view from above is drawn three times as fast as the one that follows the robot,
which has shadows. With half of the frames, too, a whole episode of 50 s is drawn in 20 s on two cores."""

_BEFORE_AFTER = ("0", "best")  # checkpoints
_SEED = 0  # of the fresh episodes: both checkpoints are evaluated and drawn in the same ones


def main() -> int:
    """Run the demo in the working directory; return the exit code."""
    return exit_code(lambda: _demo(sys.argv[1] if len(sys.argv) > 1 else "ant"))


def _demo(robot: str) -> int:
    """Run the demo of `robot`; return the exit code."""
    console, start = LineConsole(), monotonic()
    if robot not in _DEMOS:
        print(f"unknown robot {robot!r}; there are demos of {' and '.join(_DEMOS)}", file=sys.stderr)
        return 2
    folder = Path("runs") / f"demo-{datetime.now().astimezone():%Y%m%d-%H%M%S}"
    try:
        last = _DEMOS[robot](console, folder)
    except KeyboardInterrupt:
        kept = f"; the runs so far are in {folder}" if folder.exists() else " before the first run"
        console.print(f"Stopped{kept}.", highlight=False, soft_wrap=True)
        return INTERRUPTED
    from shes.runs.progress_display import format_duration

    console.print(
        f"\nThe demo took {format_duration(monotonic() - start)}.\n"
        f"Next: .venv/bin/shes resume {last} --generations 200   (continues training)\n"
        f"      .venv/bin/shes evaluate {last} --episodes 200\n"
        "      .venv/bin/shes --help",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )
    return 0


def _ant(console: Console, folder: Path) -> Path:
    """Train a walker and then a controller for it; return the controller's run folder."""
    walker, gather = folder / "walker", folder / "gather"
    console.print(
        "An ant learns, by evolution, first to walk to goals (a minute on two cores), then to collect food (+1) and "
        "leave poison (-1): a controller sets the goals. Under four minutes; Ctrl-C stops and keeps everything.",
        highlight=False,
    )
    _learn(console, "ant-flagrun", walker)
    typical_walk = _show(
        console, walker, "return on moving goals (untrained it stands: 0)", lambda found: found.returns
    )
    _learn(console, "ant-gather", gather, primitive=walker, minutes=GATHER_MINUTES)
    typical_search = _show(console, gather, "score on Gather (8 is the most there is)", lambda found: found.scores)
    _draw(console, walker, folder / "walking.mp4", episode=typical_walk, **_WALKING)
    _draw(console, gather, folder / "gathering.mp4", episode=typical_search, **_GATHERING)
    return gather


def _point(console: Console, folder: Path) -> Path:
    """Train both levels of a point robot; return the run folder."""
    console.print(
        "A point robot learns, by evolution, to collect food (+1) and leave poison (-1): a controller that sets goals, "
        "and a primitive that reaches them. Two to three minutes on two cores; Ctrl-C stops and keeps everything.",
        highlight=False,
    )
    _learn(console, "point-gather", folder)
    typical_search = _show(console, folder, "score (8 is the most there is)", lambda found: found.scores)
    _draw(console, folder, folder / "gathering.mp4", episode=typical_search, **_GATHERING)
    return folder


_DEMOS: dict[str, Callable[[Console, Path], Path]] = {"ant": _ant, "point": _point}


def _learn(console: Console, env: str, path: Path, **settings: Any) -> None:
    """Train on `env` with live progress."""
    from shes.runs.progress_display import ProgressDisplay

    with ProgressDisplay(console) as display:
        shes.train(env, out=path, listener=display, progress=False, **settings)


def _show(console: Console, path: Path, what: str, results: Callable[[Any], Any]) -> int:
    """Print the mean of a result of the run at `path` on fresh episodes, before and after training.

    Return the index of a typical episode: after training, its result is the nearest to the mean.
    """
    before, after = (
        results(shes.evaluate(path, episodes=EPISODES, checkpoint=name, seed=_SEED)) for name in _BEFORE_AFTER
    )
    console.print(
        f"\nMean {what}, {EPISODES} fresh episodes: {before.mean():.2f} before training, {after.mean():.2f} after.\n"
    )
    return int(abs(after - after.mean()).argmin())


def _draw(console: Console, path: Path, video: Path, **view: Any) -> None:
    """Draw curves, and a video before and after training, of the run at `path`, with live progress."""
    from shes.runs.progress_display import drawing_progress

    console.print(f"Drawing the untrained and the trained agent {video.stem} ...", highlight=False)
    curves = shes.plot([path], path / "curves.png")
    with drawing_progress(console, video.stem) as on_step:
        shes.render(path, video, checkpoints=_BEFORE_AFTER, seed=_SEED, size=400, on_step=on_step, **view)
    console.print(f"{video.stem}: {video}   curves: {curves}", markup=False, highlight=False, soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main())
