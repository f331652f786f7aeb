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
from shes.types import ArrayHeader, F64Array, IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class RunningEpisodes:
    """Episodes that continue from generation to generation, from which pairs of primitives branch off."""

    states: F64Array
    """Full physics states [G, S], including the solver's warm start."""
    steps: IntArray
    """Control steps of each episode so far [G]; -1 if it starts anew, in which case its state is ignored."""


@dataclass(frozen=True, kw_only=True)
class TrainState(StrategyState):
    """State of a run between generations."""

    env_steps: int = 0
    """Number of environment steps of training so far."""
    archive: Archive | None = None
    """State of the search for a way, if enabled."""
    running: RunningEpisodes | None = None
    """Episodes that continue in the next generation, if any."""


_OPTIONAL = {"running/states": (np.float64, 2), "running/steps": (np.int64, 1)}
"""Type and number of axes of the arrays that are missing before the first generation."""
_ARCHIVE = {f"archive/{field.name}": field.name for field in fields(Archive)}
"""Arrays of the search for a way, whose first axes grow."""
_AS_LONG = {"steps": "cells", "chosen": "cells", "nodes": "cells", "states": "cells", "positions": "parents"}
"""Arrays of the search that are as long as another one; states may also be gone."""
_LOWEST = {"running/steps": -1, "archive/cells": -(2**63)}
"""Lowest value of arrays of integers that may be negative."""


def to_arrays(state: TrainState) -> dict[str, np.ndarray]:
    """Return `state` as arrays by name."""
    arrays = {
        "seed": np.int64(state.seed),
        "generation": np.int64(state.generation),
        "env_steps": np.int64(state.env_steps),
        "levels": np.array([level.name for level in state.levels]),
    }
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


def check_headers(headers: Mapping[str, ArrayHeader], start: TrainState) -> None:
    """Raise CheckpointError unless arrays with these headers can be a later state of the run begun by `start`."""
    expected = to_arrays(start)
    missing = expected.keys() - headers.keys()
    unknown = headers.keys() - expected.keys() - _OPTIONAL.keys()
    if missing or unknown:
        faults = {"lacks": missing, "has": unknown}
        found = " and ".join(f"{verb} {', '.join(sorted(names))}" for verb, names in faults.items() if names)
        raise CheckpointError(f"is not of this run: it {found}. Put back the checkpoint of this run.")
    if ("running/states" in headers) != ("running/steps" in headers):
        raise CheckpointError("has states or steps of running episodes, not both. Put back the checkpoint of this run.")
    for name, array in headers.items():
        if name in expected:
            fits, own = _is_like(array, expected[name], grows=name in _ARCHIVE), expected[name]
            here = f"{own.dtype} of shape {own.shape}"
        else:
            dtype, axes = _OPTIONAL[name]
            fits, here = (array.dtype, len(array.shape)) == (dtype, axes), f"{np.dtype(dtype)} with {axes} axes"
        if not fits:
            raise CheckpointError(
                f"holds {name} as {array.dtype} of shape {array.shape}, where this run has {here}. "
                "Put back the checkpoint of this run."
            )
    _check_archive(headers)


def _check_archive(headers: Mapping[str, ArrayHeader]) -> None:
    """Raise CheckpointError unless the arrays of a search for a way are as long as one another."""
    for name, other in _AS_LONG.items() if "archive/cells" in headers else ():
        length, expected = (headers[f"archive/{each}"].shape[0] for each in (name, other))
        if length != expected and (name, length) != ("states", 0):
            raise CheckpointError(
                f"holds archive/{name} of length {length}, where archive/{other} has {expected}. "
                "Put back the checkpoint of this run."
            )


def _is_like(array: ArrayHeader, own: np.ndarray, *, grows: bool) -> bool:
    """Return whether `array` has the type and shape of `own`; texts may be longer, and some arrays grow."""
    is_type = array.dtype == own.dtype or array.dtype.kind == own.dtype.kind == "U"
    return is_type and len(array.shape) == own.ndim and array.shape[grows:] == own.shape[grows:]


def check_arrays(arrays: Mapping[str, np.ndarray], start: TrainState) -> None:
    """Raise CheckpointError unless `arrays` can be a later state of the run begun by `start`."""
    check_headers(arrays, start)
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise CheckpointError(f"holds NaN or infinity in {name}. Take an earlier checkpoint.")
        if array.dtype.kind == "i" and (array < _LOWEST.get(name, 0)).any():
            raise CheckpointError(f"holds a negative number in {name}. Put back the checkpoint of this run.")


def from_arrays(arrays: Mapping[str, np.ndarray]) -> TrainState:
    """Return the state that `to_arrays` converted."""
    running = archive = None
    if "archive/cells" in arrays:
        found: dict[str, Any] = {field: arrays[name] for name, field in _ARCHIVE.items()}
        archive = Archive(**{field: array if array.ndim else array.item() for field, array in found.items()})
    if "running/states" in arrays:
        running = RunningEpisodes(states=arrays["running/states"], steps=arrays["running/steps"])
    return TrainState(
        seed=int(arrays["seed"]),
        generation=int(arrays["generation"]),
        env_steps=int(arrays["env_steps"]),
        levels=tuple(_level(arrays, str(name)) for name in arrays["levels"]),
        archive=archive,
        running=running,
    )


def _level(arrays: Mapping[str, np.ndarray], name: str) -> LevelState:
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
