"""A chart of an experiment's learning curves as a figure of plotly: means, bands, running best, published results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from shes.types import F64Array
from shes.viewing.curves import mean_curve
from shes.viewing.report.curve_charts import X_AXES, Figure, mean_traces, numbered_look, numbers
from shes.viewing.report.experiment_design import DesignedChart, DesignedCurve, DesignedReference

MOST_BANDS = 10
"""Curves of a figure that have a band: more could not be told apart."""
_COLUMNS = {"env_steps": "env_steps", "wall_time_s": "seconds"}
"""Columns of `curves.csv` by those of a run's tables."""
_LEGEND_PIXELS, _FRAME_PIXELS = 20, 300
_RUNNING_BEST = "running best, as the authors plot it"
_REFERENCE_DASHES = ("solid", "12px,4px", "dot", "dashdot", "2px,6px")
"""Dashes of references, other than those of the running best."""

Row = Mapping[str, str]
Place = tuple[str, str, str]
"""Environment, group, variant."""
RunKey = tuple[str, str]
"""Seed, and digest of the settings; the digest is empty in a table without it."""
Rows = Mapping[Place, Mapping[RunKey, Sequence[Row]]]
"""Rows of `curves.csv` by place, then by run."""


def chart_title(chart: DesignedChart) -> str:
    """Return the title: the environment and what is drawn."""
    return f"{chart['title']}: {chart['words']}"


def has_column(run: Sequence[Row], column: str) -> bool:
    """Return whether every row of a run has a value in `column`."""
    return all(row.get(column) for row in run)


def current(runs: Sequence[RunKey]) -> list[RunKey]:
    """Return those of the `runs` of a variant that have the settings of the first one: the table begins with them."""
    return [run for run in runs if run[1] == runs[0][1]]


def chart_figure(chart: DesignedChart, rows: Rows, x: str) -> Figure:
    """Return a chart over `x`; over the chart's own axis if it does not have `x`, and over steps without times.

    Raises:
        ValueError: A number cannot be read.
    """
    drawn, num_others = _drawn(chart, rows)
    has_time = all(has_column(run, "seconds") for runs in drawn.values() for run in runs)
    x = "env_steps" if not has_time else x if x in chart["axes"] else chart["axes"][0]
    label, factor, ticks = X_AXES[x]
    data: list[dict[str, Any]] = []
    best: list[dict[str, Any]] = []
    for number, runs in drawn.items():
        is_after = chart["curves"][number]["is_after_primitive"]
        xs = [np.array([_since_start(row, _COLUMNS[x], is_after) for row in run]) * factor for run in runs]
        ys = [np.array([float(row[chart["column"]]) for row in run]) for run in runs]
        words = f"{chart['curves'][number]['words']} ({len(runs)} seed{'s' * (len(runs) != 1)})"
        if is_after:
            starts = [float(run[0][f"primitive_{_COLUMNS[x]}"]) * factor for run in runs]
            data.append(_before(number, starts, xs, ys))
        data += _curve(words, number, xs, ys, has_band=len(drawn) <= MOST_BANDS)
        if chart["has_running_best"]:
            best.append(_best(words, number, xs, ys))
    if data:
        data += [*best, *([_best_legend()] if best else []), *_references(chart["references"], data)]
    layout = {
        "title": {"text": escape(chart_title(chart)) + _note(num_others)},
        "height": _FRAME_PIXELS + _LEGEND_PIXELS * sum(trace.get("showlegend", True) for trace in data),
        "showlegend": True,
        "xaxis": {"title": {"text": label}, "tickformat": ticks},
    }
    return {"data": data, "layout": layout}


def _drawn(chart: DesignedChart, rows: Rows) -> tuple[dict[int, list[Sequence[Row]]], int]:
    """Return the runs of each curve that has any, by its number, and how many of other settings are left out."""
    drawn: dict[int, list[Sequence[Row]]] = {}
    num_others = 0
    for number, curve in enumerate(chart["curves"]):
        runs = rows.get((chart["env"], curve["group"], curve["variant"]), {})
        full = [run for run, found in runs.items() if has_column(found, chart["column"])]
        own = [run for run in current(list(runs)) if run in full]
        num_others += len(full) - len(own)
        if found := [runs[run] for run in own if _has_start(runs[run], curve)]:
            drawn[number] = found
    return drawn, num_others


def _has_start(run: Sequence[Row], curve: DesignedCurve) -> bool:
    """Return whether it is known where a curve begins: a run would begin too early without its primitive's time."""
    columns = ("primitive_env_steps", "primitive_seconds")
    return not curve["is_after_primitive"] or all(has_column(run, column) for column in columns)


def _since_start(row: Row, column: str, is_after_primitive: bool) -> float:
    """Return the environment steps or seconds since a run began, or since the training of its primitive did."""
    return float(row[column]) + (float(row.get(f"primitive_{column}") or 0) if is_after_primitive else 0.0)


def _curve(
    words: str, number: int, xs: Sequence[F64Array], ys: Sequence[F64Array], *, has_band: bool
) -> list[dict[str, Any]]:
    """Return mean and band of the curve with this number; one entry of the legend shows and hides both."""
    traces = mean_traces(words, numbered_look(number), xs, ys)
    return [{**trace, "legendgroup": str(number)} for trace in traces if "name" in trace or has_band]


def _before(number: int, starts: Sequence[float], xs: Sequence[F64Array], ys: Sequence[F64Array]) -> dict[str, Any]:
    """Return dotted lines from 0 to where the training of the primitives ended: one of the mean, if there is one."""
    curve, (color, _) = mean_curve(xs, ys), numbered_look(number)
    spans = [(start, float(y[0])) for start, y in zip(starts, ys, strict=True)]
    if not curve.is_apart:
        spans = [(float(np.mean(starts)), float(curve.mean[0]))]
    x = np.array([value for end, _ in spans for value in (0.0, end, np.nan)])  # one trace, with a gap after each line
    y = np.array([value for _, height in spans for value in (height, height, np.nan)])
    look = {"mode": "lines", "line": {"color": color, "width": 1, "dash": "dot"}, "hoverinfo": "skip"}
    own = {"legendgroup": str(number), "showlegend": False}
    return {"type": "scatter", "x": numbers(x), "y": numbers(y), **look, **own}


def _best(words: str, number: int, xs: Sequence[F64Array], ys: Sequence[F64Array]) -> dict[str, Any]:
    """Return the mean of the running maxima of a curve's runs, which is shown and hidden with the curve."""
    *_, trace = mean_traces(f"{words}, running best", numbered_look(number), xs, [np.maximum.accumulate(y) for y in ys])
    line = {**trace["line"], "dash": "dash", "width": 1}
    own = {"mode": "lines", "line": line, "legendgroup": str(number), "showlegend": False, "meta": {"best": "curve"}}
    return {**trace, **own}


def _best_legend() -> dict[str, Any]:
    """Return the entry of the legend that shows and hides every running best."""
    look = {"mode": "lines", "line": {"color": "--ink", "dash": "dash", "width": 1}}
    return {"type": "scatter", "name": _RUNNING_BEST, "x": [None], "y": [None], **look, "meta": {"best": "legend"}}


def _references(references: Sequence[DesignedReference], curves: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return a horizontal line for each reference, as wide as the `curves`."""
    every = [x for trace in curves for x in trace["x"] if x is not None]
    return [
        {
            "type": "scatter",
            "name": escape(f"{reference['words']}: {reference['value']:g}"),
            "x": numbers(np.array([min(every), max(every)])),
            "y": [reference["value"]] * 2,
            "mode": "lines",
            "line": {"color": "--faint", "width": 1, "dash": _REFERENCE_DASHES[number % len(_REFERENCE_DASHES)]},
            "hoverinfo": "skip",
        }
        for number, reference in enumerate(references)
    ]


def _note(num_others: int) -> str:
    """Return the line below a title that says how many runs are left out; empty if none is."""
    is_one = num_others == 1
    words = f"{num_others} run{'s' * (not is_one)} of other settings {'is' if is_one else 'are'} left out"
    return f"<br><sub>{words}</sub>" if num_others else ""
