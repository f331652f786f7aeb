"""`shes plot`: learning curves of runs."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from shes.errors import ConfigError, RunFolderError
from shes.settings import checked
from shes.storage import write_atomically
from shes.viewing.curves import X_AXES, Group, MeanCurve, RunData, Table, column_curve, group_runs, read_runs

_PANEL_INCHES = (5.0, 3.8)
_TICKS = 5  # more would overlap where the numbers have many digits
_LEGEND_LINE_INCHES, _CHARACTERS_PER_INCH = 0.19, 11
_COLORS, _STYLES = 10, ("-", "--", ":", "-.")
_THIN, _OPACITY = 0.7, 0.16


@checked
def plot(
    runs: Path | str | Sequence[Path | str],
    out: Path | str = "curves.png",
    *,
    x: Literal["env_steps", "generation", "wall_time_s"] = "env_steps",
) -> Path:
    """Draw the learning curves of `runs`; return the path of the picture.

    Runs that differ in the seed only form a group: the figure shows its mean and a 95 % t interval over its runs. Two
    runs are drawn as thin lines with their mean, and runs that hardly overlap without one. A single run shows its
    evaluation's mean plus or minus two standard errors over episodes instead. Runs with the same seed are no
    repetitions: each is drawn.

    shes plot runs/seeds runs/other --out mean.pdf --x generation

    Args:
        runs: Run folders, folders of runs, or names of shipped agents. Those without an evaluation are left out if
            others have one.
        out: Path of the picture; the suffix (.png, .pdf, .svg) selects the format.
        x: Horizontal axis.
    """
    target = Path(out)
    read, errors = read_runs(runs, "plot")
    for error in errors.values():
        raise error
    # The first evaluation of a young run comes with its second generation.
    read = [run for run in read if run.tables["evaluation"] or run.is_damaged] or read
    groups = group_runs(read)
    levels = dict.fromkeys(name for run in read for name in run.config.level_names)
    width, height = _PANEL_INCHES
    figure, axes = plt.subplots(1, 1 + len(levels), figsize=(width * (1 + len(levels)), height), layout="constrained")
    try:
        picture_format = target.suffix.lstrip(".").lower()
        if picture_format not in figure.canvas.get_supported_filetypes():
            raise ConfigError(f"out must end in .png, .pdf or .svg, got {str(out)!r}. Set --out.")
        drawn = _draw_panel(axes[0], groups, "evaluation score", "evaluation", "score_mean", x)
        for axis, level in zip(axes[1:], levels, strict=True):
            own = [group for group in groups if level in group.runs[0].config.level_names]
            drawn += _draw_panel(axis, own, f"{level} return (training)", "progress", f"{level}_return_mean", x)
        _draw_legend(figure, groups, drawn)
        write_atomically(target, lambda file: figure.savefig(file, format=picture_format, dpi=150))
    finally:
        plt.close(figure)
    return target


def _draw_panel(axis: Axes, groups: Sequence[Group], title: str, table: str, column: str, x: str) -> list[MeanCurve]:
    """Draw a column of the runs of each group; return their means."""
    axis.set_title(title)
    axis.set_xlabel(X_AXES[x][0])
    axis.xaxis.set_major_locator(MaxNLocator(nbins=_TICKS))
    axis.grid(alpha=0.3)
    drawn = [column_curve([_columns(run, table, column, x) for run in each.runs], column, x) for each in groups]
    for group, curve in zip(groups, drawn, strict=True):
        color, style = _look(group)
        draw_mean_curve(axis, curve, color, group.label, style)
    return drawn


def _columns(run: RunData, table: str, *names: str) -> Table:
    """Return a table of a run; raise RunFolderError if it lacks one of the columns `names`."""
    found = run.tables[table]
    missing = [name for name in names if name not in found]
    if missing:
        reasons = " ".join(run.notes) or f"{table}.csv has no column {missing[0]!r}."
        raise RunFolderError(f"{run.folder.path} cannot be drawn. {reasons} Train it first, or leave it out.")
    return found


def _look(group: Group) -> tuple[str, str]:
    """Return color and style of a group's line; after ten groups the colors begin anew with another style."""
    return f"C{group.number % _COLORS}", _STYLES[group.number // _COLORS % len(_STYLES)]


def draw_mean_curve(axis: Axes, curve: MeanCurve, color: str, label: str, style: str = "-") -> None:
    """Draw the mean of runs, called `label`, with its band, and the runs that are to be shown singly.

    The axis keeps to the values of several runs: the band of few may leave it.
    """
    look: dict[str, Any] = {"color": color, "linestyle": style}
    for number, (x, y) in enumerate(curve.singles):
        name = label if curve.is_apart and number == 0 else None
        axis.plot(x, y, linewidth=_THIN, marker="." if len(x) == 1 else "", label=name, **look)
    if not curve.is_apart:
        axis.plot(curve.grid, curve.mean, marker="." if len(curve.grid) == 1 else "", label=label, **look)
    if curve.band is not None:
        low, high = curve.band
        edge = np.concatenate([np.column_stack([curve.grid, low]), np.column_stack([curve.grid, high])[::-1]])
        axis.add_collection(PolyCollection([edge], color=color, alpha=_OPACITY, linewidth=0), autolim=False)
        kept = curve.values if len(curve.values) > 1 else np.stack(curve.band)
        axis.update_datalim([(curve.grid[0], kept.min()), (curve.grid[-1], kept.max())])
        axis.autoscale_view()


def legend_keys(curves: Iterable[MeanCurve], runs: str) -> list[tuple[Artist, str]]:
    """Return handles and words for what is drawn apart from the means of `curves`; `runs` is the word for runs."""
    drawn = list(curves)
    bands = {len(curve.values) > 1 for curve in drawn if curve.band is not None}
    apart = {curve.is_apart for curve in drawn if curve.singles}
    area, thin = Patch(color="grey", alpha=2 * _OPACITY), Line2D([], [], color="black", linewidth=_THIN)
    keys: list[tuple[bool, Artist, str]] = [
        (True in bands, area, f"band: 95 % t interval of the mean over {runs}, which may leave the panel"),
        (False in apart, thin, f"thin lines: each of two {runs}, too few for a band"),
        (True in apart, thin, f"thin lines without a mean: {runs} apart, which hardly overlap"),
        (False in bands, area, "band: mean ± 2 standard errors over the episodes of an evaluation"),
    ]
    return [(handle, words) for is_drawn, handle, words in keys if is_drawn]


def _draw_legend(figure: Figure, groups: Sequence[Group], drawn: Sequence[MeanCurve]) -> None:
    """Draw a legend of the groups and of what is drawn below the panels, as high as its wrapped lines need."""
    looks = [(_look(group), group.label) for group in groups]
    keys: list[tuple[Artist, str]] = [(Line2D([], [], color=color, ls=style), text) for (color, style), text in looks]
    keys += legend_keys(drawn, "runs")
    width, height = figure.get_size_inches()
    characters = round(width * _CHARACTERS_PER_INCH) - 8
    wrapped = ["\n".join(textwrap.wrap(text, characters)).replace("$", r"\$") for _, text in keys]
    lines = sum(1 + text.count("\n") for text in wrapped)
    figure.set_size_inches(width, height + lines * _LEGEND_LINE_INCHES)
    handles = [handle for handle, _ in keys]
    figure.legend(handles, wrapped, loc="outside lower center", fontsize="small", frameon=False)
