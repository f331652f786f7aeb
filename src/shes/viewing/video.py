"""Frames with captions, and .mp4 and .gif videos of them by the ffmpeg of imageio-ffmpeg."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from subprocess import PIPE

import imageio_ffmpeg
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from shes.drawing.renderer import Picture
from shes.errors import ConfigError, StorageError
from shes.storage import write_atomically

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
