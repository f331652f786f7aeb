"""`shes plot`: learning curves of runs."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from shes.checked import checked
from shes.errors import ConfigError, RunFolderError
from shes.runs.folder import RunFolder
from shes.runs.runs_folder import find_runs
from shes.runs.tables import read_csv
from shes.storage import write_atomically
from shes.types import F64Array
from shes.viewing.curve_drawing import draw_mean_curve, legend_keys
from shes.viewing.curves import MeanCurve, mean_curve
from shes.viewing.groups import Group, group_runs

X_AXES = {
    "generation": ("generation", 1.0),
    "env_steps": ("environment steps (millions)", 1e-6),
    "wall_time_s": ("minutes", 1 / 60),
}
"""Abscissae: column of the tables -> label, and factor of the column's values."""
_OVER_EPISODES = "band: mean ± 2 standard errors over the episodes of an evaluation"
_PANEL_INCHES = (5.0, 3.8)
_TICKS = 5  # more would overlap where the numbers have many digits
_LINE_INCHES = 0.19
"""Height of a line of the legend."""
_CHARACTERS_PER_INCH = 11
"""Of the legend; a little fewer than fit."""

Panel = tuple[str, str, str]
"""Table, column, title."""


@checked
def plot(
    runs: Path | str | Sequence[Path | str],
    out: Path | str = "curves.png",
    *,
    x: Literal["env_steps", "generation", "wall_time_s"] = "env_steps",
) -> Path:
    """Draw the learning curves of `runs`.

    Runs that differ in the seed only form a group: the figure shows its mean and a 95 % t interval over its runs. Two
    runs are drawn as thin lines beside their mean, and runs that hardly overlap without one. A single run shows its
    evaluation's mean plus or minus two standard errors over episodes instead. Runs with the same seed are no
    repetitions: if they differ in the machine or the workers, each is drawn.

    shes plot runs/seeds runs/other --out mean.pdf --x generation

    Args:
        runs: Run folders, folders of runs, or names of shipped agents. Those without an evaluation are left out if
            others have one.
        out: Path of the picture; the suffix (.png, .pdf, .svg) selects the format.
        x: Horizontal axis.

    Returns:
        Path of the picture.

    Raises:
        RunFolderError: A run is neither a folder of runs nor a shipped agent, or none has an evaluation yet.
        UnknownNameError: `x` is not one of `X_AXES`.
        ConfigError: `runs` is empty, or the suffix of `out` is not a picture format.
        StorageError: The picture cannot be written.
    """
    given = [runs] if isinstance(runs, str | os.PathLike) else list(runs)
    if not given:
        raise ConfigError("plot needs at least one run folder: shes plot RUN... --out curves.png")
    target = Path(out)
    opened = [folder for run in given for folder in find_runs(run)]
    folders = list({folder.path.resolve(): folder for folder in opened}.values())  # a run named twice counts once
    # The first evaluation of a young run comes with its second generation.
    folders = [folder for folder in folders if _is_evaluated(folder)] or folders
    panels, groups = _panels(folders), group_runs(folders, by_time=x == "wall_time_s")
    width, height = _PANEL_INCHES
    figure, axes = plt.subplots(1, len(panels), figsize=(width * len(panels), height), layout="constrained")
    try:
        picture_format = target.suffix.lstrip(".").lower()
        if picture_format not in figure.canvas.get_supported_filetypes():
            raise ConfigError(f"out must end in .png, .pdf or .svg, got {str(out)!r}. Set --out.")
        drawn: list[MeanCurve] = []
        for axis, (table, column, label) in zip(axes, panels, strict=True):
            shown = [group for group in groups if _has_level(group.folders[0], column)]
            drawn += [_draw_group(axis, group, table, column, x) for group in shown]
            axis.set_xlabel(X_AXES[x][0])
            axis.set_title(label)
            axis.xaxis.set_major_locator(MaxNLocator(nbins=_TICKS))
            axis.grid(alpha=0.3)
        _draw_legend(figure, groups, drawn)
        write_atomically(target, lambda file: figure.savefig(file, format=picture_format, dpi=150))
    finally:
        plt.close(figure)
    return target


def _is_evaluated(folder: RunFolder) -> bool:
    """Return whether a run has an evaluation."""
    return folder.evaluation.is_file() and bool(read_csv(folder.evaluation))


def _panels(folders: list[RunFolder]) -> list[Panel]:
    """Return the panels: the score, and the return of each level of any run."""
    levels = dict.fromkeys(name for folder in folders for name in folder.read_config().level_names)
    returns = [("progress", f"{name}_return_mean", f"{name} return (training)") for name in levels]
    return [("evaluation", "score_mean", "evaluation score"), *returns]


def _has_level(folder: RunFolder, column: str) -> bool:
    """Return whether a run has `column`: its score, or the return of one of its levels."""
    level = column.removesuffix("_return_mean")
    return level == column or level in folder.read_config().level_names


def _has_spread(evaluations: Mapping[str, Sequence[float]]) -> bool:
    """Return whether evaluations tell how much their episodes differ."""
    return {"score_std", "episodes"} <= evaluations.keys()


def _draw_group(axis: Axes, group: Group, table: str, column: str, x: str) -> MeanCurve:
    """Draw a column of the runs of a group; return their mean."""
    xs, ys = zip(*(_read_curve(folder, table, column, x) for folder in group.folders), strict=True)
    curve = mean_curve(xs, ys)
    draw_mean_curve(axis, curve, group.color, group.label, group.style)
    if len(group.folders) == 1 and column == "score_mean":
        columns = read_csv(group.folders[0].evaluation)
        if _has_spread(columns):
            error = 2 * np.array(columns["score_std"]) / np.sqrt(columns["episodes"])
            axis.fill_between(xs[0], ys[0] - error, ys[0] + error, alpha=0.2, color=group.color, linewidth=0)
    return curve


def _draw_legend(figure: Figure, groups: Sequence[Group], drawn: Sequence[MeanCurve]) -> None:
    """Draw a legend of the groups and of what is drawn below the panels, as high as its wrapped lines need."""
    keys: list[tuple[Artist, str]] = [
        (Line2D([], [], color=group.color, ls=group.style), group.label) for group in groups
    ]
    keys += legend_keys(drawn, "runs")
    if any(len(group.folders) == 1 and _has_spread(read_csv(group.folders[0].evaluation)) for group in groups):
        keys.append((Patch(color="grey", alpha=0.3), _OVER_EPISODES))
    width, height = figure.get_size_inches()
    characters = round(width * _CHARACTERS_PER_INCH) - 8
    wrapped = ["\n".join(textwrap.wrap(text, characters)).replace("$", r"\$") for _, text in keys]
    lines = sum(1 + text.count("\n") for text in wrapped)
    figure.set_size_inches(width, height + lines * _LINE_INCHES)
    handles = [handle for handle, _ in keys]
    figure.legend(handles, wrapped, loc="outside lower center", fontsize="small", frameon=False)


def _read_curve(folder: RunFolder, table: str, column: str, x: str) -> tuple[F64Array, F64Array]:
    """Return abscissae and values of a column of a run's table; raise RunFolderError if it does not exist."""
    path = folder.evaluation if table == "evaluation" else folder.progress
    if not path.exists():
        raise RunFolderError(f"{folder.path} has nothing to draw yet: {path.name} is missing. Train it first.")
    columns = read_csv(path)
    for name in (column, x):
        if name not in columns:
            raise RunFolderError(f"{path} has no column {name!r}, or no row.")
    return np.array(columns[x]) * X_AXES[x][1], np.array(columns[column])
