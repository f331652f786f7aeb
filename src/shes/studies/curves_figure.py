"""The figure of a study's learning curves: a panel per environment, and one legend below them.

References are grey lines with a marker at the right edge, named below their panel. Curves that all panels share are
named in the figure's legend, others below their panel.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from itertools import cycle
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from shes.studies.design import Curve, CurvePanel, Curves
from shes.studies.placed_results import PlacedResults
from shes.types import F64Array
from shes.viewing.curves import MeanCurve, mean_curve
from shes.viewing.plot import draw_mean_curve, legend_keys

_PANEL_INCHES, _LINE_INCHES = 3.2, 0.19
_CHARACTERS = 74
"""Of a line in a column of the legend."""
_UNITS = {
    "hours": ((1.0, "seconds"), (60.0, "minutes"), (3600.0, "hours")),
    "env_steps": ((1.0, "environment steps"), (1e3, "thousand environment steps"), (1e6, "million environment steps")),
}
"""Units of an abscissa, in seconds and steps, with their names."""
_COLUMN = {"hours": "seconds", "env_steps": "env_steps"}
_REFERENCE: dict[str, Any] = {"color": "0.45", "linewidth": 0.8, "markersize": 5}
_MARKERS = ("s", "^", "D", "v", "o", "P")
"""Of references: dashes are those of curves."""
_RUNNING_BEST: dict[str, Any] = {"linewidth": 1, "linestyle": "--"}
_SPAN: dict[str, Any] = {"linewidth": 1, "linestyle": ":", "marker": "|"}

_Key = tuple[Artist, str]
"""Handle and words of an entry of a legend."""


class _Run(NamedTuple):
    """A run's curve."""

    x: F64Array
    """Steps, or seconds, since its training began, that of its primitive included."""
    y: F64Array
    of_primitive: float
    """Those of its primitive's training."""


class _Drawn(NamedTuple):
    """A curve in a panel."""

    number: int
    """Place among the curves of its panel, which says its colour."""
    words: str
    seeds: int
    curve: MeanCurve
    is_after_primitive: bool


def draw_curves(results: PlacedResults, figure_of: Curves, width: float) -> Figure:
    """Return a figure with panels of measures over environment steps or time: those of which there are results.

    `width` is in inches.
    """
    panels = [each for each in figure_of.panels if _has_results(results, each)] or list(figure_of.panels)
    columns = min(figure_of.columns or len(panels), len(panels))
    rows = -(-len(panels) // columns)
    figure, axes = plt.subplots(rows, columns, layout="constrained", squeeze=False)
    drawn = [_draw_panel(axis, results, panel) for axis, panel in zip(axes.ravel(), panels, strict=False)]
    has_shared = len({panel.curves for panel in panels}) == 1
    own = [
        _draw_panel_legend(axis, panel, [] if has_shared else _curve_keys(curves))
        for axis, panel, curves in zip(axes.ravel(), panels, drawn, strict=False)
    ]
    every = [curve for curves in drawn for curve in curves]
    columns_of_legend = [_curve_keys(every) if has_shared else [], _keys(panels, every, figure_of.references_note)]
    lines = _draw_legend(figure, columns_of_legend)
    lines += sum(max(own[start : start + columns]) for start in range(0, len(own), columns))
    figure.set_size_inches(width, rows * _PANEL_INCHES + (1 + lines) * _LINE_INCHES)
    for axis in axes.ravel()[len(panels) :]:
        axis.set_axis_off()
    figure.draw_without_rendering()  # the layout changes ticks, whose labels need another one when it is saved
    return figure


def _draw_legend(figure: Figure, columns: Sequence[Sequence[_Key]]) -> int:
    """Draw a legend below the panels with these columns; return the number of its lines."""
    filled = [column for column in columns if column]
    if not filled:
        return 0
    longest = max(map(len, filled))
    blank: _Key = (Line2D([], [], linestyle="none"), "")
    keys = [key for column in filled for key in (*column, *[blank] * (longest - len(column)))]
    handles, words = zip(*keys, strict=True)
    figure.legend(handles, words, loc="outside lower center", ncols=len(filled), fontsize="small", frameon=False)
    return max(sum(1 + words.count("\n") for _, words in column) for column in filled)


def _has_results(results: PlacedResults, panel: CurvePanel) -> bool:
    """Return whether a curve of the panel has a finished run."""
    return any((panel.env, curve.group, curve.variant) in results.summaries for curve in panel.curves)


def _draw_panel(axis: Axes, results: PlacedResults, panel: CurvePanel) -> list[_Drawn]:
    """Draw the curves and references of a panel; return the curves."""
    measure = panel.measure or results.design.curves[panel.env]
    found = [(number, curve, _runs(results, panel, curve, measure.column)) for number, curve in enumerate(panel.curves)]
    unit, unit_words = _unit(panel, max((_mean(runs).end for _, _, runs in found if runs), default=0.0))
    drawn: list[_Drawn] = []
    for number, curve, runs in found:
        if runs:
            scaled = [_Run(run.x / unit, run.y, run.of_primitive / unit) for run in runs]
            words = curve.words or results.design.label(curve.variant)
            mean = _draw_curve(axis, scaled, words, f"C{number}", has_running_best=panel.has_running_best)
            drawn.append(_Drawn(number, words, len(runs), mean, curve.is_after_primitive))
    for (words, value), marker in zip(panel.references, cycle(_MARKERS)):
        axis.axhline(value, **_REFERENCE, marker=marker, markevery=[1], clip_on=False, label=words)
    axis.set_title(panel.title, fontsize="medium", fontweight="bold")
    axis.set_ylabel(measure.words)
    axis.set_xlabel(unit_words)
    axis.grid(alpha=0.3)
    return drawn


def _unit(panel: CurvePanel, longest: float) -> tuple[float, str]:
    """Return the largest unit of the abscissa of which a curve that ends at `longest` has two, and its name."""
    units = _UNITS[panel.x]
    return next((each for each in reversed(units) if longest >= 2 * each[0]), units[0])


def _mean(runs: Sequence[_Run]) -> MeanCurve:
    return mean_curve([run.x for run in runs], [run.y for run in runs])


def _runs(results: PlacedResults, panel: CurvePanel, curve: Curve, column: str) -> list[_Run]:
    """Return the finished runs of a curve, without those that would begin too early."""
    name, found = _COLUMN[panel.x], list[_Run]()
    for run in results.summaries.get((panel.env, curve.group, curve.variant), ()):
        starts = [row.get(f"primitive_{name}") if curve.is_after_primitive else 0.0 for row in run.curve]
        if starts and None not in starts:
            before = np.array(starts, dtype=np.float64)
            x, y = (np.array([row[each] for row in run.curve], dtype=np.float64) for each in (name, column))
            found.append(_Run(before + x, y, float(before[0])))
    return found


def _draw_curve(axis: Axes, runs: Sequence[_Run], words: str, color: str, *, has_running_best: bool) -> MeanCurve:
    """Draw the mean over seeds, the training of their primitives before it and the running best; return the mean."""
    mean = _mean(runs)
    draw_mean_curve(axis, mean, color, words)
    spans = [(run.of_primitive, run.y[0]) for run in runs]
    if not mean.is_apart:
        spans = [(float(np.mean([end for end, _ in spans])), mean.mean[0])]
    for end, y in spans:
        if end:
            axis.plot([0, end], [y, y], **_SPAN, color=color, markevery=[1])
    if has_running_best:
        best = _mean([run._replace(y=np.maximum.accumulate(run.y)) for run in runs])
        for x, y in best.singles if best.is_apart else [(best.grid, best.mean)]:
            axis.plot(x, y, **_RUNNING_BEST, color=color)
    return mean


def _draw_panel_legend(axis: Axes, panel: CurvePanel, curves: Sequence[_Key]) -> int:
    """Name `curves` and the references of a panel below it; return the number of lines."""
    references: list[_Key] = [
        (Line2D([], [], **_REFERENCE, marker=marker), words)
        for (words, _), marker in zip(panel.references, cycle(_MARKERS))
    ]
    if keys := [*curves, *references]:
        handles, words = zip(*keys, strict=True)
        axis.legend(handles, words, fontsize="small", frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.18))
    return len(keys)


def _curve_keys(curves: Sequence[_Drawn]) -> list[_Key]:
    """Return an entry for each of the different curves, with its number of seeds, in the order of the panels."""
    keys: list[_Key] = []
    for number, words in sorted({(curve.number, curve.words) for curve in curves}):
        seeds = sorted({curve.seeds for curve in curves if (curve.number, curve.words) == (number, words)})
        numbers = f"{seeds[0]} to {seeds[-1]}" if len(seeds) > 2 else " or ".join(map(str, seeds))
        keys.append((Line2D([], [], color=f"C{number}"), f"{words} ({numbers} seed{'s' * (seeds[-1] != 1)})"))
    return keys


def _keys(panels: Sequence[CurvePanel], curves: Sequence[_Drawn], references_note: str) -> list[_Key]:
    """Return the entries that say what lines and bands are."""
    keys = legend_keys([each.curve for each in curves], "seeds")
    if curves and any(panel.has_running_best for panel in panels):
        keys.append((Line2D([], [], **_RUNNING_BEST, color="black"), "dashed: running best, as the authors plot it"))
    if any(each.is_after_primitive for each in curves):
        has_scores = any(panel.measure is not None and panel.measure.column == "score_mean" for panel in panels)
        words = "dotted: training of the primitive" + ", which scores 0 in comparisons" * has_scores
        keys.append((Line2D([], [], **_SPAN, color="black"), words))
    if any(panel.references for panel in panels):
        words = "\n".join(textwrap.wrap(f"grey, with marks: {references_note}", _CHARACTERS))
        keys.append((Line2D([], [], **_REFERENCE), words))
    return keys
