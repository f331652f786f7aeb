"""Checkpoints: the whole state of a run after a generation, in one `.npz` without pickle."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import IO, Any, TypeAlias, TypeVar

import numpy as np

from shes.errors import CheckpointError, ConfigError
from shes.free_space import free_memory
from shes.runs.headers import SUFFIX, Header, read_headers
from shes.storage import write_atomically

StateT = TypeVar("StateT")

FORMAT = 2
_OWN = ("format", "best_generation", "best_score", "best_return", "settings")
"""Arrays that do not belong to the algorithm."""
_OWED = "owes_evaluation"
"""Scalar of a checkpoint whose state has yet to be evaluated; others lack it."""
_SCALARS = dict(zip((*_OWN, "seed", "generation", "env_steps"), "iiffUiii", strict=True))
"""Arrays of every checkpoint, all of them scalars, with the kind of their type."""
_MOST_SETTINGS = 2**22  # bytes
_MOST_TEXT = 200  # characters of the cause in a message, which may quote the file
_END_OF_ZIP = 22  # bytes of the end-of-central-directory record of a zip file without a comment
# Raised by NumPy and zipfile for a file that is truncated, damaged, or of another kind.
_DAMAGES = (
    AttributeError,
    EOFError,
    KeyError,
    MemoryError,
    NotImplementedError,
    OSError,
    RuntimeError,
    SyntaxError,
    TokenError,
    TypeError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)


HeaderCheck: TypeAlias = Callable[[Mapping[str, Header]], object]
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
    owes_evaluation: bool = False
    """Whether an evaluation of this state was under way. A run that continues from it begins with the evaluation."""

    @property
    def generation(self) -> int:
        """Number of finished generations."""
        return int(self.arrays["generation"])

    @property
    def env_steps(self) -> int:
        """Environment steps of training."""
        return int(self.arrays["env_steps"])


def _arrays(checkpoint: Checkpoint) -> dict[str, np.ndarray]:
    """Return all arrays of the file; raise ConfigError if the algorithm uses a reserved name."""
    best = checkpoint.best
    own = {
        "format": np.int64(FORMAT),
        "best_generation": np.int64(best.generation),
        "best_score": np.float64(best.score),
        "best_return": np.float64(best.mean_return),
        "settings": np.array(json.dumps(checkpoint.numbers, sort_keys=True)),
        **({_OWED: np.True_} if checkpoint.owes_evaluation else {}),
    }
    taken = sorted({*own, _OWED} & checkpoint.arrays.keys())
    if taken:
        raise ConfigError(
            f"the algorithm's to_arrays() names an array {', '.join(taken)}, which the checkpoint reserves. "
            "Choose another name."
        )
    return {name: np.asarray(value) for name, value in {**own, **checkpoint.arrays}.items()}


def save_checkpoint(path: Path, checkpoint: Checkpoint, *, is_compressed: bool = False) -> None:
    """Write `checkpoint` to `path`, atomically; a StorageError leaves an earlier file at `path` unchanged."""

    def write(file: IO[bytes]) -> None:
        save = np.savez_compressed if is_compressed else np.savez
        save(file, allow_pickle=False, **_arrays(checkpoint))  # type: ignore[arg-type] - savez takes any name

    write_atomically(path, write)


def load_checkpoint(path: Path, check: HeaderCheck | None = None, *, with_state: bool = True) -> Checkpoint:
    """Read the checkpoint at `path`, without executing code from it.

    Args:
        path: The file.
        check: Raises CheckpointError if the algorithm's arrays have other names, shapes or types than it expects. It is
            called before any of them is read.
        with_state: Whether to read all arrays; otherwise those alone that every checkpoint has, which is quick.

    Raises:
        CheckpointError: The file is missing, truncated, too large, or not a checkpoint of this version.
    """
    if not path.is_file():
        others = sorted(other.stem for other in path.parent.glob("*.npz") if other.is_file())
        there = f" There are: {', '.join(others)}." if others else ""
        raise CheckpointError(
            f"there is no checkpoint {path}.{there} Choose one with --checkpoint; "
            "to resume from it, copy it to last.npz."
        )
    try:
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            headers = read_headers(archive)
            _check_count(file, len(headers))
            _check_own(headers)
            own = {name: _read(archive, name) for name in _OWN}
            _check_format(int(own["format"]))
            if check is not None:
                check({name: header for name, header in headers.items() if name not in {*_OWN, _OWED}})
            wanted = headers if with_state else _SCALARS
            _check_memory({name: headers[name] for name in wanted})
            arrays = {name: _read(archive, name) for name in wanted if name not in {*_OWN, _OWED}}
        return _from_arrays(own, arrays, owes_evaluation=_OWED in headers)
    except CheckpointError as error:
        raise CheckpointError(f"{path} {error}") from error
    except _DAMAGES as error:
        raise _damaged(path, error) from error


def _read(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Return the array called `name`."""
    with archive.open(name + SUFFIX) as member:
        return np.lib.format.read_array(member, allow_pickle=False)


def _check_own(headers: Mapping[str, Header]) -> None:
    """Raise KeyError or ValueError unless every checkpoint's own arrays are scalars of the right type and size."""
    missing = [name for name in _SCALARS if name not in headers]
    if missing:
        raise KeyError(", ".join(missing))
    for name, kind in _SCALARS.items():
        header = headers[name]
        if header.shape or header.dtype.kind != kind or header.nbytes > _MOST_SETTINGS:
            raise ValueError(f"{name} is {header.dtype} of shape {header.shape}")


def _check_format(version: int) -> None:
    """Raise CheckpointError for another version of the format."""
    if version != FORMAT:
        raise CheckpointError(
            f"has checkpoint format {version}; this version of SHES reads {FORMAT}. "
            "Use the version that wrote it (config.json of the run names it)."
        )


def _check_memory(headers: Mapping[str, Header]) -> None:
    """Raise CheckpointError unless all arrays fit into the memory."""
    size, free = sum(header.nbytes for header in headers.values()), free_memory()
    if size > free:
        raise CheckpointError(
            f"holds {size / 1e9:,.1f} GB of arrays, but {free / 1e9:,.1f} GB of memory are free. "
            "Take another one with --checkpoint, or a machine with more memory."
        )


def _check_count(file: IO[bytes], count: int) -> None:
    """Raise ValueError unless the zip file has the members that its end record counts: damage may hide some."""
    file.seek(-_END_OF_ZIP, os.SEEK_END)
    written = int.from_bytes(file.read(_END_OF_ZIP)[10:12], "little")
    if written != count:
        raise ValueError(f"{count} of {written} arrays can be read")


def _damaged(path: Path, error: Exception) -> CheckpointError:
    text = " ".join(str(error).split())[:_MOST_TEXT]
    return CheckpointError(
        f"{path} is not a whole SHES checkpoint ({type(error).__name__}: {text}). It may be truncated or another "
        "program's file. Take another one with --checkpoint last, best or a generation; "
        "to resume from another one, copy it over last.npz."
    )


def _from_arrays(
    own: Mapping[str, np.ndarray], arrays: Mapping[str, np.ndarray], *, owes_evaluation: bool
) -> Checkpoint:
    """Return the checkpoint that `_arrays` converted; raise TypeError or ValueError if no run can have written it."""
    checkpoint = Checkpoint(
        arrays=arrays,
        best=Best(
            generation=int(own["best_generation"]),
            score=float(own["best_score"]),
            mean_return=float(own["best_return"]),
        ),
        numbers=json.loads(str(own["settings"])),
        owes_evaluation=owes_evaluation,
    )
    best = checkpoint.best
    if min(int(arrays["seed"]), checkpoint.generation, checkpoint.env_steps, best.generation + 1) < 0:
        raise ValueError("a count is negative")
    if not (best.score < np.inf and best.mean_return < np.inf):
        raise ValueError("the best score or return is NaN or infinity")
    if not isinstance(checkpoint.numbers, dict):
        raise TypeError("the settings are not a JSON object")
    return checkpoint


def restore(checkpoint: Checkpoint, from_arrays: Callable[[Mapping[str, np.ndarray]], StateT], path: Path) -> StateT:
    """Return the algorithm's state in `checkpoint`, read from `path`; raise CheckpointError if it does not fit."""
    try:
        return from_arrays(checkpoint.arrays)
    except CheckpointError as error:
        raise CheckpointError(f"{path} {error}") from error
    except _DAMAGES as error:
        raise _damaged(path, error) from error
