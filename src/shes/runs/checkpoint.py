"""Checkpoints: the whole state of a run after a generation, in one `.npz` without pickle."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, TypeAlias, TypeVar

import numpy as np

from shes.errors import CheckpointError, ConfigError
from shes.storage import write_atomically
from shes.types import ArrayHeader

StateT = TypeVar("StateT")

FORMAT = 2
_OWN = ("format", "best_generation", "best_score", "best_return", "settings")
"""Arrays that do not belong to the algorithm."""
_OF_EVERY_ALGORITHM = ("seed", "generation", "env_steps")
_MOST_TEXT = 200  # characters of the cause in a message, which may quote the file

ArrayCheck: TypeAlias = Callable[[Mapping[str, ArrayHeader]], object]
"""Checks the names, shapes and types of an algorithm's arrays."""


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


def save_checkpoint(path: Path, checkpoint: Checkpoint, *, is_compressed: bool = False) -> None:
    """Write `checkpoint` to `path`, atomically; a StorageError leaves an earlier file at `path` unchanged."""
    best = checkpoint.best
    own = {
        "format": np.int64(FORMAT),
        "best_generation": np.int64(best.generation),
        "best_score": np.float64(best.score),
        "best_return": np.float64(best.mean_return),
        "settings": np.array(json.dumps(checkpoint.numbers, sort_keys=True)),
    }
    if taken := sorted(own.keys() & checkpoint.arrays.keys()):
        raise ConfigError(
            f"the algorithm's to_arrays() names an array {', '.join(taken)}, which the checkpoint reserves. "
            "Choose another name."
        )
    arrays = {name: np.asarray(value) for name, value in {**own, **checkpoint.arrays}.items()}

    def write(file: IO[bytes]) -> None:
        save = np.savez_compressed if is_compressed else np.savez
        save(file, allow_pickle=False, **arrays)  # type: ignore[arg-type] - savez takes any name

    write_atomically(path, write)


def load_checkpoint(path: Path, check: ArrayCheck | None = None, *, with_state: bool = True) -> Checkpoint:
    """Read the checkpoint at `path`, without executing code from it.

    Args:
        path: The file.
        check: Raises CheckpointError if the algorithm's arrays have other names, shapes or types than it expects.
        with_state: Whether to read all arrays. Otherwise only those that every checkpoint has are read, which is quick.

    Raises:
        CheckpointError: The file is missing, truncated, or not a checkpoint of this version.
    """
    if not path.is_file():
        others = sorted(other.stem for other in path.parent.glob("*.npz") if other.is_file())
        there = f" There are: {', '.join(others)}." if others else ""
        raise CheckpointError(
            f"there is no checkpoint {path}.{there} Choose one with --checkpoint; "
            "to resume from it, copy it to last.npz."
        )
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            names = file.files if with_state else (*_OWN, *_OF_EVERY_ALGORITHM)
            arrays = {name: file[name] for name in names}
        own = {name: arrays.pop(name).item() for name in _OWN}
        _check_format(own["format"])
        if check is not None:
            check(arrays)
        return _checkpoint(own, arrays)
    except CheckpointError as error:
        raise CheckpointError(f"{path} {error}") from error
    except Exception as error:  # NumPy and zipfile raise errors of a dozen kinds for a damaged file
        raise _damaged(path, error) from error


def _check_format(version: int) -> None:
    if version != FORMAT:
        raise CheckpointError(
            f"has checkpoint format {version}; this version of SHES reads {FORMAT}. "
            "Use the version that wrote it (config.json of the run names it)."
        )


def _checkpoint(own: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Checkpoint:
    """Return the checkpoint with these arrays; raise ValueError if no run can have written it."""
    best = Best(generation=own["best_generation"], score=own["best_score"], mean_return=own["best_return"])
    if min(*(int(arrays[name].item()) for name in _OF_EVERY_ALGORITHM), best.generation + 1) < 0:
        raise ValueError("a count is negative")
    if not (best.score < np.inf and best.mean_return < np.inf):
        raise ValueError("the best score or return is NaN or infinity")
    return Checkpoint(arrays=arrays, best=best, numbers=dict(json.loads(own["settings"])))


def restore(checkpoint: Checkpoint, from_arrays: Callable[[Mapping[str, np.ndarray]], StateT], path: Path) -> StateT:
    """Return the algorithm's state in `checkpoint`, read from `path`; raise CheckpointError if it does not fit."""
    try:
        return from_arrays(checkpoint.arrays)
    except CheckpointError as error:
        raise CheckpointError(f"{path} {error}") from error
    except Exception as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> CheckpointError:
    text = " ".join(str(error).split())[:_MOST_TEXT]
    return CheckpointError(
        f"{path} is not a whole SHES checkpoint ({type(error).__name__}: {text}). It may be truncated or another "
        "program's file. Take another one with --checkpoint last, best or a generation; "
        "to resume from another one, copy it over last.npz."
    )
