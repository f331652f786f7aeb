"""`shes render`: a video of one episode, of one agent or of several side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from itertools import repeat, zip_longest
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from shes.drawing.make_drawer import Drawer, make_drawer
from shes.drawing.renderer import Picture
from shes.errors import ConfigError
from shes.settings import Ge, Le, Lt, checked, out_of_range
from shes.viewing.playback import Playback
from shes.viewing.video import FRAMES_PER_SECOND, captioned, check_video_path, write_video

_MOST = 100_000  # steps and episodes; a video of so many steps takes a day
_HELD_FRAMES = 1 + round(0.7 * FRAMES_PER_SECOND)  # of the last frame


@checked
def render(
    runs: Path | str | Sequence[Path | str],
    out: Path | str = "walk.mp4",
    *,
    checkpoints: str | Sequence[str] = ("best",),
    camera: Literal["both", "follow", "top"] = "both",
    episode: Annotated[int, Ge(0), Lt(_MOST)] = 0,
    seed: Annotated[int, Ge(0)] | None = None,
    size: Annotated[int, Ge(64), Le(1080)] = 480,
    steps: Annotated[int, Ge(1), Lt(_MOST)] | None = None,
    speed: Annotated[float, Ge(0.1), Le(100)] = 1.0,
    sensors: bool = False,
    on_step: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a video of an episode; return its path. Several runs or checkpoints are shown side by side.

    The episode is one of those that `evaluate` runs, the same for all. An external environment draws itself, with its
    own camera and without goals. Needs no screen: EGL or OSMesa draws (MUJOCO_GL decides if it is set); without either
    the pictures are flat. Without a graphics card 500 control steps take a minute or two.

    shes render runs/first --checkpoint 0 best --camera follow

    shes render runs/first ant-gather

    Args:
        runs: Run folders, or names of shipped agents. A run may be given several times.
        out: Path of the video, .mp4 or .gif.
        checkpoints: Checkpoints: `best`, `last` or numbers of generations. For one run, any number; for several, one
            for all or one for each.
        camera: Camera.
        episode: Index of the episode among those of `evaluate`.
        seed: Seed of the episodes, as for `evaluate`.
        size: Height and width of a view in pixels; even.
        steps: Maximum number of control steps; those of an evaluation if None.
        speed: Seconds of the episode in a second of the video; a faster video has fewer frames and is drawn sooner.
        sensors: Whether to show what the controller sees, in words, and what the agent's sensors read, if it has any
            (Gather).
        on_step: Called with the number of control steps drawn and their maximum.
    """
    target = Path(out)
    check_video_path(target)
    if size % 2:
        raise out_of_range("size", size, "an even number of pixels")
    shown = _shown(runs, checkpoints)
    playbacks = [Playback(run, name, seed, steps, label=label, sensors=sensors) for run, name, label in shown]
    episode_seed = playbacks[0].seed_of(episode)
    with ExitStack() as stack:
        columns: list[Iterator[list[Picture]]] = []
        for playback in playbacks:
            stack.callback(playback.task.close)
            drawer = make_drawer(playback.task, size, size)
            stack.callback(drawer.close)
            cameras = drawer.cameras if camera == "both" else (camera,)
            if not {*cameras} <= {*drawer.cameras}:
                raise ConfigError(f"this environment draws itself and has no camera {camera!r}. Omit --camera.")
            listener = on_step if playback is playbacks[0] else None
            columns.append(_frames(playback, episode_seed, drawer, cameras, speed, listener))
        write_video(target, _joined(columns))
    return target


def _shown(
    runs: Path | str | Sequence[Path | str], checkpoints: str | Sequence[str]
) -> list[tuple[Path | str, str, str]]:
    """Return run, checkpoint and label of each column of the video; raise ConfigError if their numbers do not fit."""
    given = [runs] if isinstance(runs, str | os.PathLike) else list(runs)
    names = [checkpoints] if isinstance(checkpoints, str) else list(map(str, checkpoints))
    if not given or not names:
        raise ConfigError("render needs at least one run and one checkpoint: shes render RUN... --checkpoint best")
    count = max(len(given), len(names))
    if {len(given), len(names)} - {1, count}:
        raise ConfigError(
            f"{len(given)} runs need one checkpoint for all or one for each, got {len(names)}: {', '.join(names)}. "
            "Set --checkpoint."
        )
    labels = [Path(run).name for run in given] if len(given) > 1 else [""]
    if len(set(labels)) < len(set(map(str, given))):  # different runs whose folders have the same name
        labels = list(map(str, given))
    return [(given[i % len(given)], names[i % len(names)], labels[i % len(labels)]) for i in range(count)]


def _frames(
    playback: Playback,
    seed: int,
    drawer: Drawer,
    cameras: Sequence[str],
    speed: float,
    on_step: Callable[[int, int], None] | None,
) -> Iterator[list[Picture]]:
    """Yield the views of an episode, frame by frame; the first view has the caption.

    Poses between control steps are interpolated. Where a step is not a whole number of frames, steps differ in their
    number of frames. The last step has at least one, which is held.
    """
    frames_per_step = FRAMES_PER_SECOND * playback.task.step_s / speed
    before: Any = None
    for number, step in enumerate(playback.play(seed)):
        start = step.pose if before is None else before
        frames = round((number + 1) * frames_per_step) - round(number * frames_per_step)
        frames = max(frames, int(step.is_last))
        for frame in range(1, frames + 1):
            pose = drawer.between(start, step.pose, frame / frames)
            views = [drawer.draw(pose, step.markers, camera) for camera in cameras]
            shown = [captioned(views[0], [step.facts, step.inputs]), *views[1:]]
            yield from repeat(shown, _HELD_FRAMES if step.is_last and frame == frames else 1)
        before = step.pose
        if on_step is not None:
            on_step(number, playback.steps)


def _joined(columns: Sequence[Iterator[list[Picture]]]) -> Iterator[Picture]:
    """Yield the frames of `columns` side by side; a column that has ended keeps its last frame.

    The views of a single column are side by side, otherwise above each other.
    """
    shown: list[list[Picture]] = []
    for frames in zip_longest(*columns):
        shown = [views if views is not None else shown[i] for i, views in enumerate(frames)]
        most = max(map(len, shown))
        padded = [[*views, *[np.zeros_like(views[0])] * (most - len(views))] for views in shown]
        yield np.hstack(padded[0]) if len(padded) == 1 else np.hstack([np.vstack(views) for views in padded])
