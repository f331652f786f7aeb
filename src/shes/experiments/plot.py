"""Learning curves of runs. The only file that imports matplotlib."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.typing import ColorType

from shes.errors import ConfigError, RunFolderError, UnknownNameError
from shes.experiments.config import TrainConfig
from shes.experiments.records import read_csv
from shes.experiments.run_folder import RunFolder
from shes.storage import write_atomically
from shes.types import F64Array

__all__ = ["X_AXES", "interval", "plot"]

X_AXES = {"generation": "generation", "env_steps": "environment steps", "wall_time_s": "minutes"}
"""What a curve can be drawn over: column of the tables -> label."""

_PANELS = (
    ("evaluation", "score_mean", "evaluation score"),
    ("progress", "controller_return_mean", "controller return (training)"),
    ("progress", "primitive_return_mean", "primitive return (training)"),
)
_CONFIDENCE = 0.95
_RESAMPLES = 2000


@dataclass(frozen=True, kw_only=True)
class _Curve:
    run: Path
    name: str
    group: str
    """Settings but for the seed: runs that share them are repetitions of each other."""
    x: F64Array
    y: F64Array


def plot(runs: Sequence[Path | str], out: Path | str = "curves.png", *, x: str = "env_steps") -> Path:
    """Draw the learning curves of `runs` and return the picture's path.

    Runs of the same settings but for the seed are one group: its mean is drawn, and a 95 % bootstrap interval over its
    runs. A run alone shows the spread of its evaluation's episodes instead (mean, plus or minus two standard errors).

    Args:
        runs: Run folders.
        out: The picture; its suffix (.png, .pdf, .svg) says the format.
        x: `env_steps`, `generation` or `wall_time_s`.

    Raises:
        RunFolderError: A path is not a run folder, or has no generation yet.
        UnknownNameError: `x` is not one of `X_AXES`.
        ConfigError: No run is given, or the suffix of `out` is no picture format.
        StorageError: The picture cannot be written.
    """
    if not runs:
        raise ConfigError("plot needs at least one run folder: shes plot RUN... --out curves.png")
    if x not in X_AXES:
        raise UnknownNameError("x axis", x, X_AXES, "Set --x.")
    target = Path(out)
    figure, axes = plt.subplots(1, len(_PANELS), figsize=(5 * len(_PANELS), 3.8), layout="constrained")
    try:
        picture_format = target.suffix.lstrip(".").lower()
        if picture_format not in figure.canvas.get_supported_filetypes():
            raise ConfigError(f"out must end in .png, .pdf or .svg, got {str(out)!r}. Set --out.")
        paths = {Path(run).resolve(): Path(run) for run in runs}  # a run named twice counts once
        folders = [RunFolder.open(path) for path in paths.values()]
        for axis, (table, column, label) in zip(axes, _PANELS, strict=True):
            _draw_panel(axis, folders, table, column, x)
            axis.set_xlabel(X_AXES[x])
            axis.set_title(label)
            axis.grid(alpha=0.3)
        axes[0].legend(fontsize="small")
        write_atomically(target, lambda file: figure.savefig(file, format=picture_format, dpi=150))
    finally:
        plt.close(figure)
    return target


def _draw_panel(axis: Axes, folders: list[RunFolder], table: str, column: str, x: str) -> None:
    """Draw one column of all runs, group by group."""
    groups: dict[str, list[_Curve]] = {}
    for folder in folders:
        curve = _read_curve(folder, table, column, x)
        groups.setdefault(curve.group, []).append(curve)
    for curves in groups.values():
        is_unique = sum(others[0].name == curves[0].name for others in groups.values()) == 1
        name = curves[0].name if is_unique else f"{curves[0].name}: {curves[0].run.name}"
        if len(curves) == 1:
            (line,) = axis.plot(curves[0].x, curves[0].y, label=name)
            _draw_spread(axis, folders, curves[0], table, column, line.get_color())
            continue
        grid, values = _on_one_grid(curves)
        low, high = interval(values)
        (line,) = axis.plot(grid, values.mean(axis=0), label=f"{name} ({len(curves)} runs)")
        axis.fill_between(grid, low, high, alpha=0.2, color=line.get_color(), linewidth=0)


def _draw_spread(
    axis: Axes, folders: list[RunFolder], curve: _Curve, table: str, column: str, color: ColorType
) -> None:
    """Shade two standard errors of a single run's evaluations."""
    if (table, column) != ("evaluation", "score_mean"):
        return
    folder = next(folder for folder in folders if folder.path == curve.run)
    columns = read_csv(folder.evaluation)
    error = 2 * np.array(columns["score_std"]) / np.sqrt(columns["episodes"])
    axis.fill_between(curve.x, curve.y - error, curve.y + error, alpha=0.2, color=color, linewidth=0)


def _read_curve(folder: RunFolder, table: str, column: str, x: str) -> _Curve:
    config = folder.read_config()
    path = folder.evaluation if table == "evaluation" else folder.progress
    if not path.exists():
        raise RunFolderError(f"{folder.path} has no generation yet: {path.name} is missing. Train it first.")
    columns = read_csv(path)
    if column not in columns:
        raise RunFolderError(f"{path} has no column {column!r}, or no row.")
    scale = 1 / 60 if x == "wall_time_s" else 1.0
    settings = {name: value for name, value in config.numbers().items() if name != "seed"}
    group = json.dumps([config.preset, settings], sort_keys=True)
    return _Curve(
        run=folder.path, name=_name(config), group=group, x=np.array(columns[x]) * scale, y=np.array(columns[column])
    )


def _name(config: TrainConfig) -> str:
    return f"{config.env} {config.preset}"


def _on_one_grid(curves: list[_Curve]) -> tuple[F64Array, F64Array]:
    """Return places [K] that all curves reach, and their values there [runs, K]."""
    end = min(curve.x[-1] for curve in curves)
    start = max(curve.x[0] for curve in curves)
    grid = np.unique(np.concatenate([curve.x[(curve.x >= start) & (curve.x <= end)] for curve in curves]))
    return grid, np.stack([np.interp(grid, curve.x, curve.y) for curve in curves])


def interval(values: F64Array, seed: int = 0) -> tuple[F64Array, F64Array]:
    """Return the 95 % bootstrap interval [K], [K] of the mean over runs of `values` [runs, K]."""
    rng = np.random.default_rng(seed)
    runs = len(values)
    shares = rng.multinomial(runs, np.full(runs, 1 / runs), _RESAMPLES) / runs  # how often a resample takes each run
    means = shares @ values
    tail = (1 - _CONFIDENCE) / 2
    low, high = np.quantile(means, [tail, 1 - tail], axis=0)
    return low, high
