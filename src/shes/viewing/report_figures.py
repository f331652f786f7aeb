"""The figures of a report, for plotly: learning curves and diagnostics, maps of episodes, and of a search for a way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from shes.algorithms.contract import Explored
from shes.drawing.renderer import extent_of, outlines
from shes.runs.build import open_run
from shes.runs.folder import RunFolder
from shes.types import F64Array, FloatArray
from shes.viewing.curves import X_AXES, Group, RunData, column_curve
from shes.viewing.playback import Playback

Figure = dict[str, Any]
"""A figure of plotly: `data` and `layout`. Plotly reads texts as HTML, so those from files are escaped."""
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
_COLUMNS, _PANEL_PIXELS, _FRAME_PIXELS, _GAP_PIXELS, _MAP_PIXELS = 3, 290, 180, 70, 560
MOST_EPISODES = 10
"""Paths in a map; more would hide each other."""
_GROUND, _CHASM = "#e9ece7", "#a9aeb0"
_FILLS = {"wall": "#8b94a1", "platform": _GROUND, "block": "#d2a873"}
_PATH, _GOAL, _CELL = "#c2560c", "#1f5fc4", "#1f5fc459"
_CELL_HALF_M = 0.45


class Panel(NamedTuple):
    """A column of a table to be drawn."""

    table: str
    column: str

    @property
    def section(self) -> str | None:
        """The section of the column; None if it is an abscissa, a time or a spread, which have other places."""
        is_rate = self.column == "env_steps_per_s"
        if self.column in X_AXES or (self.column.endswith(("_s", "_std")) and not is_rate):
            return None
        is_outcome = self.column.startswith(("score", "success_rate", "return", "goals_reached"))
        return SECTIONS[0] if is_outcome or self.column.endswith("_return_mean") else SECTIONS[1]

    @property
    def title(self) -> str:
        """The quantity, and the episodes that it is of."""
        words = self.column.removesuffix("_mean").replace("_", " ")
        return words if self.section == SECTIONS[1] else f"{words}, {self.table.replace('progress', 'training')}"


def panels_of(runs: Sequence[RunData], section: str) -> list[Panel]:
    """Return the panels of a section, of the columns that change in a run; those of evaluation come first."""
    found: dict[Panel, None] = {}
    for table in ("evaluation", "progress"):
        for run in runs:
            for column, values in run.tables[table].items():
                panel, finite = Panel(table, column), values[np.isfinite(values)]
                if panel.section == section and len(finite) and (finite.min() < finite.max() or len(values) == 1):
                    found[panel] = None
    return list(found)


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
    return {"data": data, "layout": _curve_layout(panels, [trace["meta"] for trace in data])}


def _axis(letter: str, place: int) -> str:
    return letter if place == 1 else f"{letter}{place}"


def _curve_layout(panels: Sequence[Panel], abscissae: Sequence[str]) -> dict[str, Any]:
    axes = [_axis("xaxis", place) for place in range(1, len(panels) + 1)]
    columns = min(_COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    buttons = [
        {
            "method": "update",
            "label": label,
            "args": [{"visible": [each == x for each in abscissae]}, {f"{axis}.title.text": label for axis in axes}],
        }
        for x, (label, _) in X_AXES.items()
    ]
    corner = {"x": 0, "xanchor": "left", "y": 1, "yanchor": "bottom"}
    titles = [
        {"text": escape(panel.title), **{f"{letter}ref": f"{_axis(letter, place)} domain" for letter in "xy"}}
        for place, panel in enumerate(panels, 1)
    ]
    menu = {"type": "buttons", "direction": "right", "pad": {"b": 35}, "buttons": buttons}
    return {
        "grid": {"rows": rows, "columns": columns, "pattern": "independent", "ygap": _GAP_PIXELS / _PANEL_PIXELS},
        "height": _FRAME_PIXELS + _PANEL_PIXELS * rows,
        "margin": {"l": 60, "r": 20, "t": 90, "b": 90},
        "hovermode": "x unified",
        "annotations": [title | corner | {"showarrow": False} for title in titles],
        "updatemenus": [menu | corner],
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
    silent = {"mode": "lines", "hoverinfo": "skip"}
    named = {"name": escape(group.label), "hovertemplate": "%{y:.4~g}"}
    if curve.band is not None:
        for bound, fill in zip(curve.band, ({}, {"fill": "tonexty", "fillcolor": color + _BAND_ALPHA}), strict=True):
            yield _scatter(curve.grid, bound, **silent, line={"width": 0, "color": color}, **fill)
    for number, run in enumerate(curve.singles):
        look = {**named, "mode": "lines"} if curve.is_apart and number == 0 else silent
        yield _scatter(*run, **look, line={"color": color, "dash": dash, "width": 1})
    if not curve.is_apart:
        mode = "lines+markers" if len(curve.grid) < _FEW_POINTS else "lines"
        yield _scatter(curve.grid, curve.mean, **named, mode=mode, line={"color": color, "dash": dash, "width": 2})


def _scatter(x: FloatArray, y: FloatArray, **look: Any) -> dict[str, Any]:
    """Return a trace of points, with six digits for JSON, which has neither NaN nor infinity."""
    every = max(1, -(-len(x) // _MOST_POINTS))
    found: dict[str, Any] = {"type": "scatter"}
    for name, values in (("x", x), ("y", y)):
        found[name] = [float(f"{it:.6g}") if np.isfinite(it) else None for it in values[::every].tolist()]
    return found | look


def play_maps(run: Path, episodes: int, seed: int | None = None) -> list[Figure]:
    """Play the first of the episodes that `evaluate` runs, at most `MOST_EPISODES`, and return their map.

    An entry of its legend shows and hides path and goals of one episode. After a search for a way its map comes second:
    the cells reached by the end of the run, and the way found. Raise ConfigError if the robot's position is unknown.
    """
    playback = Playback(run, "best", seed)
    task = playback.task
    try:
        layout = _map_layout(None if task.robot is None else task.world_to_draw().compile())
        traces = [each for number in range(min(episodes, MOST_EPISODES)) for each in _episode_traces(playback, number)]
    finally:
        task.close()
    has_last = RunFolder.open(run).checkpoint_path("last").exists()
    opened = open_run(run, "last" if has_last else "best", device="cpu")
    explored = opened.algorithm.explored(opened.state)
    searches = [] if explored is None else [_search_traces(explored)]
    return [{"data": data, "layout": layout} for data in (traces, *searches)]


def _episode_traces(playback: Playback, number: int) -> Iterator[dict[str, Any]]:
    """Play an episode; yield its path, its goals as crosses, and its end as a dot."""
    task, path, goals = playback.task, list[F64Array](), list[F64Array]()
    for _ in playback.play(playback.seed_of(number)):
        task.check_position()
        path.append(task.position[0].copy())
        if playback.goal is not None and (not goals or (goals[-1] != playback.goal).any()):
            goals.append(playback.goal.copy())
    name = f"episode {number}, score {task.score[0]:g}"
    end = f"{name}: its end, after {(len(path) - 1) * task.step_s:.1f} s"
    cross = {"color": _GOAL, "size": 6, "symbol": "x-thin", "line": {"width": 1.5, "color": _GOAL}}
    own = {"legendgroup": name, "hovertemplate": f"{name}<br>(%{{x:.1f}}, %{{y:.1f}}) m<extra></extra>"}
    yield _scatter(
        *np.transpose(path), **own, name=name, mode="lines", line={"color": _PATH, "width": 1.5}, opacity=0.6
    )
    yield _scatter(*np.reshape(goals, (-1, 2)).T, **own, mode="markers", marker=cross, showlegend=False)
    own["hovertemplate"] = f"{end}<extra></extra>"
    yield _scatter(*path[-1][:, None], **own, mode="markers", marker={"color": _PATH, "size": 8}, showlegend=False)


def _search_traces(explored: Explored) -> list[dict[str, Any]]:
    """Return the cells that a search for a way reached, and the way found with its points."""
    half = _CELL_HALF_M * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [np.nan, np.nan]])
    squares = (explored.places[:, None] + half).reshape(-1, 2)
    way = {"mode": "lines+markers", "line": {"color": _PATH}, "name": f"way found, {len(explored.way)} points"}
    cells = {"mode": "lines", "fill": "toself", "fillcolor": _CELL, "line": {"width": 0}, "hoverinfo": "skip"}
    cells["name"] = f"{len(explored.places)} cells reached"
    return [_scatter(*squares.T, **cells), _scatter(*explored.way.T, **way)]


def _map_layout(model: mujoco.MjModel | None) -> dict[str, Any]:
    """Return the layout of a map with the world of `model`; an environment that draws itself has none."""
    boxes = [] if model is None else outlines(model, mujoco.MjData(model))
    left, bottom, right, top = (None,) * 4 if model is None else extent_of(model)
    shapes = [
        {
            "type": "path",
            "path": "M" + "L".join(f"{x:.3f},{y:.3f}" for x, y in outline.corners) + "Z",
            "fillcolor": _FILLS[outline.kind],
            "line": {"width": 0},
            "layer": "below",
        }
        for outline in boxes
    ]
    return {
        "xaxis": {"range": [left, right], "title": {"text": "x in metres"}, "constrain": "domain"},
        "yaxis": {"range": [bottom, top], "title": {"text": "y in metres"}, "scaleanchor": "x", "constrain": "domain"},
        "shapes": shapes,
        "hovermode": "closest",
        "height": _MAP_PIXELS,
        "margin": {"l": 60, "r": 20, "t": 30, "b": 50},
        "plot_bgcolor": _CHASM if any(outline.kind == "platform" for outline in boxes) else _GROUND,
    }
