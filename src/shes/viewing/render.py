"""`shes render`: a video of one episode, of one agent or of several side by side."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from shes.checked import checked
from shes.drawing.drawer import Drawer, Picture
from shes.drawing.rendering import make_drawer
from shes.errors import ConfigError
from shes.runs.folder import RunFolder
from shes.settings import Ge, Le, Lt, out_of_range
from shes.viewing.caption import captioned
from shes.viewing.playback import Moment, Playback
from shes.viewing.video import FRAMES_PER_SECOND, check_video_path, write_video

_MOST = 100_000  # steps and episodes; a video of so many steps takes a day
_HELD_S = 0.7  # time for which the last frame is held


@checked
def render(
    runs: Path | str | Sequence[Path | str],
    out: Path | str = "walk.mp4",
    *,
    checkpoints: str | Sequence[str] = ("best",),
    labels: str | Sequence[str] = (),
    camera: Literal["both", "follow", "top"] = "both",
    episode: Annotated[int, Ge(0), Lt(_MOST)] = 0,
    seed: Annotated[int, Ge(0)] | None = None,
    size: Annotated[int, Ge(64), Le(1080)] = 480,
    steps: Annotated[int, Ge(1), Lt(_MOST)] | None = None,
    speed: Annotated[float, Ge(0.1), Le(100)] = 1.0,
    sensors: bool = False,
    on_step: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a video of an episode. Several runs or checkpoints are shown side by side.

    The episode is one of those that `evaluate` runs; it has the same seed for all. Poses between control steps are
    interpolated. An external environment draws itself, with its own camera and without goals. Needs no screen: EGL or
    OSMesa draws, whichever works (MUJOCO_GL decides if it is set); without either the pictures are flat. Without a
    graphics card 500 control steps take a minute or two.

    shes render runs/first --checkpoint 0 best --camera follow

    shes render runs/first ant-gather --labels "my ant" shipped

    Args:
        runs: Run folders, or names of shipped agents. A run may be given several times.
        out: Path of the video, .mp4 or .gif.
        checkpoints: Checkpoints: `best`, `last` or numbers of generations. For one run, any number; for several, one
            for all or one for each.
        labels: Label of each run or checkpoint that is shown; by default several runs have their names.
        camera: Camera.
        episode: Index of the episode among those of `evaluate`.
        seed: Seed of the episodes, as for `evaluate`.
        size: Height and width of a view in pixels; even.
        steps: Maximum number of control steps; those of an evaluation if None.
        speed: Seconds of the episode in a second of the video; a faster video has fewer frames and is drawn sooner.
        sensors: Whether to show what the controller sees, in words, and what the agent's sensors read, if it has any
            (Gather).
        on_step: Called with the number of control steps drawn and their maximum.

    Returns:
        Path of the video.

    Raises:
        RunFolderError: One of `runs` is neither a run folder nor a shipped agent.
        CheckpointError: A checkpoint is missing or damaged.
        UnknownNameError: There is no such `camera`.
        ConfigError: There is no run, the numbers of runs, checkpoints and labels do not go together, another argument
            is out of range, or the environment has no pictures.
        StorageError: The video cannot be written.
    """
    target = Path(out)
    check_video_path(target)
    if size % 2:
        raise out_of_range("size", size, "an even number of pixels")
    shown = _shown(runs, checkpoints, labels)
    for run, *_ in shown:
        RunFolder.open(run, or_several=True)
    playbacks = [Playback(run, name, seed, steps, label=label, sensors=sensors) for run, name, label in shown]
    drawers: list[Drawer] = []
    try:
        episode_seed = playbacks[0].seed_of(episode)
        drawers.extend(make_drawer(each.task, size, size) for each in playbacks)
        cameras = [_cameras(drawer, camera) for drawer in drawers]
        episodes = [each.play(episode_seed) for each in playbacks]
        if on_step is not None:
            episodes[0] = _counted(episodes[0], playbacks[0].steps, on_step)
        columns = [
            _frames(moments, drawer, names, FRAMES_PER_SECOND * playback.task.step_s / speed)
            for moments, drawer, names, playback in zip(episodes, drawers, cameras, playbacks, strict=True)
        ]
        if len(columns) == 1:
            frames = (np.hstack(views) for views in columns[0])
        else:
            most = max(map(len, cameras))
            frames = _side_by_side([(_stacked(views, most) for views in column) for column in columns])
        write_video(target, _held(frames, round(_HELD_S * FRAMES_PER_SECOND)))
    finally:
        for each in (*drawers, *(playback.task for playback in playbacks)):
            each.close()
    return target


def _shown(
    runs: Path | str | Sequence[Path | str], checkpoints: str | Sequence[str], labels: str | Sequence[str]
) -> list[tuple[Path | str, str, str]]:
    """Return run, checkpoint and label of each column of the video; raise ConfigError if their numbers do not fit."""
    given = [runs] if isinstance(runs, str | os.PathLike) else list(runs)
    names = [checkpoints] if isinstance(checkpoints, str) else list(map(str, checkpoints))
    texts = [labels] if isinstance(labels, str) else list(labels)
    if not given:
        raise ConfigError("render needs at least one run: shes render RUN... --out walk.mp4")
    if not names:
        raise ConfigError(
            "render needs at least one checkpoint: best, last or the number of a generation. Set --checkpoint."
        )
    count = max(len(given), len(names))
    if len(given) not in (1, count) or len(names) not in (1, count):
        raise ConfigError(
            f"{len(given)} runs need one checkpoint for all or one for each, got {len(names)}: {', '.join(names)}. "
            "Set --checkpoint."
        )
    if texts and len(texts) != count:
        raise ConfigError(
            f"there must be one label for each of the {count} agents in the video, got {len(texts)}: "
            f"{', '.join(texts)}. Set --labels."
        )
    if not texts:
        texts = _names(given) if len(given) > 1 else [""] * count
    one_each = given * count if len(given) == 1 else given
    name_each = names * count if len(names) == 1 else names
    return list(zip(one_each, name_each, texts, strict=True))


def _names(runs: Sequence[Path | str]) -> list[str]:
    """Return the names of the runs' folders, or their paths if different runs have the same name."""
    names = [Path(run).name for run in runs]
    return names if len(set(names)) == len(set(map(str, runs))) else list(map(str, runs))


def _counted(moments: Iterator[Moment], steps: int, on_step: Callable[[int, int], None]) -> Iterator[Moment]:
    for number, moment in enumerate(moments):
        yield moment
        on_step(number, steps)


def _cameras(drawer: Drawer, asked: str) -> Sequence[str]:
    """Return the cameras to draw with; raise a ConfigError if the environment draws itself and lacks `asked`."""
    if asked == "both":
        return drawer.cameras
    if asked not in drawer.cameras:
        raise ConfigError(f"this environment draws itself and has no camera {asked!r}. Omit --camera.")
    return (asked,)


def _frames(
    moments: Iterator[Moment], drawer: Drawer, cameras: Sequence[str], frames_per_step: float
) -> Iterator[list[Picture]]:
    """Yield the views of an episode, frame by frame; the first view has the caption.

    If `frames_per_step` is not a whole number, steps differ in their number of frames. The last step has at least one.
    """
    before: Moment | None = None
    is_shown = False
    for step, moment in enumerate(moments):
        start = moment if before is None else before
        frames = round((step + 1) * frames_per_step) - round(step * frames_per_step)
        for frame in range(1, frames + 1):
            pose = drawer.between(start.pose, moment.pose, frame / frames)
            views = [drawer.draw(pose, moment.markers, camera) for camera in cameras]
            yield [captioned(views[0], [moment.facts, moment.seen]), *views[1:]]
        before, is_shown = moment, frames > 0
    if before is not None and not is_shown:
        views = [drawer.draw(before.pose, before.markers, camera) for camera in cameras]
        yield [captioned(views[0], [before.facts, before.seen]), *views[1:]]


def _side_by_side(columns: Sequence[Iterator[Picture]]) -> Iterator[Picture]:
    """Yield the columns' frames side by side; a column that has ended keeps its last frame."""
    shown: list[Picture] = []
    for frames in zip_longest(*columns):
        shown = [frame if frame is not None else shown[i] for i, frame in enumerate(frames)]
        yield np.hstack(shown)


def _stacked(views: Sequence[Picture], count: int) -> Picture:
    """Return `views` above each other, with black ones below them up to `count`."""
    return np.vstack([*views, *[np.zeros_like(views[0])] * (count - len(views))])


def _held(frames: Iterator[Picture], count: int) -> Iterator[Picture]:
    """Yield `frames`, then the last one `count` more times."""
    last: Picture | None = None
    for frame in frames:
        last = frame
        yield frame
    if last is not None:
        yield from [last] * count
