"""`shes render`: a video of one episode, of one agent or of several side by side.

The frames have captions. The ffmpeg of imageio-ffmpeg encodes .mp4 and .gif.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from itertools import chain, repeat, zip_longest
from pathlib import Path
from subprocess import PIPE
from typing import Annotated, Any, Literal

import imageio_ffmpeg
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from shes.drawing.make_drawer import Drawer, make_drawer
from shes.drawing.renderer import Picture, between
from shes.errors import ConfigError, StorageError
from shes.runs.shipped import find_run
from shes.settings import Ge, Le, Lt, checked, out_of_range
from shes.storage import write_atomically
from shes.viewing.playback import Playback

FRAMES_PER_SECOND = 20
"""Two frames per control step of 0.1 s. GIF times are multiples of 0.01 s, so 30 is not possible."""
# A GIF has one palette for all frames, made from what moves.
_PALETTE = (
    "split[a][b];[a]palettegen=stats_mode=diff[p];[b][p]paletteuse=dither=bayer:bayer_scale=4:diff_mode=rectangle"
)
_ENCODERS: dict[str, list[str]] = {
    ".mp4": ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart"],
    ".gif": ["-vf", _PALETTE],
}
_BAR, _INK = (28, 32, 38, 200), (240, 243, 246)
_SMALLEST, _LARGEST = 8, 14
"""Pixels of the font; in between, a picture has room for `_LETTERS`."""
_LETTERS = 48
_GAP = " · "
_SHOWN_LOG = 300  # last characters of ffmpeg's log in an error message
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
        sensors: Whether to show in words what the controller saw when it set its goal, and its sensors (Gather).
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
    given = list(runs) if isinstance(runs, Iterable) and not isinstance(runs, str) else [runs]
    names = [checkpoints] if isinstance(checkpoints, str) else list(map(str, checkpoints))
    if not given or not names:
        raise ConfigError("render needs at least one run and one checkpoint: shes render RUN... --checkpoint best")
    count = max(len(given), len(names))
    if {len(given), len(names)} - {1, count}:
        raise ConfigError(
            f"{len(given)} runs need one checkpoint for all or one for each, got {len(names)}: {', '.join(names)}. "
            "Set --checkpoint."
        )
    labels = [find_run(run).name for run in given] if len(given) > 1 else [""]
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
            pose = between(drawer.model, start, step.pose, frame / frames)
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


def captioned(view: Picture, paragraphs: Sequence[Sequence[str]]) -> Picture:
    """Return `view` with the parts of each paragraph in a bar over at most its upper half.

    Lines are broken between parts; a part that is longer than a line is shortened in its middle.
    """
    image = Image.fromarray(view)
    size = min(max(2 * image.width // _LETTERS, _SMALLEST), _LARGEST)
    font, step, edge = ImageFont.load_default(size), round(1.5 * size), size // 2

    def fits(text: str) -> bool:
        # Numbers have a constant width, so that lines are not broken at other places from frame to frame.
        return font.getlength(re.sub(r"-?\d+(?=\.\d)", "-00", text)) <= image.width - 2 * edge

    lines: list[str] = []
    for parts in paragraphs:
        first = len(lines)
        for part in parts:
            if len(lines) > first and fits(lines[-1] + _GAP + part):
                lines[-1] += _GAP + part
            else:
                shortened = (part, *(f"{part[:kept]}…{part[-kept:]}" for kept in range(len(part) // 2, 0, -1)))
                lines.append(next(filter(fits, shortened), "…"))
    del lines[max(1, image.height // 2 // step) :]
    draw = ImageDraw.Draw(image, "RGBA")
    draw.rectangle([0, 0, image.width, step * len(lines) + edge - 1], _BAR)
    for number, text in enumerate(lines):
        draw.text((edge, step * (number + 0.5) + edge / 2), text, _INK, font, anchor="lm")
    return np.asarray(image)


def check_target(path: Path, suffixes: Iterable[str]) -> None:
    """Raise ConfigError if no file with one of `suffixes` can be written to `path`."""
    if path.suffix.lower() not in suffixes:
        raise ConfigError(f"out must end in {' or '.join(suffixes)}, got {str(path)!r}. Set --out.")
    if not path.parent.is_dir():
        raise ConfigError(f"there is no folder {path.parent}. Create it, or choose another path with --out.")
    if path.is_dir():
        raise ConfigError(f"{path} is a folder. Choose another path with --out.")


def check_video_path(path: Path) -> str:
    """Return the path of ffmpeg; raise ConfigError if it is missing, or if no video can be written to `path`."""
    check_target(path, _ENCODERS)
    try:
        found = imageio_ffmpeg.get_ffmpeg_exe()
        reason = f"{found} is not there"
    except RuntimeError as error:
        found, reason = "", str(error)
    if shutil.which(found) is None:
        raise ConfigError(
            f"there is no ffmpeg: {reason}. Reinstall it by `pip install --force-reinstall imageio-ffmpeg`, or set "
            "IMAGEIO_FFMPEG_EXE to the path of one."
        )
    return found


def write_video(path: Path, frames: Iterable[Picture]) -> None:
    """Write `frames` (pictures [H, W, 3] of one even size) to `path`, atomically."""
    ffmpeg, stream = check_video_path(path), iter(frames)
    first = next(stream)
    size = f"{first.shape[1]}x{first.shape[0]}"
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(FRAMES_PER_SECOND), "-i", "-"]
    with tempfile.TemporaryDirectory(prefix="shes-video-") as folder:
        file = Path(folder) / f"video{path.suffix.lower()}"
        command = [ffmpeg, "-v", "error", *raw, *_ENCODERS[file.suffix], str(file)]
        # In its own session, so that Ctrl-C reaches only this process, which then kills ffmpeg.
        with subprocess.Popen(command, stdin=PIPE, stderr=PIPE, start_new_session=True) as encoder:
            assert encoder.stdin is not None
            try:
                with suppress(BrokenPipeError):  # it says why in its log
                    for frame in chain([first], stream):
                        encoder.stdin.write(frame.tobytes())
                log = encoder.communicate()[1].decode(errors="replace")
            finally:
                encoder.kill()  # unless it has ended
        if encoder.returncode or not file.exists():
            raise StorageError(
                f"ffmpeg could not encode {path}; what was there before is untouched. It said: "
                f"{' '.join(log.split())[-_SHOWN_LOG:] or 'nothing'}. If the temporary folder {Path(folder).parent} is "
                "full, set TMPDIR to another one."
            )
        write_atomically(path, lambda target: target.write(file.read_bytes()))
