"""`shes plot`: learning curves of runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

from shes.errors import ConfigError, RunFolderError, UnknownNameError
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from shes.storage import write_atomically
from shes.types import F64Array
from shes.viewing.curves import interpolate, interval

__all__ = ["X_AXES", "plot"]

X_AXES = {"generation": "generation", "env_steps": "environment steps", "wall_time_s": "minutes"}
"""Abscissae: column of the tables -> label."""

Panel = tuple[str, str, str]
"""Table, column, title."""


@dataclass(frozen=True, kw_only=True)
class _Group:
    """Runs with equal settings except the seed. They are drawn as one curve."""

    folders: list[RunFolder]
    label: str
    color: str


def plot(runs: Sequence[Path | str], out: Path | str = "curves.png", *, x: str = "env_steps") -> Path:
    """Draw the learning curves of `runs` and return the picture's path.

    Runs that differ in the seed only form a group: the figure shows its mean and a 95 % bootstrap interval over its
    runs. A single run shows its evaluation's mean plus or minus two standard errors over episodes instead.

    Args:
        runs: Run folders, or names of shipped agents.
        out: Path of the picture; the suffix (.png, .pdf, .svg) selects the format.
        x: `env_steps`, `generation` or `wall_time_s`.

    Raises:
        RunFolderError: A run is neither a run folder nor a shipped agent, or has no generation yet.
        UnknownNameError: `x` is not one of `X_AXES`.
        ConfigError: `runs` is empty, or the suffix of `out` is not a picture format.
        StorageError: The picture cannot be written.
    """
    if not runs:
        raise ConfigError("plot needs at least one run folder: shes plot RUN... --out curves.png")
    if x not in X_AXES:
        raise UnknownNameError("x axis", x, X_AXES, "Set --x.")
    target = Path(out)
    opened = [RunFolder.open(run) for run in runs]
    folders = list({folder.path.resolve(): folder for folder in opened}.values())  # a run named twice counts once
    panels, groups = _panels(folders), _groups(folders)
    figure, axes = plt.subplots(1, len(panels), figsize=(5 * len(panels), 3.8), layout="constrained")
    try:
        picture_format = target.suffix.lstrip(".").lower()
        if picture_format not in figure.canvas.get_supported_filetypes():
            raise ConfigError(f"out must end in .png, .pdf or .svg, got {str(out)!r}. Set --out.")
        for axis, (table, column, label) in zip(axes, panels, strict=True):
            for group in groups:
                if _has_level(group.folders[0], column):
                    _draw_group(axis, group, table, column, x)
            axis.set_xlabel(X_AXES[x])
            axis.set_title(label)
            axis.grid(alpha=0.3)
        axes[0].legend(fontsize="small")
        write_atomically(target, lambda file: figure.savefig(file, format=picture_format, dpi=150))
    finally:
        plt.close(figure)
    return target


def _panels(folders: list[RunFolder]) -> list[Panel]:
    """Return the panels: the score, and the return of each level of any run."""
    levels = dict.fromkeys(name for folder in folders for name in folder.read_config().level_names)
    returns = [("progress", f"{name}_return_mean", f"{name} return (training)") for name in levels]
    return [("evaluation", "score_mean", "evaluation score"), *returns]


def _has_level(folder: RunFolder, column: str) -> bool:
    """Return whether a run has `column`: its score, or the return of one of its levels."""
    level = column.removesuffix("_return_mean")
    return level == column or level in folder.read_config().level_names


def _groups(folders: list[RunFolder]) -> list[_Group]:
    """Return `folders` in groups of equal settings except the seed."""
    found: dict[str, list[RunFolder]] = {}
    for folder in folders:
        config = folder.read_config()
        settings = {name: value for name, value in config.numbers().items() if name != "seed"}
        found.setdefault(json.dumps([config.run.preset, settings], sort_keys=True), []).append(folder)
    configs = [members[0].read_config().run for members in found.values()]
    names = [f"{run.env} {run.preset}" for run in configs]
    groups: list[_Group] = []
    for number, (name, members) in enumerate(zip(names, found.values(), strict=True)):
        label = name if names.count(name) == 1 else f"{name}: {members[0].path.name}"
        several = f" ({len(members)} runs)" if len(members) > 1 else ""
        groups.append(_Group(folders=members, label=label + several, color=f"C{number}"))
    return groups


def _draw_group(axis: Axes, group: _Group, table: str, column: str, x: str) -> None:
    """Draw one column of the group's runs."""
    xs, ys = zip(*(_read_curve(folder, table, column, x) for folder in group.folders), strict=True)
    is_single = len(group.folders) == 1
    grid, values = (xs[0], np.stack(ys)) if is_single else interpolate(xs, ys)
    mean = values.mean(axis=0)
    axis.plot(grid, mean, label=group.label, color=group.color)
    if not is_single:
        low, high = interval(values)
    elif column == "score_mean":
        columns = read_csv(group.folders[0].evaluation)
        error = 2 * np.array(columns["score_std"]) / np.sqrt(columns["episodes"])
        low, high = mean - error, mean + error
    else:
        return
    axis.fill_between(grid, low, high, alpha=0.2, color=group.color, linewidth=0)


def _read_curve(folder: RunFolder, table: str, column: str, x: str) -> tuple[F64Array, F64Array]:
    """Return abscissae and values of one column of a run's table.

    Raises:
        RunFolderError: The table or the column does not exist.
    """
    path = folder.evaluation if table == "evaluation" else folder.progress
    if not path.exists():
        raise RunFolderError(f"{folder.path} has no generation yet: {path.name} is missing. Train it first.")
    columns = read_csv(path)
    if column not in columns:
        raise RunFolderError(f"{path} has no column {column!r}, or no row.")
    scale = 1 / 60 if x == "wall_time_s" else 1.0
    return np.array(columns[x]) * scale, np.array(columns[column])
