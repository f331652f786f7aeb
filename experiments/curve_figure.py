"""The figure of learning curves: a panel per environment, with the name of every line at its end.

References are thin grey lines.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.design import Measure
from experiments.figures import WIDTH, color_of
from experiments.results import PlacedResults
from shes.types import F64Array
from shes.viewing.curves import MeanCurve, mean_curve
from shes.viewing.plot import draw_mean_curve, legend_keys

_PANEL_INCHES, _LINE_INCHES = 2.9, 0.19
_UNITS = {"seconds": (60.0, "minutes"), "env_steps": (1e6, "million environment steps")}
"""Units of an abscissa with their names."""
_REFERENCE: dict[str, Any] = {"color": "0.45", "linewidth": 0.8}
_RUNNING_BEST: dict[str, Any] = {"linewidth": 1, "linestyle": "--"}
_SEED: dict[str, Any] = {"linewidth": 0.6, "alpha": 0.4}
_SPAN: dict[str, Any] = {"linewidth": 1, "linestyle": ":", "marker": "|"}
_WIDE = 0.3
"""Mean width of a band, relative to the panel, beyond which its seeds are drawn instead."""
_NAME: dict[str, Any] = {"fontsize": 8, "va": "center", "clip_on": False}
_CHARACTERS, _ROW_INCHES = 17, 0.18
"""Most characters of a line of a name, and its height."""

_Name = tuple[float, str, str]
"""Ordinate, words and colour of a name at the right edge."""


class Curve(NamedTuple):
    """A line of a figure: the runs of a variant."""

    group: str
    variant: str
    words: str = ""
    """Its name at the line; that of tables if empty."""
    is_after_primitive: bool = False
    """Whether it begins where the training of its primitive ended."""


class Panel(NamedTuple):
    """A panel of learning curves."""

    env: str
    title: str
    curves: tuple[Curve, ...]
    measure: Measure
    """Column of `curves.csv`."""
    x: Literal["env_steps", "seconds"] = "env_steps"
    references: Mapping[str, float] = MappingProxyType({})
    """Published results by their names: horizontal lines."""
    has_running_best: bool = False
    """Whether the mean of the running maxima is drawn, too, as a dashed line."""


def draw_curves(
    results: PlacedResults, panels: Sequence[Panel], columns: int, references_note: str = ""
) -> Figure | None:
    """Return a figure with the panels of which there are results, `columns` in a row."""
    panels = [each for each in panels if any(_runs(results, each, curve) for curve in each.curves)]
    groups = {curve.group for panel in panels for curve in panel.curves}
    if not panels or not results.has(*groups):
        return None
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    figure, axes = plt.subplots(rows, columns, layout="constrained", squeeze=False)
    drawn = [_draw_panel(axis, results, panel) for axis, panel in zip(axes.ravel(), panels, strict=False)]
    for axis in axes.ravel()[len(panels) :]:
        axis.set_axis_off()
    lines = 0
    if notes := _notes(panels, [*chain(*drawn)], references_note):
        handles, words = zip(*notes, strict=True)
        figure.legend(handles, words, loc="outside lower center", fontsize="small", frameon=False)
        lines = sum(1 + text.count("\n") for text in words)
    figure.set_size_inches(WIDTH, rows * _PANEL_INCHES + (1 + lines) * _LINE_INCHES)
    figure.draw_without_rendering()  # the layout changes ticks, whose labels need another one when it is saved
    return figure


def _draw_panel(axis: Axes, results: PlacedResults, panel: Panel) -> list[MeanCurve]:
    """Draw the curves and references of a panel with their names; return the means."""
    found = [(curve, runs) for curve in panel.curves if (runs := _runs(results, panel, curve))]
    unit, unit_words = _UNITS[panel.x]
    names, means = list[_Name](), list[MeanCurve]()
    values = np.concatenate([y for _, runs in found for _, y, _ in runs])
    height = float(np.ptp(values)) or 1.0
    for curve, runs in found:
        color = color_of(curve.group, curve.variant, [each.variant for each in panel.curves])
        words = curve.words or results.experiment.label(curve.variant)
        scaled = [(x / unit, y, start / unit) for x, y, start in runs]
        means.append(_draw_curve(axis, scaled, color, words, height, has_running_best=panel.has_running_best))
        own = means[-1]
        names.append((float(np.mean([y[-1] for _, y in own.singles]) if own.is_apart else own.mean[-1]), words, color))
    for words, value in panel.references.items():
        axis.axhline(value, **_REFERENCE, label=words)
        names.append((value, words, _REFERENCE["color"]))
    axis.set_xlim(left=0)
    if values.min() >= 0:
        axis.set_ylim(bottom=-0.02 * height)
    write_names(axis, names)
    seeds = sorted({len(runs) for _, runs in found})
    count = f"{' or '.join(map(str, seeds))} seed{'s' * (seeds[-1:] != [1])}"
    axis.set_title(f"{panel.title} ({count})", fontsize="medium")
    axis.set(ylabel=panel.measure.words, xlabel=unit_words)
    axis.grid(alpha=0.3)
    return means


def write_names(axis: Axes, names: Sequence[_Name], inches: float = _PANEL_INCHES) -> None:
    """Write names at the right edge of an axis `inches` high, near their ordinates, without touching each other."""
    axis.autoscale_view()
    to_axis, row = axis.transScale + axis.transLimits, _ROW_INCHES / inches
    wrapped = sorted((to_axis.transform((1, y))[1], textwrap.fill(words, _CHARACTERS), c) for y, words, c in names)
    halves = np.array([row * (1 + words.count("\n")) / 2 for _, words, _ in wrapped])
    packed = np.r_[0.0, (halves[:-1] + halves[1:]).cumsum()]  # places of names that touch each other
    places = np.maximum.accumulate(np.array([y for y, _, _ in wrapped]) - packed) + packed
    places = np.minimum(places, 1 - halves[-1] + packed - packed[-1])
    for place, (_, words, color) in zip(places, wrapped, strict=True):
        axis.text(1.02, place, words, transform=axis.transAxes, color=color, **_NAME)


_Scores = tuple[F64Array, F64Array, float]
"""A run's abscissae since its training began, its primitive's included; its values; the end of its primitive's."""


def _runs(results: PlacedResults, panel: Panel, curve: Curve) -> list[_Scores]:
    """Return the runs of a curve, without those that would begin too early, or lack a column."""
    before = f"primitive_{panel.x}"
    names = (panel.x, panel.measure.column, *([before] if curve.is_after_primitive else []))
    found: list[_Scores] = []
    for run in results.runs.get((panel.env, curve.group, curve.variant), ()):
        if run.curve and all(row.get(name) is not None for row in run.curve for name in names):
            start = float(run.curve[0][before]) if curve.is_after_primitive else 0.0
            found.append((start + run.column(panel.x), run.column(panel.measure.column), start))
    return found


def _draw_curve(
    axis: Axes, runs: Sequence[_Scores], color: str, words: str, height: float, *, has_running_best: bool
) -> MeanCurve:
    """Draw the mean over seeds, the training of their primitives before it and the running best; return the mean.

    Seeds are drawn singly where the band would fill a panel of `height`.
    """
    curves = [(x, y) for x, y, _ in runs]
    mean = mean_curve(*curves)
    if mean.band is not None and np.mean(mean.band[1] - mean.band[0]) > _WIDE * height:
        mean = replace(mean, band=None)
        for x, y in curves:
            axis.plot(x, y, **_SEED, color=color)
    draw_mean_curve(axis, mean, color, words)
    spans = [(start, y[0]) for _, y, start in runs]
    if not mean.is_apart:
        spans = [(float(np.mean([start for start, _ in spans])), mean.mean[0])]
    for end, y in spans:
        if end:
            axis.plot([0, end], [y, y], **_SPAN, color=color, markevery=[1])
    if has_running_best:
        best = mean_curve(*((x, np.maximum.accumulate(y)) for x, y in curves))
        for x, y in best.singles if best.is_apart else [(best.grid, best.mean)]:
            axis.plot(x, y, **_RUNNING_BEST, color=color)
    return mean


def _notes(panels: Sequence[Panel], means: Sequence[MeanCurve], references_note: str) -> list[tuple[Artist, str]]:
    """Return the entries that say what lines and bands are."""
    keys = legend_keys(means, "seeds")
    if any(mean.band is None and len(mean.values) > 2 and not mean.is_apart for mean in means):
        keys.append((Line2D([], [], **_SEED, color="black"), "thin lines: seeds, where a band would be too wide"))
    if any(panel.has_running_best for panel in panels):
        keys.append((Line2D([], [], **_RUNNING_BEST, color="black"), "dashed: running best, as the authors plot it"))
    if any(curve.is_after_primitive for panel in panels for curve in panel.curves):
        keys.append((Line2D([], [], **_SPAN, color="black"), "dotted: training of the primitive"))
    if any(panel.references for panel in panels):
        words = "\n".join(textwrap.wrap(f"grey: {references_note}", 90))
        keys.append((Line2D([], [], **_REFERENCE), words))
    return keys
