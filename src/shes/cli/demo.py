"""`shes demo`: a robot learns to collect food, with results and videos before and after training."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping
from datetime import datetime
from functools import partial
from pathlib import Path
from time import monotonic
from types import MappingProxyType
from typing import Any, NamedTuple

import shes
from shes.console import LineConsole
from shes.drawing.make_drawer import find_opengl
from shes.runs.progress_display import drawing_progress, format_duration

EPISODES = 25  # fresh ones, the same for every evaluation and video
_BEFORE_AFTER = ("0", "best")  # checkpoints


class Stage(NamedTuple):
    """A run of a demo, which uses the primitive of the one before, and what is shown of it."""

    name: str
    """Name of the run folder and of its video."""
    env: str
    column: str
    """Field of `Evaluation` whose mean is printed: `returns` or `scores`."""
    view: Mapping[str, Any]
    """Arguments of `render`."""
    settings: Mapping[str, Any] = MappingProxyType({})
    """Arguments of `train`."""


_TEXT = (
    "An ant learns, by evolution, first to walk to goals (a minute on two cores), then to collect food (+1, 8 pieces) "
    "and leave poison (-1): a controller sets the goals. Four minutes if idle; Ctrl-C stops and keeps everything."
)
STAGES = (
    Stage("walking", "ant-flagrun", "returns", {"camera": "follow", "steps": 100}),
    # From above: three times as fast without a GPU. Generations, not minutes: a slow machine shows the same.
    Stage("gathering", "ant-gather", "scores", {"camera": "top", "speed": 2.0}, {"generations": 20}),
)


def demo() -> None:
    """Train a robot that collects food, in minutes, and draw it before and after training.

    Everything is written below runs/ in the working directory.
    """
    find_opengl()  # an error before the training, not after it
    console, start = LineConsole(), monotonic()
    folder = Path("runs") / f"demo-{datetime.now().astimezone():%Y%m%d-%H%M%S}"
    console.print(_TEXT, highlight=False)
    try:
        typical, primitive = list[int](), dict[str, Any]()
        for stage in STAGES:
            typical.append(_learn(console, folder / stage.name, stage, primitive))
            primitive = {"primitive": folder / stage.name}
        for stage, episode in zip(STAGES, typical, strict=True):
            _draw(console, folder / stage.name, stage, episode)
    except KeyboardInterrupt as stop:
        stop.add_note(f"Stopped{f'; the runs so far are in {folder}' if folder.exists() else ''}.")
        raise
    last = folder / STAGES[-1].name
    program = "shes" if shutil.which("shes") else os.path.relpath(Path(sys.executable).with_name("shes"))
    console.print_line(
        f"\nThe demo took {format_duration(monotonic() - start)}.\n"
        f"Next: {program} resume {last} --generations 200   (continues training)\n"
        f"      {program} evaluate {last} --episodes 200\n"
        f"      {program} --help"
    )


def _learn(console: LineConsole, path: Path, stage: Stage, primitive: Mapping[str, Any]) -> int:
    """Train with live progress, print the means before and after; return the trained episode nearest to the mean."""
    shes.train(stage.env, out=path, progress=True, **stage.settings, **primitive)
    evaluate = partial(shes.evaluate, path, episodes=EPISODES, seed=0)
    before, after = (getattr(evaluate(checkpoint=name), stage.column) for name in _BEFORE_AFTER)
    means = f"{before.mean():.2f} before training, {after.mean():.2f} after"
    if stage.column == "scores":
        constant, random = (evaluate(controller=name).scores.mean() for name in ("constant", "random"))
        means += f"; with constant goals {constant:.2f}, with random ones {random:.2f}"
    console.print_line(f"\nMean {stage.column[:-1]} of {EPISODES} fresh episodes: {means}.\n")
    return int(abs(after - after.mean()).argmin())


def _draw(console: LineConsole, path: Path, stage: Stage, episode: int) -> None:
    """Draw curves, and a video of an episode before and after training, of the run at `path`, with live progress."""
    console.print_line(f"Drawing the untrained and the trained agent {stage.name} ...")
    curves = shes.plot([path], path / "curves.png")
    video = path.with_suffix(".mp4")
    with drawing_progress(console, stage.name) as on_step:
        shown = {"checkpoints": _BEFORE_AFTER, "episode": episode, "seed": 0, "size": 400, "on_step": on_step}
        shes.render(path, video, **shown, **stage.view)
    console.print_line(f"{stage.name}: {video}   curves: {curves}")
