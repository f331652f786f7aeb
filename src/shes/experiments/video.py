"""Video files: frames become an .mp4 or a .gif, by the ffmpeg that imageio-ffmpeg brings."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path

import imageio_ffmpeg
import numpy as np

from shes.drawing.renderer import Picture
from shes.errors import ConfigError, ShesError, StorageError
from shes.storage import write_atomically

__all__ = ["FRAMES_PER_SECOND", "check_video_path", "write_video"]

FRAMES_PER_SECOND = 20
"""Two for each control step. A GIF can show no 30: it counts in hundredths of a second."""
_SUFFIXES = (".mp4", ".gif")
# One palette for all frames, made from what moves.
_GIF_FILTER = (
    "split[a][b];[a]palettegen=stats_mode=diff[p];[b][p]paletteuse=dither=bayer:bayer_scale=4:diff_mode=rectangle"
)


def check_video_path(path: Path) -> None:
    """Refuse a path that no video can be written to, before work goes into it.

    Raises:
        ConfigError: Its suffix is not known, or there is no such folder.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise ConfigError(f"a video must end in {' or '.join(_SUFFIXES)}, got {str(path)!r}. Set --out.")
    if not path.parent.is_dir():
        raise ConfigError(f"there is no folder {path.parent}. Create it, or choose another path with --out.")
    if path.is_dir():
        raise ConfigError(f"{path} is a folder. Choose another path with --out.")


def write_video(path: Path, frames: Iterable[Picture]) -> None:
    """Write `frames` (pictures [H, W, 3] of one even size) to `path`, atomically.

    Raises:
        ConfigError: The suffix of `path` is not known.
        StorageError: The file cannot be written.
    """
    check_video_path(path)
    with tempfile.TemporaryDirectory(prefix="shes-video-") as folder:
        file = Path(folder) / f"video{path.suffix.lower()}"
        try:
            _encode(file, frames)
        except OSError as error:
            if isinstance(error, ShesError):  # from whoever makes the frames
                raise
            raise _encoding_error(path, folder) from error
        if not file.exists() or not file.stat().st_size:
            raise _encoding_error(path, folder)
        with file.open("rb") as source:
            write_atomically(path, lambda target: shutil.copyfileobj(source, target))


def _encoding_error(path: Path, folder: str) -> StorageError:
    return StorageError(
        f"ffmpeg could not write the frames of {path}; what was there before is untouched. Is the temporary folder "
        f"{Path(folder).parent} full? TMPDIR names another one."
    )


def _encode(file: Path, frames: Iterable[Picture]) -> None:
    """Let ffmpeg write `file`."""
    is_gif = file.suffix == ".gif"
    writer = None
    try:
        for frame in frames:
            if writer is None:
                writer = imageio_ffmpeg.write_frames(
                    file,
                    (frame.shape[1], frame.shape[0]),
                    fps=FRAMES_PER_SECOND,
                    codec="gif" if is_gif else "libx264",
                    pix_fmt_out="pal8" if is_gif else "yuv420p",
                    quality=7,
                    macro_block_size=2,
                    ffmpeg_log_level="error",
                    output_params=["-vf", _GIF_FILTER] if is_gif else ["-movflags", "+faststart"],
                )
                writer.send(None)
            writer.send(np.ascontiguousarray(frame))
    finally:
        if writer is not None:
            writer.close()
