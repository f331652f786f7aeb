"""Writes .mp4 and .gif videos with the ffmpeg of imageio-ffmpeg."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

import imageio_ffmpeg

from shes.drawing.drawer import Picture
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
_SHOWN_LOG = 300  # last characters of ffmpeg's log in an error message


def check_video_path(path: Path) -> None:
    """Raise ConfigError for an unknown suffix, a folder, a path without its folder, or if ffmpeg is missing."""
    if path.suffix.lower() not in _ENCODERS:
        raise ConfigError(f"a video must end in {' or '.join(_ENCODERS)}, got {str(path)!r}. Set --out.")
    if not path.parent.is_dir():
        raise ConfigError(f"there is no folder {path.parent}. Create it, or choose another path with --out.")
    if path.is_dir():
        raise ConfigError(f"{path} is a folder. Choose another path with --out.")
    _find_ffmpeg()


def write_video(path: Path, frames: Iterable[Picture]) -> None:
    """Write `frames` (pictures [H, W, 3] of one even size) to `path`, atomically.

    Raises:
        StorageError: The video cannot be encoded or written; a file at `path` is unchanged.
    """
    check_video_path(path)
    with tempfile.TemporaryDirectory(prefix="shes-video-") as folder:
        file = Path(folder) / f"video{path.suffix.lower()}"
        said = _encode(file, frames)
        if said is not None:
            raise StorageError(
                f"ffmpeg could not encode {path}; what was there before is untouched. It said: {said or 'nothing'}. "
                f"If the temporary folder {Path(folder).parent} is full, set TMPDIR to another one."
            )
        with file.open("rb") as source:
            write_atomically(path, lambda target: shutil.copyfileobj(source, target))


def _find_ffmpeg() -> str:
    """Return the path of ffmpeg; raise a ConfigError if it is missing."""
    try:
        found = imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        found, reason = None, error
    else:
        reason = f"{found} is not there"
    if found is None or shutil.which(found) is None:
        raise ConfigError(
            f"there is no ffmpeg: {reason}. Reinstall it by `pip install --force-reinstall imageio-ffmpeg`, or set "
            "IMAGEIO_FFMPEG_EXE to the path of one."
        )
    return found


def _encode(file: Path, frames: Iterable[Picture]) -> str | None:
    """Encode `frames` into `file`; return None, or the end of ffmpeg's log if it fails."""
    stream = iter(frames)
    first = next(stream)
    size = f"{first.shape[1]}x{first.shape[0]}"
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", str(FRAMES_PER_SECOND), "-i", "-"]
    command = [_find_ffmpeg(), "-v", "error", "-y", *raw, *_ENCODERS[file.suffix], str(file)]
    # In its own session, so that Ctrl-C reaches only this process, which then kills ffmpeg.
    with (
        tempfile.TemporaryFile() as log,
        subprocess.Popen(command, stdin=subprocess.PIPE, stderr=log, start_new_session=True) as encoder,
    ):
        assert encoder.stdin is not None
        is_broken = False
        try:
            for frame in chain([first], stream):
                encoder.stdin.write(frame.tobytes())
            encoder.stdin.close()
        except BrokenPipeError:
            is_broken = True
        except BaseException:
            encoder.kill()
            raise
        status = encoder.wait()
        if status == 0 and not is_broken and file.exists():
            return None
        log.seek(0)
        return " ".join(log.read().decode(errors="replace").split())[-_SHOWN_LOG:]
