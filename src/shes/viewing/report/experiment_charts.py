"""Learning curves of an experiment from its table `curves.csv` alone, as figures of plotly.

They show what the figures of `shes experiment` show, as the experiment's design says, and then the curves of that
table that are in none of them.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from shes.viewing.report.curve_charts import X_AXES, Figure
from shes.viewing.report.designed_chart import MOST_BANDS, Place, Rows, chart_figure, chart_title, current, has_column
from shes.viewing.report.experiment_design import DesignedChart, DesignedCurve, Designs
from shes.viewing.report.speedup_chart import speedup_figure

EXPERIMENT_AXES = ("env_steps", "wall_time_s")
"""Those of `X_AXES` that `curves.csv` has."""
_CURVES = "curves.csv"
_MEASURES = {"score_mean": "test score", "training_return_mean": "training reward"}
_MOST_CURVES = MOST_BANDS
"""Curves of a figure without a design: with more variants, each group has figures of its own."""

Charts = dict[str, Figure | dict[str, Figure]]
"""Figures by title; one for each of `X_AXES` if it depends on the horizontal axis."""


def experiment_charts(folder: Path, designs: Designs) -> dict[str, Charts]:
    """Return the figures of the curves in `folder` by experiment; without `curves.csv` none.

    Those of curves that are in no figure of a design come last, under an empty name.

    Raises:
        ValueError: A number cannot be read.
        OSError: The table cannot be read.
    """
    file = folder / _CURVES
    rows = _read(file) if file.is_file() else {}
    found: dict[str, Charts] = {}
    for name, design in designs.by_name.items():
        found[name] = _figures(design["charts"], rows)
        for speedup in design["speedups"]:
            figure = speedup_figure(speedup, _current_rows(rows, speedup["env"]))
            found[name] |= {f"{speedup['title']}: speed-up": figure} if figure["data"] else {}
    found[""] = _figures(list(_others(rows, designs)), rows)
    return {name: charts for name, charts in found.items() if charts}


def _read(file: Path) -> Rows:
    """Return the rows of a table by place and run."""
    rows: dict[Place, dict[tuple[str, str], list[dict[str, str]]]] = {}
    with file.open(newline="", encoding="utf-8") as lines:
        for row in csv.DictReader(lines):
            runs = rows.setdefault((row["env"], row["group"], row["variant"]), {})
            runs.setdefault((row["seed"], row.get("settings") or ""), []).append(row)
    return rows


def _figures(charts: Sequence[DesignedChart], rows: Rows) -> Charts:
    """Return those of the charts that have a curve, by title."""
    found: Charts = {}
    for chart in charts:
        figures = {x: chart_figure(chart, rows, x) for x in X_AXES}
        if any(figure["data"] for figure in figures.values()):
            found[chart_title(chart)] = figures
    return found


def _others(rows: Rows, designs: Designs) -> Iterator[DesignedChart]:
    """Yield charts of the curves that no chart of a design shows."""
    shown = {
        (chart["column"], chart["env"], curve["group"], curve["variant"])
        for design in designs.by_name.values()
        for chart in design["charts"]
        for curve in chart["curves"]
    }
    for env in dict.fromkeys(place[0] for place in rows):
        groups = dict.fromkeys(group for each, group, _ in rows if each == env)
        for column, words in _MEASURES.items():
            places = [
                place
                for place, runs in rows.items()
                if place[0] == env
                and (column, *place) not in shown
                and any(has_column(run, column) for run in runs.values())
            ]
            parts, name = {env: places}, designs.method if len(groups) > 1 else designs.variant
            if len(places) > _MOST_CURVES:
                parts = {f"{env}, {group}": [each for each in places if each[1] == group] for group in groups}
                name = designs.variant
            for title, own in parts.items():
                if own:
                    yield _undesigned(title, column, words, {each: name(*each[1:]) for each in own}, rows)


def _undesigned(title: str, column: str, words: str, names: Mapping[Place, str], rows: Rows) -> DesignedChart:
    """Return a chart of places of one environment, with their names; a curve begins after its primitive's training."""
    curves: list[DesignedCurve] = []
    for place, name in names.items():
        is_after = any(
            has_column(run, "primitive_env_steps") and has_column(run, "primitive_seconds")
            for run in rows[place].values()
        )
        curves.append({"group": place[1], "variant": place[2], "words": name, "is_after_primitive": is_after})
    return {
        "env": next(iter(names))[0],
        "title": title,
        "column": column,
        "words": words,
        "axes": list(EXPERIMENT_AXES),
        "curves": curves,
        "references": [],
        "has_running_best": False,
    }


def _current_rows(rows: Rows, env: str) -> dict[tuple[str, str], list[Mapping[str, str]]]:
    """Return the rows of the current runs on `env` by group and variant."""
    return {
        (group, variant): [row for run in current(list(runs)) for row in runs[run]]
        for (task, group, variant), runs in rows.items()
        if task == env
    }
