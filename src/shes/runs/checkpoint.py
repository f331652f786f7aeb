"""Checkpoints: everything that a run carries from one generation to the next, in one `.npz` without pickle."""

from __future__ import annotations

import json
import zipfile
import zlib
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from shes.errors import CheckpointError
from shes.es.level import LevelState, RunningEpisodes, TrainState
from shes.es.novelty import NoveltyState
from shes.es.optimizers import OptimizerState
from shes.es.statistics import ObservationStatistics
from shes.storage import write_atomically

__all__ = ["Best", "Checkpoint", "CheckpointWriter", "load_checkpoint", "save_checkpoint"]

FORMAT = 2
# What NumPy and zipfile raise for a file that is cut short, damaged, or of another kind.
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
    """The best evaluation so far. The highest score wins; ties go to the higher return, then to the later one."""

    generation: int = -1
    score: float = -np.inf
    mean_return: float = -np.inf

    def is_beaten_by(self, score: float, mean_return: float) -> bool:
        """Tell whether a later evaluation takes its place."""
        return (score, mean_return) >= (self.score, self.mean_return)


@dataclass(frozen=True, kw_only=True)
class Checkpoint:
    """A run at the end of a generation."""

    state: TrainState
    best: Best
    numbers: dict[str, Any]
    """The settings that change numbers: a checkpoint continues only the run that it is of."""


def _arrays(checkpoint: Checkpoint) -> dict[str, np.ndarray]:
    """Return the checkpoint as named arrays."""
    state, best = checkpoint.state, checkpoint.best
    arrays = {
        "format": np.int64(FORMAT),
        "seed": np.int64(state.seed),
        "generation": np.int64(state.generation),
        "env_steps": np.int64(state.env_steps),
        "best_generation": np.int64(best.generation),
        "best_score": np.float64(best.score),
        "best_return": np.float64(best.mean_return),
        "settings": np.array(json.dumps(checkpoint.numbers, sort_keys=True)),
    }
    arrays["levels"] = np.array([level.name for level in state.levels])
    for level in state.levels:
        arrays |= {
            f"{level.name}/theta": level.theta,
            f"{level.name}/optimizer_steps": np.int64(level.optimizer.steps),
            **{f"{level.name}/optimizer_{slot}": values for slot, values in level.optimizer.slots.items()},
            f"{level.name}/observation_count": np.int64(level.statistics.count),
            f"{level.name}/observation_total": level.statistics.total,
            f"{level.name}/observation_total_squares": level.statistics.total_squares,
        }
    if state.novelty is not None:
        arrays |= {
            "novelty/archive": state.novelty.archive,
            "novelty/weight": np.float64(state.novelty.weight),
            "novelty/best_return": np.float64(state.novelty.best_return),
            "novelty/stalled": np.int64(state.novelty.stalled),
        }
    if state.running is not None:
        arrays |= {"running/states": state.running.states, "running/steps": state.running.steps}
    return {name: np.asarray(value) for name, value in arrays.items()}


def save_checkpoint(path: Path, checkpoint: Checkpoint, *, is_compressed: bool = False) -> None:
    """Write `checkpoint` to `path`, atomically.

    Raises:
        StorageError: The file cannot be written; what was at `path` is untouched.
    """

    def write(file: IO[bytes]) -> None:
        save = np.savez_compressed if is_compressed else np.savez
        save(file, allow_pickle=False, **_arrays(checkpoint))  # type: ignore[arg-type] - savez takes any name

    write_atomically(path, write)


def load_checkpoint(path: Path) -> Checkpoint:
    """Read the checkpoint at `path`; nothing in it is executed.

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
        return _from_arrays(arrays, path)
    except _DAMAGES as error:
        raise CheckpointError(
            f"{path} is not a whole SHES checkpoint ({type(error).__name__}: {error}). It may be truncated or another "
            "program's file. Take another one with --checkpoint last, best or a generation; "
            "to resume from another one, copy it over last.npz."
        ) from error


def _from_arrays(arrays: dict[str, np.ndarray], path: Path) -> Checkpoint:
    """Return the checkpoint that `_arrays` took apart."""
    version = int(arrays["format"])
    if version == 1:
        arrays = _from_first_format(arrays)
    elif version != FORMAT:
        raise CheckpointError(
            f"{path} has checkpoint format {version}; this version of SHES reads 1 and {FORMAT}. "
            "Use the version that wrote it (config.json of the run names it)."
        )
    return Checkpoint(
        state=TrainState(
            seed=int(arrays["seed"]),
            generation=int(arrays["generation"]),
            env_steps=int(arrays["env_steps"]),
            levels=tuple(_level(arrays, str(name)) for name in arrays["levels"]),
            novelty=_novelty(arrays),
            running=_running(arrays),
        ),
        best=Best(
            generation=int(arrays["best_generation"]),
            score=float(arrays["best_score"]),
            mean_return=float(arrays["best_return"]),
        ),
        numbers=json.loads(str(arrays["settings"])),
    )


def _level(arrays: dict[str, np.ndarray], name: str) -> LevelState:
    """Return the level of this name."""
    start = f"{name}/optimizer_"
    slots = {key.removeprefix(start): values for key, values in arrays.items() if key.startswith(start)}
    steps = int(slots.pop("steps"))
    return LevelState(
        name=name,
        theta=arrays[f"{name}/theta"],
        optimizer=OptimizerState(steps=steps, slots=slots),
        statistics=ObservationStatistics(
            count=int(arrays[f"{name}/observation_count"]),
            total=arrays[f"{name}/observation_total"],
            total_squares=arrays[f"{name}/observation_total_squares"],
        ),
    )


def _novelty(arrays: dict[str, np.ndarray]) -> NoveltyState | None:
    """Return the search for novelty, if there is one."""
    if "novelty/archive" not in arrays:
        return None
    return NoveltyState(
        archive=arrays["novelty/archive"],
        weight=float(arrays["novelty/weight"]),
        best_return=float(arrays["novelty/best_return"]),
        stalled=int(arrays["novelty/stalled"]),
    )


def _running(arrays: dict[str, np.ndarray]) -> RunningEpisodes | None:
    """Return the episodes that go on, if there are any."""
    if "running/states" not in arrays:
        return None
    return RunningEpisodes(states=arrays["running/states"], steps=arrays["running/steps"])


def _from_first_format(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return what the first format held, two levels with Adam, as this one holds it."""
    renamed = {name.replace("/adam_", "/optimizer_"): values for name, values in arrays.items()}
    return {**renamed, "levels": np.array(["controller", "primitive"])}


class CheckpointWriter:
    """Writes checkpoints beside the next generation's work, one at a time, in the order they are given."""

    def __init__(self) -> None:
        """Start the writing thread."""
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="shes-checkpoint")
        self._last: Future[None] | None = None

    def write(self, paths: list[Path], checkpoint: Checkpoint) -> None:
        """Write `checkpoint` to every one of `paths`, in this order, after the one before is done.

        Raises:
            StorageError: The one before could not be written.
        """
        self.wait()
        self._last = self._pool.submit(self._write_all, paths, checkpoint)

    def wait(self) -> None:
        """Return when everything given is on disk.

        Raises:
            StorageError: It could not be written.
        """
        last, self._last = self._last, None
        if last is not None:
            last.result()

    def close(self) -> None:
        """Finish what was given and end the thread."""
        try:
            self.wait()
        finally:
            self._pool.shutdown()

    @staticmethod
    def _write_all(paths: list[Path], checkpoint: Checkpoint) -> None:
        for path in paths:
            save_checkpoint(path, checkpoint)
