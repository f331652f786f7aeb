"""Learning curves and diagnostics as figures of plotly: a panel for each column of the tables, on three axes.

Figures are plain dictionaries. A colour that begins with `--` is a variable of the style sheet, with an opacity after a
slash; the page fills it in. Plotly reads texts as HTML, so those from files are escaped.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from shes.types import F64Array, FloatArray
from shes.viewing.curves import mean_curve
from shes.viewing.report.reading import ReportedGroup, ReportedRun, Table

X_AXES = {
    "env_steps": ("environment steps", 1.0, "~s"),
    "wall_time_s": ("minutes", 1 / 60, ""),
    "generation": ("generation", 1.0, ""),
}
"""Abscissae: column of the tables -> label, factor of the column's values, and format of the ticks."""
SECTIONS = ("Returns and scores", "Goals", "Diagnostics", "Speed")
_MOST_POINTS = 1000
"""Of a longer curve every k-th point is drawn: a screen has no more pixels."""
_FEW_POINTS = 30
"""Below so many a curve has markers."""
_DASHES = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
_COLORS = 10
_SIGNIFICANT = 6
_BAND_OPACITY = 0.18

Figure = dict[str, Any]


@dataclass(frozen=True, kw_only=True, order=True)
class Panel:
    """A column of a table to be drawn."""

    section: int
    """Index in `SECTIONS`."""
    table: str
    column: str

    @property
    def title(self) -> str:
        """Heading of the panel: the quantity, and the episodes it is of where there are two kinds."""
        words = self.column.removesuffix("_mean").replace("_", " ").replace("env steps per s", "steps per second")
        is_of_both = any(
            name in self.column for name in ("return", "score", "success", "goals_reached", "episode_steps")
        )
        return f"{words}, {self.table.replace('progress', 'training')}" if is_of_both else words


def panels_of(runs: Sequence[ReportedRun]) -> list[Panel]:
    """Return the panels of all columns that change in a run, by section; in each, evaluation comes first."""
    found: dict[Panel, None] = {}
    for table in ("evaluation", "progress"):
        for run in runs:
            for column, values in run.tables[table].items():
                section = _section(table, column)
                if section is not None and _changes(values):
                    found[Panel(section=section, table=table, column=column)] = None
    return sorted(found, key=lambda panel: panel.section)


def constants(runs: Sequence[ReportedRun]) -> dict[str, list[str]]:
    """Return the columns that change in no run, in words, with their different values as text."""
    panels = {(panel.table, panel.column) for panel in panels_of(runs)}
    found: dict[str, list[str]] = {}
    for run in runs:
        for column, values in run.tables["progress"].items():
            if _section("progress", column) is None or ("progress", column) in panels or not len(values):
                continue
            text = f"{values[0]:g}" if np.isfinite(values[0]) else "none"
            texts = found.setdefault(column.replace("_", " "), [])
            if text not in texts:
                texts.append(text)
    return found


def _section(table: str, column: str) -> int | None:
    """Return the section of a column; None if it is an abscissa, or drawn with another one or elsewhere."""
    if column == "env_steps_per_s":
        return 3
    if column in X_AXES or column.endswith(("_s", "_std")) or (table, column) == ("evaluation", "episodes"):
        return None
    if "goals_reached" in column or (table == "evaluation" and column == "primitive_return_mean"):
        return 1
    is_outcome = column.startswith(("score", "success_rate", "return")) or column.endswith("_return_mean")
    return 0 if is_outcome else 2


def _changes(values: F64Array) -> bool:
    finite = values[np.isfinite(values)]
    return len(finite) > 0 and (finite.min() < finite.max() or len(values) == 1)


def curve_figure(panel: Panel, groups: Sequence[ReportedGroup], x: str, env: str = "") -> Figure:
    """Return the figure of a panel: a curve for each group, with its band, over the column `x`.

    `env` is the environment to be named beside the quantity, if the report has several.
    """
    label, factor, ticks = X_AXES[x]
    data: list[dict[str, Any]] = []
    for group in groups:
        tables = [run.tables[panel.table] for run in group.runs]
        data += _traces(panel, group, [table for table in tables if panel.column in table and x in table], x, factor)
    layout = {
        "title": {"text": escape(f"{env}: {panel.title}" if env else panel.title)},
        "xaxis": {"title": {"text": label}, "tickformat": ticks},
    }
    return {"data": data, "layout": layout}


def _traces(panel: Panel, group: ReportedGroup, tables: list[Table], x: str, factor: float) -> Iterator[dict[str, Any]]:
    """Yield the band and the curve of a group, from the `tables` of its runs."""
    if tables:
        xs, ys = [table[x] * factor for table in tables], [table[panel.column] for table in tables]
        band = _error_band(tables[0], panel.column) if len(tables) == 1 else None
        for trace in mean_traces(group.label, line_look(group), xs, ys, band):
            yield {**trace, "meta": group.label}


def mean_traces(
    label: str,
    look: tuple[str, str],
    xs: Sequence[F64Array],
    ys: Sequence[F64Array],
    band: tuple[F64Array, F64Array] | None = None,
) -> Iterator[dict[str, Any]]:
    """Yield the band and the curve of runs, as traces of plotly.

    Of several runs it is the mean where all have values, with a 95 % t interval. Two are drawn as thin lines beside it,
    and runs that hardly overlap as thin lines alone, which are called apart.

    Args:
        label: Name of the curve.
        look: Its colour and dash.
        xs: Ascending abscissae of each run.
        ys: Values of each run.
        band: Lower and upper bound of the values of a single run; no band if None.
    """
    curve, (color, dash) = mean_curve(xs, ys), look
    grid, bounds = numbers(_thinned(curve.grid)), curve.band or band
    line = {"type": "scatter", "mode": "lines"}
    silent = {"hoverinfo": "skip", "showlegend": False}
    if bounds is not None:
        low, high = (numbers(_thinned(each)) for each in bounds)
        edge = {**line, **silent, "x": grid, "line": {"width": 0, "color": color}}
        yield {**edge, "y": low}
        yield {**edge, "y": high, "fill": "tonexty", "fillcolor": f"{color}/{_BAND_OPACITY}"}
    if curve.singles:  # one trace, with a gap after each run
        x, y = (numbers(np.concatenate([[*_thinned(each[axis]), np.nan] for each in curve.singles])) for axis in (0, 1))
        named = {"name": escape(f"{label}, apart"), "hovertemplate": "%{y:.4~g}"} if curve.is_apart else silent
        yield {**line, **named, "x": x, "y": y, "line": {"color": color, "dash": dash, "width": 1}}
    if not curve.is_apart:
        yield {
            **line,
            "name": escape(label),
            "x": grid,
            "y": numbers(_thinned(curve.mean)),
            "mode": "lines+markers" if len(grid) < _FEW_POINTS else "lines",
            "marker": {"size": 5},
            "line": {"color": color, "dash": dash, "width": 2},
            "hovertemplate": "%{y:.4~g}",
        }


def _thinned(values: F64Array) -> F64Array:
    return values[:: max(1, -(-len(values) // _MOST_POINTS))]


def line_look(group: ReportedGroup) -> tuple[str, str]:
    """Return colour and dash of a group's curve."""
    return f"--curve-{group.group.color[1:]}", _DASHES[group.group.style]


def numbered_look(number: int) -> tuple[str, str]:
    """Return colour and dash of the curve with this number; after ten, colours begin anew with another dash."""
    dashes = list(_DASHES.values())
    return f"--curve-{number % _COLORS}", dashes[number // _COLORS % len(dashes)]


def _error_band(table: Table, column: str) -> tuple[F64Array, F64Array] | None:
    """Return a column minus and plus two standard errors over the episodes of each evaluation, if they are known."""
    spread = column.replace("_mean", "_std")
    if spread == column or not {spread, "episodes"} <= table.keys():
        return None
    error = 2 * table[spread] / np.sqrt(table["episodes"])
    return table[column] - error, table[column] + error


def numbers(values: FloatArray) -> list[float | None]:
    """Return `values` with six digits for JSON, which has neither NaN nor infinity."""
    return [float(f"{value:.{_SIGNIFICANT}g}") if np.isfinite(value) else None for value in values.tolist()]
