"""Checkpoints: the whole state of a run after a generation, in one `.npz` without pickle."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from shes.errors import CheckpointError, ConfigError
from shes.storage import write_atomically

StateT = TypeVar("StateT")

FORMAT = 2
_OWN = ("format", "best_generation", "best_score", "best_return", "settings")
"""Arrays that do not belong to the algorithm."""
_OF_EVERY_ALGORITHM = ("seed", "generation", "env_steps")


@dataclass(frozen=True, kw_only=True)
class Best:
    """The best evaluation so far, by score; ties go to the higher return, then to the later evaluation."""

    generation: int = -1
    score: float = -np.inf
    mean_return: float = -np.inf


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
    own: dict[str, Any] = {
        "format": FORMAT,
        "best_generation": best.generation,
        "best_score": best.score,
        "best_return": best.mean_return,
        "settings": json.dumps(checkpoint.numbers, sort_keys=True),
    }
    if taken := sorted(own.keys() & checkpoint.arrays.keys()):
        raise ConfigError(
            f"the algorithm's to_arrays() names an array {', '.join(taken)}, which the checkpoint reserves. "
            "Choose another name."
        )
    arrays, save = {**own, **checkpoint.arrays}, np.savez_compressed if is_compressed else np.savez
    write_atomically(path, lambda file: save(file, allow_pickle=False, **arrays))


def load_checkpoint(path: Path, *, with_state: bool = True) -> Checkpoint:
    """Read the checkpoint at `path`, without executing code from it.

    Without `with_state`, only the arrays that every checkpoint has are read, which is quick.
    """
    if not path.is_file():
        others = sorted(other.stem for other in path.parent.glob("*.npz") if other.is_file())
        there = f" There are: {', '.join(others)}." if others else ""
        raise CheckpointError(
            f"there is no checkpoint {path}.{there} Choose another; to resume from one, copy it to last.npz."
        )
    with _damage_named(path):
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            arrays = {name: file[name] for name in (file.files if with_state else (*_OWN, *_OF_EVERY_ALGORITHM))}
        own = {name: arrays.pop(name).item() for name in _OWN}
        if own["format"] != FORMAT:
            raise CheckpointError(
                f"has checkpoint format {own['format']}; this version of SHES reads {FORMAT}. "
                "Use the version that wrote it (config.json of the run names it)."
            )
        best = Best(generation=own["best_generation"], score=own["best_score"], mean_return=own["best_return"])
        return Checkpoint(arrays=arrays, best=best, numbers=dict(json.loads(own["settings"])))


def restore(checkpoint: Checkpoint, from_arrays: Callable[[Mapping[str, np.ndarray]], StateT], path: Path) -> StateT:
    """Return the algorithm's state in `checkpoint`, read from `path`; raise CheckpointError if it does not fit."""
    with _damage_named(path):
        return from_arrays(checkpoint.arrays)


def short_text(error: object) -> str:
    """Return the cause of damage on one line of at most 200 characters; it may quote the file."""
    return " ".join(str(error).split())[:200]


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    """Convert any error into a CheckpointError that names `path`."""
    try:
        yield
    except CheckpointError as error:
        raise CheckpointError(f"{path} {error}") from error
    except Exception as error:  # NumPy and zipfile raise errors of a dozen kinds for a damaged file
        raise CheckpointError(
            f"{path} is not a whole SHES checkpoint ({type(error).__name__}: {short_text(error)}). It may be "
            "truncated or another program's file. Take another one with --checkpoint last, best or a generation; "
            "to resume from another one, copy it over last.npz."
        ) from error
