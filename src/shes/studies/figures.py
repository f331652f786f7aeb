"""The figures of a study: variants with intervals, effects of factors of settings, learning curves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from shes.storage import write_atomically
from shes.studies.comparison import Comparison
from shes.studies.curves_figure import draw_curves
from shes.studies.design import Curves, Forest, Speedup, Sweep, sweep_name
from shes.studies.placed_results import Place, PlacedResults
from shes.studies.speedup_figure import SpeedupLine, speedup_figure
from shes.studies.study import Study
from shes.studies.study_tables import CellResults
from shes.viewing.curves import confidence_interval

_WIDTH = 10.0
"""Width in inches."""
_STYLE: dict[Any, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.dpi": 150,
    "font.size": 10,
    "svg.hashsalt": "shes",  # the same ids in every drawing of the same results
}
_BASE_COLOR, _COLOR = "#1f77b4", "#c44e00"


def draw_figures(
    study: Study, summaries: Mapping[str, CellResults], comparisons: Sequence[Comparison], out: Path
) -> list[Path]:
    """Draw the figures of a study that have finished cells into `out`; return their paths."""
    results = PlacedResults(study, summaries, comparisons)
    drawn: list[Path] = []
    for asked in study.design.figures:
        if results.has(*(asked.groups if isinstance(asked, Curves) else (asked.group,))):
            with plt.rc_context(_STYLE):
                drawn += _draw(results, asked, out)
    return drawn


def _draw(results: PlacedResults, asked: Forest | Sweep | Curves | Speedup, out: Path) -> list[Path]:
    """Draw a figure into `out` in every format; return the paths. The same results give the same bytes."""
    figure = _DRAW[type(asked)](results, asked)
    paths = {form: (out / asked.file).with_suffix(f".{form}") for form in results.design.formats}
    try:
        for form, path in paths.items():
            metadata = {"Date": None} if form == "svg" else None
            write_atomically(path, partial(figure.savefig, format=form, metadata=metadata))
    finally:
        plt.close(figure)
    return list(paths.values())


def _title(env: str) -> str:
    return env.replace("-", " ").title()


def _draw_forest(results: PlacedResults, figure_of: Forest) -> Figure:
    """Return a figure with a panel per environment that has results: variants with their seeds, mean and interval."""
    every = {env: results.variants(env, figure_of.group) for env in results.design.metrics}
    panels = {env: places for env, places in every.items() if places} or every
    heights = [max(1, len(places)) for places in panels.values()]
    figure, axes = plt.subplots(
        len(panels),
        1,
        figsize=(_WIDTH, sum(1.0 + 0.36 * height for height in heights)),
        height_ratios=heights,
        layout="constrained",
        squeeze=False,
    )
    for axis, (env, places) in zip(axes[:, 0], panels.items(), strict=True):
        _forest(axis, results, env, places)
        axis.set_xlabel(f"{results.design.metrics[env].words}: each seed, mean with its 95 % t interval")
    return figure


def _forest(axis: Axes, results: PlacedResults, env: str, places: Sequence[Place]) -> None:
    """Draw the variants at `places`, one per row."""
    rng = np.random.default_rng(0)
    for y, place in enumerate(places):
        values = results.scores(place)
        is_base = place[1:] == results.design.base
        color = _BASE_COLOR if is_base else _COLOR
        heights = y + rng.uniform(-0.16, 0.16, len(values))  # so that equal scores are distinguishable
        axis.scatter(values, heights, s=14, color=color, alpha=0.35, linewidth=0)
        low, high = confidence_interval(values[:, None])
        axis.plot([low[0], high[0]], [y, y], color=color, linewidth=2)
        axis.plot(values.mean(), y, "D", color=color, markersize=6, markeredgecolor="white")
        beside = blended_transform_factory(axis.transAxes, axis.transData)
        axis.text(1.01, y, results.p(place), transform=beside, va="center", fontsize="small")
        if is_base:
            axis.axvline(values.mean(), color=_BASE_COLOR, linewidth=1, alpha=0.5, zorder=0)
    axis.set_yticks(range(len(places)), [results.design.label(place[2]) for place in places])
    axis.set_ylim(max(1, len(places)) - 0.5, -0.5)
    axis.set_title(_title(env), loc="left", fontweight="bold")
    axis.grid(axis="x", alpha=0.3)


def _draw_sweep(results: PlacedResults, figure_of: Sweep) -> Figure:
    """Return a figure with a row per environment and a column per setting: mean and interval over the factor."""
    metrics = results.design.metrics
    height = max(3.4, 2.6 * len(metrics))
    figure, axes = plt.subplots(
        len(metrics),
        len(figure_of.settings),
        figsize=(_WIDTH, height),
        layout="constrained",
        sharey="row",
        squeeze=False,
    )
    for row, env in zip(axes, metrics, strict=True):
        for axis, setting in zip(row, figure_of.settings, strict=True):
            _sensitivity(axis, results, env, figure_of, setting)
        row[0].set_ylabel(f"{_title(env)}\n{metrics[env].short or metrics[env].words}")
    for axis, setting in zip(axes[0], figure_of.settings, strict=True):
        axis.set_title(setting.replace("_", " "), fontsize="medium")
    figure.supxlabel("band: 95 % t interval of the mean over seeds", fontsize="small")
    return figure


def _sensitivity(axis: Axes, results: PlacedResults, env: str, figure_of: Sweep, setting: str) -> None:
    """Draw the effect of the factors of a setting on a task, with the base at 1."""
    places = {factor: (env, figure_of.group, sweep_name(setting, factor)) for factor in figure_of.factors}
    places = dict(sorted({**places, 1.0: (env, *results.design.base)}.items()))
    found = {factor: values for factor, place in places.items() if len(values := results.scores(place))}
    bounds = [confidence_interval(values[:, None]) for values in found.values()]
    means = [values.mean() for values in found.values()]
    axis.fill_between(
        list(found),
        [low[0] for low, _ in bounds],
        [high[0] for _, high in bounds],
        color=_COLOR,
        alpha=0.2,
        linewidth=0,
    )
    axis.plot(list(found), means, "o-", color=_COLOR, markersize=4)
    if 1.0 in found:
        axis.plot(1.0, found[1.0].mean(), "D", color=_BASE_COLOR, markersize=7, markeredgecolor="white")
        axis.axhline(found[1.0].mean(), color=_BASE_COLOR, linewidth=1, alpha=0.5, zorder=0)
    axis.set_xscale("log", base=2)
    labels = [f"{results.cells[place].settings[setting]:g}" for place in places.values()]
    axis.set_xticks(list(places), labels, fontsize="small", rotation=45)
    axis.minorticks_off()
    axis.set_xlim(0.8 * min(places), 1.25 * max(places))
    axis.grid(alpha=0.3)


def _draw_speedup(results: PlacedResults, figure_of: Speedup) -> Figure:
    """Return a figure of speed-up over cores, the mean over seeds."""
    places = [place for place in results.summaries if place[1] == figure_of.group]
    lines = [
        SpeedupLine(
            words=results.design.label(variant),
            rows=[row for run in results.summaries[env, group, variant] for row in run.curve],
            authors=results.design.authors(variant),
        )
        for env, group, variant in places
    ]
    return speedup_figure(lines, _title(places[0][0]), (_WIDTH, 0.7 * _WIDTH))


_DRAW: dict[type, Callable[..., Figure]] = {
    Forest: _draw_forest,
    Sweep: _draw_sweep,
    Curves: partial(draw_curves, width=_WIDTH),
    Speedup: _draw_speedup,
}
