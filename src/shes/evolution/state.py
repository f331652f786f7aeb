"""The state of a run between generations, and its conversion to and from the named arrays of a checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from shes.errors import CheckpointError
from shes.es.level import LevelState, StrategyState
from shes.es.optimizers import OptimizerState
from shes.es.statistics import ObservationStatistics
from shes.evolution.archive import Archive
from shes.types import F64Array, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class RunningEpisodes:
    """Episodes that continue from generation to generation, from which pairs of primitives branch off."""

    states: F64Array
    """Full physics states [G, S], including the solver's warm start."""
    steps: IntArray
    """Control steps of each episode so far [G]; -1 if it starts anew and its state is ignored."""


@dataclass(frozen=True, kw_only=True)
class TrainState(StrategyState):
    """State of a run between generations."""

    env_steps: int = 0
    """Number of environment steps of training so far."""
    archive: Archive | None = None
    """State of the search for a way, if enabled."""
    running: RunningEpisodes | None = None
    """Episodes that continue in the next generation, if any."""


_COUNTS = ("seed", "generation", "env_steps")
_RUNNING: dict[str, np.ndarray] = {"running/states": np.zeros((0, 0)), "running/steps": np.zeros(0, np.int64)}
"""Arrays of episodes that continue, of the right type and number of axes. They are missing before the first generation.
"""
_ARCHIVE = {f"archive/{field.name}": field.name for field in fields(Archive)}
"""Arrays of the search for a way, which grow."""


def to_arrays(state: TrainState) -> dict[str, np.ndarray]:
    """Return `state` as arrays by name."""
    arrays: dict[str, Any] = {name: np.int64(getattr(state, name)) for name in _COUNTS}
    arrays["levels"] = [level.name for level in state.levels]
    for level in state.levels:
        arrays |= {
            f"{level.name}/theta": level.theta,
            f"{level.name}/optimizer_steps": np.int64(level.optimizer.steps),
            **{f"{level.name}/optimizer_{slot}": values for slot, values in level.optimizer.slots.items()},
            f"{level.name}/observation_count": np.int64(level.statistics.count),
            f"{level.name}/observation_total": level.statistics.total,
            f"{level.name}/observation_total_squares": level.statistics.total_squares,
        }
    if state.archive is not None:
        arrays |= {name: getattr(state.archive, field) for name, field in _ARCHIVE.items()}
    if state.running is not None:
        arrays |= {"running/states": state.running.states, "running/steps": state.running.steps}
    return {name: np.asarray(value) for name, value in arrays.items()}


def from_arrays(arrays: Mapping[str, np.ndarray], start: TrainState) -> TrainState:
    """Return the state that `to_arrays` converted; raise CheckpointError unless it fits the run begun by `start`."""
    _check_arrays(arrays, start)
    check_finite(arrays)
    running = archive = None
    if "archive/cells" in arrays:
        found: dict[str, Any] = {field: arrays[name] for name, field in _ARCHIVE.items()}
        archive = Archive(**{field: array if array.ndim else array.item() for field, array in found.items()})
    if "running/states" in arrays:
        running = RunningEpisodes(states=arrays["running/states"], steps=arrays["running/steps"])
    counts = {name: int(arrays[name]) for name in _COUNTS}
    levels = tuple(_level(arrays, str(name)) for name in arrays["levels"])
    return TrainState(**counts, levels=levels, archive=archive, running=running)


def _level(arrays: Mapping[str, np.ndarray], name: str) -> LevelState:
    own = {key.removeprefix(f"{name}/"): values for key, values in arrays.items() if key.startswith(f"{name}/")}
    theta, steps, count = own.pop("theta"), int(own.pop("optimizer_steps")), int(own.pop("observation_count"))
    sums = {sums: own.pop(f"observation_{sums}") for sums in ("total", "total_squares")}
    slots = {key.removeprefix("optimizer_"): values for key, values in own.items()}
    optimizer, statistics = OptimizerState(steps=steps, slots=slots), ObservationStatistics(count=count, **sums)
    return LevelState(name=name, theta=theta, optimizer=optimizer, statistics=statistics)


def _check_arrays(arrays: Mapping[str, np.ndarray], start: TrainState) -> None:
    """Raise CheckpointError unless `arrays` can be a later state of the run begun by `start`."""
    expected = to_arrays(start) | (_RUNNING if arrays.keys() & _RUNNING.keys() else {})
    faults = {"lacks": expected.keys() - arrays.keys(), "has": arrays.keys() - expected.keys()}
    if any(faults.values()):
        found = " and ".join(f"{verb} {', '.join(sorted(names))}" for verb, names in faults.items() if names)
        raise CheckpointError(f"is not of this run: it {found}. Put back the checkpoint of this run.")
    for name, array in arrays.items():
        own = expected[name]
        fits = array.dtype == own.dtype or array.dtype.kind == own.dtype.kind == "U"  # texts may be longer
        is_growing = name in _ARCHIVE or name in _RUNNING
        if not fits or (array.ndim != own.ndim if is_growing else array.shape != own.shape):
            raise CheckpointError(
                f"holds {name} as {array.dtype} of shape {array.shape}, where this run has {own.dtype} of shape "
                f"{own.shape}. Put back the checkpoint of this run."
            )


def check_finite(arrays: Mapping[str, np.ndarray]) -> None:
    """Raise CheckpointError if one of `arrays` holds NaN or infinity."""
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise CheckpointError(f"holds NaN or infinity in {name}. Take an earlier checkpoint.")
