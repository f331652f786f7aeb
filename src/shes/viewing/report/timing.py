"""Where the time of runs went, by part."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np

from shes.hierarchy.episodes import PARTS
from shes.viewing.report.curve_charts import Figure
from shes.viewing.report.reading import ReportedGroup, Table

_IN_WORKERS = tuple(f"{part}_s" for part in PARTS)
_RATES = ("wall_time_s", "process_time_s", "env_steps_per_s")
_REST = "rest"
_FRAME_PIXELS, _BAR_PIXELS = 140, 46
_CHARACTERS = 22
"""In a line of a label."""


def wall_parts(table: Table) -> dict[str, float]:
    """Return the seconds of a run's parts from its `progress` table, and the rest of its wall-clock time."""
    if not len(table.get("wall_time_s", ())):
        return {}
    found = {
        name.removesuffix("_s"): float(np.nansum(values))
        for name, values in table.items()
        if name.endswith("_s") and name not in (*_RATES, *_IN_WORKERS)
    }
    return {**found, _REST: max(0.0, float(table["wall_time_s"][-1]) - sum(found.values()))}


def worker_parts(table: Table) -> dict[str, float]:
    """Return the seconds that the workers of a run spent on each part of its rollouts, summed over them."""
    return {part: float(np.nansum(table[name])) for part, name in zip(PARTS, _IN_WORKERS, strict=True) if name in table}


def time_figures(groups: Sequence[ReportedGroup]) -> list[Figure]:
    """Return the shares of the wall-clock time and of the workers' time, with a bar for each group that has any."""
    found: list[Figure] = []
    for title, parts_of in (("wall-clock time", wall_parts), ("workers' time in rollouts", worker_parts)):
        bars = {group.title: _sum([parts_of(run.tables["progress"]) for run in group.runs]) for group in groups}
        bars = {label: parts for label, parts in bars.items() if sum(parts.values()) > 0}
        if bars:
            found.append(_figure(title, bars))
    return found


def _sum(each: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: sum(parts.get(name, 0.0) for parts in each) for name in dict.fromkeys(n for p in each for n in p)}


def _figure(title: str, bars: dict[str, dict[str, float]]) -> Figure:
    """Return a figure with one horizontal bar of parts for each label."""
    data: list[dict[str, Any]] = []
    for number, part in enumerate(dict.fromkeys(name for parts in bars.values() for name in parts)):
        seconds = [parts.get(part, 0.0) for parts in bars.values()]
        data.append(
            {
                "type": "bar",
                "orientation": "h",
                "name": escape(part),
                "y": [str(row) for row in range(len(bars))],
                "x": [round(s / sum(parts.values()), 4) for s, parts in zip(seconds, bars.values(), strict=True)],
                "customdata": [round(s, 1) for s in seconds],
                "hovertemplate": "%{x:.1%}, %{customdata:,} s",
                "marker": {"color": f"--curve-{number % 10}"},
            }
        )
    layout = {
        "title": {"text": title},
        "height": _FRAME_PIXELS + _BAR_PIXELS * len(bars),
        "barmode": "stack",
        "showlegend": True,
        "hovermode": "closest",
        "xaxis": {"tickformat": ".0%", "range": [0, 1]},
        "yaxis": {
            "type": "category",
            "autorange": "reversed",
            "tickvals": [str(row) for row in range(len(bars))],
            "ticktext": [_lines(label) for label in bars] if len(bars) > 1 else [""],
        },
    }
    return {"data": data, "layout": layout}


def _lines(label: str) -> str:
    """Return a label as a few short lines."""
    return "<br>".join(map(escape, textwrap.wrap(label, _CHARACTERS, max_lines=3, placeholder="…")))
