"""Figure 6 of an experiment as a figure of plotly: speed-up over cores, beside the paper's. Source: SHES paper."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from statistics import fmean
from typing import Any

from shes.viewing.report.curve_charts import Figure, numbered_look
from shes.viewing.report.experiment_design import DesignedSpeedup

_LOOKS: dict[str, dict[str, Any]] = {
    "projected": {"mode": "lines"},
    "measured": {"mode": "markers", "marker": {"size": 7}},
    "asleep": {"mode": "markers", "marker": {"size": 8, "symbol": "square-open"}},
}
"""Look of each kind of row."""
_CROSS = {"size": 8, "symbol": "x-thin-open"}
_LEGEND_PIXELS, _FRAME_PIXELS = 20, 400

_Rows = Mapping[tuple[str, str], Sequence[Mapping[str, str]]]
"""Rows of `curves.csv` by group and variant."""


def speedup_figure(chart: DesignedSpeedup, rows: _Rows) -> Figure:
    """Return the chart of these rows, which has no data without measurements.

    Raises:
        ValueError: A number cannot be read.
    """
    curves = [trace for number in range(len(chart["curves"])) for trace in _curve_traces(chart, number, rows)]
    most = max((cores for trace in curves for cores in trace["x"]), default=1)
    perfect = {"x": [1, most], "y": [1, most], "name": "perfect", "line": {"color": "--ink", "width": 1}}
    data = [_trace({"mode": "lines", **perfect}), *_published(chart), *curves] if curves else []
    layout = {
        "title": {"text": escape(f"{chart['title']}: speed-up")},
        "height": _FRAME_PIXELS + _LEGEND_PIXELS * len(data),
        "showlegend": True,
        "hovermode": "closest",
        "xaxis": {"type": "log", "title": {"text": "cores"}, "dtick": 1},
        "yaxis": {"type": "log", "title": {"text": "speed-up"}, "dtick": 1},
    }
    return {"data": data, "layout": layout}


def _curve_traces(chart: DesignedSpeedup, number: int, rows: _Rows) -> Iterator[dict[str, Any]]:
    """Yield a trace for each kind of rows of a curve, with the mean over seeds."""
    curve, (color, _) = chart["curves"][number], numbered_look(number)
    own = rows.get((curve["group"], curve["variant"]), ())
    for kind, look in _LOOKS.items():
        if points := _points(own, kind):
            cores, speedup = zip(*points, strict=True)
            words = escape(f"{curve['words']}, {chart['kinds'].get(kind, kind)}")
            colors = {"line": {"color": color}, "marker": {"color": color, **look.get("marker", {})}}
            yield _trace({**look, **colors, "name": words, "x": list(cores), "y": list(speedup)})


def _points(rows: Iterable[Mapping[str, str]], kind: str) -> list[tuple[float, float]]:
    """Return cores and mean speed-ups of the rows of one kind that are known, by cores."""
    by_cores: dict[float, list[float]] = {}
    for row in rows:
        if row.get("kind") == kind and row.get("speedup"):
            by_cores.setdefault(float(row["cores"]), []).append(float(row["speedup"]))
    return [(cores, fmean(by_cores[cores])) for cores in sorted(by_cores)]


def _published(chart: DesignedSpeedup) -> Iterator[dict[str, Any]]:
    """Yield the traces of published speed-ups."""
    for series in chart["series"]:
        color = "--ink" if series["color"] < 0 else numbered_look(series["color"])[0]
        line = {"mode": "lines", "line": {"color": color, "dash": "dot", "width": 1.5}}
        points = {"mode": "markers", "marker": {"color": color, **_CROSS}}
        look = line if series["is_line"] else points
        yield _trace({**look, "name": escape(series["words"]), "x": series["cores"], "y": series["speedup"]})


def _trace(trace: dict[str, Any]) -> dict[str, Any]:
    return {"type": "scatter", "hovertemplate": "%{x:~g} cores: %{y:.3~g} times as fast", **trace}
