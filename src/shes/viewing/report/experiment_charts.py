"""Learning curves of an experiment from its table `curves.csv` alone, as figures of plotly."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from shes.viewing.report.curve_charts import X_AXES, Figure, mean_traces, numbered_look

_CURVES = "curves.csv"
_MEASURES = {"score_mean": "test score", "training_return_mean": "training reward"}
_COLUMNS = {"env_steps": "env_steps", "wall_time_s": "seconds"}
"""Columns of `curves.csv` by those of a run's tables."""
_MOST_CURVES = 10
"""Curves of a figure: with more variants, each group has figures of its own."""
_MOST_BANDS = 6
"""Curves of a figure that have a band: more could not be told apart."""
_LEGEND_PIXELS, _FRAME_PIXELS = 20, 300

_Run = tuple[str, str]
"""Seed, and digest of the settings; the digest is empty in a table without it."""
_Rows = Mapping[tuple[str, str], Mapping[_Run, Sequence[Mapping[str, str]]]]
"""Rows of an environment by group and variant, then by run."""


def experiment_charts(folder: Path) -> dict[str, dict[str, Figure]]:
    """Return the figures of the curves in `folder` by title, each over all of `X_AXES`; none without `curves.csv`.

    Raises:
        ValueError: A number cannot be read.
        OSError: The table cannot be read.
    """
    file = folder / _CURVES
    if not file.is_file():
        return {}
    envs: dict[str, dict[tuple[str, str], dict[_Run, list[dict[str, str]]]]] = {}
    with file.open(newline="", encoding="utf-8") as lines:
        for row in csv.DictReader(lines):
            variants = envs.setdefault(row["env"], {})
            runs = variants.setdefault((row["group"], row["variant"]), {})
            runs.setdefault((row["seed"], row.get("settings") or ""), []).append(row)
    found: dict[str, dict[str, Figure]] = {}
    for env, variants in envs.items():
        groups = {"": variants}
        if len(variants) > _MOST_CURVES:
            names = dict.fromkeys(group for group, _ in variants)
            groups = {name: {place: variants[place] for place in variants if place[0] == name} for name in names}
        for group, rows in groups.items():
            for column, words in _MEASURES.items():
                title = f"{env}, {group}: {words}" if group else f"{env}: {words}"
                figures = {x: _figure(title, rows, column, x) for x in X_AXES}
                if any(figure["data"] for figure in figures.values()):
                    found[title] = figures
    return found


def _figure(title: str, rows: _Rows, column: str, x: str) -> Figure:
    """Return a figure of the runs that have `column`, over `x`; over environment steps if a run does not have `x`."""
    full = {
        place: {run: found for run, found in runs.items() if all(row.get(column) for row in found)}
        for place, runs in rows.items()
    }
    drawn = {
        place: [full[place][run] for run in _current(list(runs)) if run in full[place]] for place, runs in rows.items()
    }
    num_others = sum(map(len, full.values())) - sum(map(len, drawn.values()))
    has_time = all(row.get("seconds") for runs in drawn.values() for run in runs for row in run)
    x = x if x == "wall_time_s" and has_time else "env_steps"
    label, factor, ticks = X_AXES[x]
    data: list[dict[str, Any]] = []
    several = len({group for group, _ in rows}) > 1
    for number, ((group, variant), runs) in enumerate(drawn.items()):
        if runs:
            xs = [np.array([_since_start(row, _COLUMNS[x]) for row in run]) * factor for run in runs]
            ys = [np.array([float(row[column]) for row in run]) for run in runs]
            words = f"{group}, {variant}" if several else variant
            label_of = f"{words} ({len(runs)} seed{'s' * (len(runs) != 1)})"
            traces = mean_traces(label_of, numbered_look(number), xs, ys)
            data += [trace for trace in traces if "name" in trace or len(rows) <= _MOST_BANDS]
    layout = {
        "title": {"text": escape(title) + _note(num_others)},
        "height": _FRAME_PIXELS + _LEGEND_PIXELS * sum("name" in trace for trace in data),
        "showlegend": True,
        "xaxis": {"title": {"text": label}, "tickformat": ticks},
    }
    return {"data": data, "layout": layout}


def _since_start(row: Mapping[str, str], column: str) -> float:
    """Return the environment steps or seconds since the training of a run began, that of its primitive included."""
    return float(row[column]) + float(row.get(f"primitive_{column}") or 0)


def _current(runs: Sequence[_Run]) -> list[_Run]:
    """Return those of the `runs` of a variant that have the settings of the first one: the table begins with them."""
    return [run for run in runs if run[1] == runs[0][1]]


def _note(num_others: int) -> str:
    """Return the line below a title that says how many runs are left out; empty if none is."""
    is_one = num_others == 1
    words = f"{num_others} run{'s' * (not is_one)} of other settings {'is' if is_one else 'are'} left out"
    return f"<br><sub>{words}</sub>" if num_others else ""
