"""Checkpoints: the whole state of a run after a generation, in one `.npz` without pickle."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np

from shes.errors import CheckpointError, ConfigError
from shes.storage import write_atomically

__all__ = ["Best", "Checkpoint", "CheckpointWriter", "load_checkpoint", "restore", "save_checkpoint"]

StateT = TypeVar("StateT")

FORMAT = 2
_OWN = ("format", "best_generation", "best_score", "best_return", "settings")
"""Arrays that do not belong to the algorithm."""
_END_OF_ZIP = 22  # bytes of the end-of-central-directory record of a zip file without a comment
# Raised by NumPy and zipfile for a file that is truncated, damaged, or of another kind.
_DAMAGES = (
    AttributeError,
    EOFError,
    KeyError,
    NotImplementedError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)


@dataclass(frozen=True, kw_only=True)
class Best:
    """The best evaluation so far, by score; ties go to the higher return, then to the later evaluation."""

    generation: int = -1
    score: float = -np.inf
    mean_return: float = -np.inf

    def is_beaten_by(self, score: float, mean_return: float) -> bool:
        """Return whether a later evaluation with this score and return replaces it."""
        return (score, mean_return) >= (self.score, self.mean_return)


@dataclass(frozen=True, kw_only=True, eq=False)
class Checkpoint:
    """The state of a run after a generation."""

    arrays: Mapping[str, np.ndarray]
    """State of the algorithm, from its `to_arrays`."""
    best: Best
    numbers: dict[str, Any]
    """Settings that change numbers: a checkpoint continues only the run that wrote it."""

    @property
    def generation(self) -> int:
        """Number of finished generations."""
        return int(self.arrays["generation"])

    @property
    def env_steps(self) -> int:
        """Environment steps of training."""
        return int(self.arrays["env_steps"])


def _arrays(checkpoint: Checkpoint) -> dict[str, np.ndarray]:
    """Return all arrays of the file.

    Raises:
        ConfigError: The algorithm uses a reserved name.
    """
    best = checkpoint.best
    own = {
        "format": np.int64(FORMAT),
        "best_generation": np.int64(best.generation),
        "best_score": np.float64(best.score),
        "best_return": np.float64(best.mean_return),
        "settings": np.array(json.dumps(checkpoint.numbers, sort_keys=True)),
    }
    taken = sorted(own.keys() & checkpoint.arrays.keys())
    if taken:
        raise ConfigError(
            f"the algorithm's to_arrays() names an array {', '.join(taken)}, which the checkpoint reserves. "
            "Choose another name."
        )
    return {name: np.asarray(value) for name, value in {**own, **checkpoint.arrays}.items()}


def save_checkpoint(path: Path, checkpoint: Checkpoint, *, is_compressed: bool = False) -> None:
    """Write `checkpoint` to `path`, atomically.

    Raises:
        StorageError: The file cannot be written; an earlier file at `path` is unchanged.
    """

    def write(file: IO[bytes]) -> None:
        save = np.savez_compressed if is_compressed else np.savez
        save(file, allow_pickle=False, **_arrays(checkpoint))  # type: ignore[arg-type] - savez takes any name

    write_atomically(path, write)


def load_checkpoint(path: Path) -> Checkpoint:
    """Read the checkpoint at `path`, without executing code from it.

    Raises:
        CheckpointError: The file is missing, truncated, or not a checkpoint of this version.
    """
    if not path.is_file():
        others = sorted(other.stem for other in path.parent.glob("*.npz")) if path.parent.is_dir() else []
        there = f" There are: {', '.join(others)}." if others else ""
        raise CheckpointError(
            f"there is no checkpoint {path}.{there} Choose one with --checkpoint; "
            "to resume from it, copy it to last.npz."
        )
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
            _check_count(file, len(arrays))
        return _from_arrays(arrays, path)
    except _DAMAGES as error:
        raise _damaged(path, error) from error


def _check_count(file: IO[bytes], count: int) -> None:
    """Check that the zip file has as many members as its end record says: a damaged directory may lack some.

    Raises:
        ValueError: It has not.
    """
    file.seek(-_END_OF_ZIP, os.SEEK_END)
    written = int.from_bytes(file.read(_END_OF_ZIP)[10:12], "little")
    if written != count:
        raise ValueError(f"{count} of {written} arrays can be read")


def _damaged(path: Path, error: Exception) -> CheckpointError:
    return CheckpointError(
        f"{path} is not a whole SHES checkpoint ({type(error).__name__}: {error}). It may be truncated or another "
        "program's file. Take another one with --checkpoint last, best or a generation; "
        "to resume from another one, copy it over last.npz."
    )


def _from_arrays(arrays: dict[str, np.ndarray], path: Path) -> Checkpoint:
    """Return the checkpoint from the result of `_arrays`."""
    version = int(arrays["format"])
    if version != FORMAT:
        raise CheckpointError(
            f"{path} has checkpoint format {version}; this version of SHES reads {FORMAT}. "
            "Use the version that wrote it (config.json of the run names it)."
        )
    missing = [name for name in ("seed", "generation", "env_steps", *_OWN) if name not in arrays]
    if missing:
        raise KeyError(", ".join(missing))
    return Checkpoint(
        arrays={name: array for name, array in arrays.items() if name not in _OWN},
        best=Best(
            generation=int(arrays["best_generation"]),
            score=float(arrays["best_score"]),
            mean_return=float(arrays["best_return"]),
        ),
        numbers=json.loads(str(arrays["settings"])),
    )


def restore(checkpoint: Checkpoint, from_arrays: Callable[[Mapping[str, np.ndarray]], StateT], path: Path) -> StateT:
    """Return the algorithm's state in `checkpoint`, which was read from `path`.

    Raises:
        CheckpointError: The arrays do not fit the algorithm.
    """
    try:
        return from_arrays(checkpoint.arrays)
    except CheckpointError as error:
        raise CheckpointError(f"{path} {error}") from error
    except _DAMAGES as error:
        raise _damaged(path, error) from error


class CheckpointWriter:
    """Writes checkpoints in a thread of its own, one at a time and in order."""

    def __init__(self) -> None:
        """Start the writing thread."""
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="shes-checkpoint")
        self._last: Future[None] | None = None

    def write(self, paths: list[Path], checkpoint: Checkpoint) -> None:
        """Start writing `checkpoint` to every path of `paths`, in order, after the previous one is written.

        Raises:
            StorageError: The previous checkpoint could not be written.
        """
        self.wait()
        self._last = self._pool.submit(self._write_all, paths, checkpoint)

    def wait(self) -> None:
        """Wait until the last checkpoint is on disk.

        Raises:
            StorageError: It could not be written.
        """
        last, self._last = self._last, None
        if last is not None:
            last.result()

    def close(self) -> None:
        """Write the last checkpoint and end the thread."""
        try:
            self.wait()
        finally:
            self._pool.shutdown()

    @staticmethod
    def _write_all(paths: list[Path], checkpoint: Checkpoint) -> None:
        for path in paths:
            save_checkpoint(path, checkpoint)
