"""The figure of learning curves: a panel per environment, with the legend of each below it.

References are grey lines with a marker at the right edge.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from itertools import cycle
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.design import Measure
from experiments.figures import WIDTH
from experiments.results import PlacedResults
from shes.types import F64Array
from shes.viewing.curves import MeanCurve, mean_curve
from shes.viewing.plot import draw_mean_curve, legend_keys

_PANEL_INCHES, _LINE_INCHES = 3.2, 0.19
_UNITS = {"seconds": (60.0, "minutes"), "env_steps": (1e6, "million environment steps")}
"""Units of an abscissa with their names."""
_REFERENCE: dict[str, Any] = {"color": "0.45", "linewidth": 0.8, "markersize": 5}
_MARKERS = ("s", "^", "D", "v", "o", "P")
_RUNNING_BEST: dict[str, Any] = {"linewidth": 1, "linestyle": "--"}
_SPAN: dict[str, Any] = {"linewidth": 1, "linestyle": ":", "marker": "|"}

_Key = tuple[Artist, str]
"""Handle and words of an entry of a legend."""


class Curve(NamedTuple):
    """A line of a figure: the runs of a variant."""

    group: str
    variant: str
    words: str = ""
    """Its name in the legend; that of tables if empty."""
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
    results: PlacedResults, panels: Sequence[Panel], columns: int, references_note: str = "published results"
) -> Figure | None:
    """Return a figure with the panels of which there are results, `columns` in a row."""
    panels = [each for each in panels if any((each.env, *curve[:2]) in results.runs for curve in each.curves)]
    groups = {curve.group for panel in panels for curve in panel.curves}
    if not panels or not results.has(*groups):
        return None
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    figure, axes = plt.subplots(rows, columns, layout="constrained", squeeze=False)
    means: list[MeanCurve] = []
    lines = [0] * rows
    for number, (axis, panel) in enumerate(zip(axes.ravel(), panels, strict=False)):
        keys, drawn = _draw_panel(axis, results, panel)
        means += drawn
        handles, words = zip(*keys, strict=True)
        axis.legend(handles, words, fontsize="small", frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.18))
        lines[number // columns] = max(lines[number // columns], len(keys))
    for axis in axes.ravel()[len(panels) :]:
        axis.set_axis_off()
    if notes := _notes(panels, means, references_note):
        handles, words = zip(*notes, strict=True)
        figure.legend(handles, words, loc="outside lower center", fontsize="small", frameon=False)
        lines.append(sum(1 + text.count("\n") for text in words))
    figure.set_size_inches(WIDTH, rows * _PANEL_INCHES + (1 + sum(lines)) * _LINE_INCHES)
    figure.draw_without_rendering()  # the layout changes ticks, whose labels need another one when it is saved
    return figure


def _draw_panel(axis: Axes, results: PlacedResults, panel: Panel) -> tuple[list[_Key], list[MeanCurve]]:
    """Draw the curves and references of a panel; return the entries of its legend, and the means."""
    found = [(number, curve, _runs(results, panel, curve)) for number, curve in enumerate(panel.curves)]
    found = [each for each in found if each[-1]]
    unit, unit_words = _UNITS[panel.x]
    keys, means = list[_Key](), list[MeanCurve]()
    for number, curve, runs in found:
        color, words = f"C{number}", curve.words or results.experiment.label(curve.variant)
        scaled = [(x / unit, y, start / unit) for x, y, start in runs]
        means.append(_draw_curve(axis, scaled, color, words, has_running_best=panel.has_running_best))
        keys.append((Line2D([], [], color=color), words))
    for (words, value), marker in zip(panel.references.items(), cycle(_MARKERS)):
        axis.axhline(value, **_REFERENCE, marker=marker, markevery=[1], clip_on=False, label=words)
        keys.append((Line2D([], [], **_REFERENCE, marker=marker), words))
    seeds = sorted({len(runs) for _, _, runs in found})
    count = f"{' or '.join(map(str, seeds))} seed{'s' * (seeds[-1:] != [1])}"
    axis.set_title(f"{panel.title} ({count})", fontsize="medium")
    axis.set(ylabel=panel.measure.words, xlabel=unit_words)
    axis.grid(alpha=0.3)
    return keys, means


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


def _draw_curve(axis: Axes, runs: Sequence[_Scores], color: str, words: str, *, has_running_best: bool) -> MeanCurve:
    """Draw the mean over seeds, the training of their primitives before it and the running best; return the mean."""
    mean = mean_curve(*((x, y) for x, y, _ in runs))
    draw_mean_curve(axis, mean, color, words)
    spans = [(start, y[0]) for _, y, start in runs]
    if not mean.is_apart:
        spans = [(float(np.mean([start for start, _ in spans])), mean.mean[0])]
    for end, y in spans:
        if end:
            axis.plot([0, end], [y, y], **_SPAN, color=color, markevery=[1])
    if has_running_best:
        best = mean_curve(*((x, np.maximum.accumulate(y)) for x, y, _ in runs))
        for x, y in best.singles if best.is_apart else [(best.grid, best.mean)]:
            axis.plot(x, y, **_RUNNING_BEST, color=color)
    return mean


def _notes(panels: Sequence[Panel], means: Sequence[MeanCurve], references_note: str) -> list[_Key]:
    """Return the entries that say what lines and bands are."""
    keys = legend_keys(means, "seeds")
    if any(panel.has_running_best for panel in panels):
        keys.append((Line2D([], [], **_RUNNING_BEST, color="black"), "dashed: running best, as the authors plot it"))
    if any(curve.is_after_primitive for panel in panels for curve in panel.curves):
        keys.append((Line2D([], [], **_SPAN, color="black"), "dotted: training of the primitive"))
    if any(panel.references for panel in panels):
        words = "\n".join(textwrap.wrap(f"grey, with marks: {references_note}", 74))
        keys.append((Line2D([], [], **_REFERENCE), words))
    return keys
