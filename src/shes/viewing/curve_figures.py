"""Learning curves and diagnostics as figures of plotly: a panel for each column of the tables, on three axes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np

from shes.types import F64Array, FloatArray
from shes.viewing.curves import X_AXES, column_curve
from shes.viewing.groups import Group, RunData
from shes.viewing.report_page import Figure

SECTIONS = ("Returns and scores", "Diagnostics")
_MOST_POINTS = 1000
"""Of a longer curve every k-th point is drawn: a screen has no more pixels."""
_FEW_POINTS = 30
"""Below so many a curve has markers."""
_COLORS = (
    "#1f77b4", "#d9660b", "#2a8f2a", "#d62728", "#8a5fb8", "#8c564b", "#d45ca9", "#6f6f6f", "#98990f", "#119fae",
)  # fmt: skip
_DASHES = ("solid", "dash", "dot", "dashdot")
_BAND_ALPHA = "2e"  # in hexadecimal, after a colour
_COLUMNS, _PANEL_PIXELS, _FRAME_PIXELS, _GAP_PIXELS = 3, 290, 180, 70


class Panel(NamedTuple):
    """A column of a table to be drawn."""

    section: str
    table: str
    column: str

    @property
    def title(self) -> str:
        """The quantity, and the episodes that it is of."""
        words = self.column.removesuffix("_mean").replace("_", " ")
        return words if self.section == SECTIONS[1] else f"{words}, {self.table.replace('progress', 'training')}"


def panels_of(runs: Sequence[RunData]) -> list[Panel]:
    """Return the panels of all columns that change in a run, by section; in each, evaluation comes first."""
    found: dict[Panel, None] = {}
    for table in ("evaluation", "progress"):
        for run in runs:
            for column, values in run.tables[table].items():
                section, finite = _section(column), values[np.isfinite(values)]
                if section and len(finite) and (finite.min() < finite.max() or len(values) == 1):
                    found[Panel(section, table, column)] = None
    return sorted(found, key=lambda panel: SECTIONS.index(panel.section))


def _section(column: str) -> str | None:
    """Return the section of a column; None if it is an abscissa, a time or a spread, which have other places."""
    is_rate = column == "env_steps_per_s"
    if column in X_AXES or (column.endswith(("_s", "_std")) and not is_rate):
        return None
    is_outcome = column.startswith(("score", "success_rate", "return")) or column.endswith("_return_mean")
    return SECTIONS[0] if is_outcome or "goals_reached" in column else SECTIONS[1]


def curve_figure(panels: Sequence[Panel], groups: Sequence[Group]) -> Figure:
    """Return a figure of `panels` with a curve for each of `groups`, and buttons that choose one of `X_AXES`."""
    data: list[dict[str, Any]] = []
    for x in X_AXES:
        named = set[str]()
        for place, panel in enumerate(panels, 1):
            for group in groups:
                own = {"xaxis": _axis("x", place), "yaxis": _axis("y", place), "legendgroup": group.label}
                for trace in _traces(panel, group, x):
                    is_entry = "name" in trace and group.label not in named
                    named |= {group.label} if is_entry else set()
                    data.append({**trace, **own, "showlegend": is_entry, "visible": x == "env_steps", "meta": x})
    return {"data": data, "layout": _layout(panels, [trace["meta"] for trace in data])}


def _axis(letter: str, place: int) -> str:
    return letter if place == 1 else f"{letter}{place}"


def _layout(panels: Sequence[Panel], abscissae: Sequence[str]) -> dict[str, Any]:
    """Return the layout of `panels`, whose traces are over `abscissae`."""
    columns = min(_COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    axes = [_axis("xaxis", place) for place in range(1, len(panels) + 1)]
    buttons = [
        {
            "method": "update",
            "label": label,
            "args": [{"visible": [each == x for each in abscissae]}, {f"{axis}.title.text": label for axis in axes}],
        }
        for x, (label, _) in X_AXES.items()
    ]
    above = {"x": 0, "xanchor": "left", "y": 1, "yanchor": "bottom", "showarrow": False}
    titles = [
        {"text": escape(panel.title), "xref": f"{axis} domain", "yref": f"{axis.replace('x', 'y')} domain", **above}
        for axis, panel in zip([_axis("x", place) for place in range(1, len(panels) + 1)], panels, strict=True)
    ]
    menu = {"type": "buttons", "direction": "right", "x": 0, "xanchor": "left", "y": 1, "yanchor": "bottom"}
    return {
        "grid": {"rows": rows, "columns": columns, "pattern": "independent", "ygap": _GAP_PIXELS / _PANEL_PIXELS},
        "height": _FRAME_PIXELS + _PANEL_PIXELS * rows,
        "margin": {"l": 60, "r": 20, "t": 90, "b": 90},
        "hovermode": "x unified",
        "annotations": titles,
        "updatemenus": [{**menu, "pad": {"b": 35}, "buttons": buttons}],
        "legend": {"orientation": "h", "yref": "container", "y": 0, "yanchor": "bottom"},
        **{axis: {"title": {"text": X_AXES["env_steps"][0]}} for axis in axes},
    }


def _traces(panel: Panel, group: Group, x: str) -> Iterator[dict[str, Any]]:
    """Yield the band and the curve of a group; see `column_curve`."""
    tables = [run.tables[panel.table] for run in group.runs]
    tables = [table for table in tables if panel.column in table and x in table]
    if not tables:
        return
    curve = column_curve(tables, panel.column, x)
    color, dash = _COLORS[group.number % len(_COLORS)], _DASHES[group.number // len(_COLORS) % len(_DASHES)]
    silent = {"type": "scatter", "mode": "lines", "hoverinfo": "skip"}
    named = {"type": "scatter", "name": escape(group.label), "hovertemplate": "%{y:.4~g}"}
    if curve.band is not None:
        for bound, fill in zip(curve.band, ({}, {"fill": "tonexty", "fillcolor": color + _BAND_ALPHA}), strict=True):
            yield {**silent, **_points(curve.grid, bound), "line": {"width": 0, "color": color}, **fill}
    for number, run in enumerate(curve.singles):
        look = {**named, "mode": "lines"} if curve.is_apart and number == 0 else silent
        yield {**look, **_points(*run), "line": {"color": color, "dash": dash, "width": 1}}
    if not curve.is_apart:
        mode = "lines+markers" if len(curve.grid) < _FEW_POINTS else "lines"
        line = {"color": color, "dash": dash, "width": 2}
        yield {**named, **_points(curve.grid, curve.mean), "mode": mode, "line": line}


def _points(x: F64Array, y: F64Array) -> dict[str, Any]:
    every = max(1, -(-len(x) // _MOST_POINTS))
    return {"x": numbers(x[::every]), "y": numbers(y[::every])}


def numbers(values: FloatArray) -> list[float | None]:
    """Return `values` with six digits for JSON, which has neither NaN nor infinity."""
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values.tolist()]
