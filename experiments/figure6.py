"""Figure 6: the speed-up of SHES and S-ES by more cores, measured here and projected by `benchmarks/speedup.py`.

Source: SHES paper, Figure 6.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.curve_figure import write_names
from experiments.design import Run
from experiments.figures import COLORS, WIDTH
from experiments.paper import METHODS, figure_3
from experiments.paper_settings import PIECES, PUBLISHED, SCALES
from experiments.results import write_csv
from experiments.summary import provenance_columns
from shes.errors import RunFolderError
from shes.runs.folder import provenance
from shes.runs.tables import Row
from shes.storage import storage_errors, write_atomically

FLAT = "es"
LABELS = {PUBLISHED: "SHES as published", FLAT: "S-ES", PIECES: "SHES with the learning changes"}
PAPER_SLOPE = ((1, 1.0), (250, 50.0), (600, 100.0))
"""Cores and speed-up in the paper, linear between them: a fifth of the cores at 250, a sixth at 600."""
PAPER_SECONDS: Mapping[str, Mapping[int, float]] = {
    PUBLISHED: {1: 149.5, 2: 79.8, 4: 41.8, 8: 22.7},
    FLAT: {1: 6345, 24: 523, 48: 310, 72: 199, 120: 148, 240: 84.6},
}
"""Raw times of the authors' code by cores, in seconds: SHES on Ant Maze with threads, S-ES over MPI."""
_MARKS: Mapping[str, dict[str, Any]] = {
    "projected, down to what sleeping workers reached": {},
    "measured": {"linestyle": "", "marker": "o"},
    "authors' code": {"linestyle": "", "marker": "x"},
}
"""Entries of the legend, which are the same for all methods, and how they are drawn."""


def measured_runs(scale: str) -> list[Run]:
    """Return the settings of the generations that are timed: those of Table I on Ant Maze, but at scale `smoke`."""
    size, env = ("smoke", "point-maze") if scale == "smoke" else ("paper", "ant-maze")
    timed: list[Run] = []
    for run in figure_3(size, 1).runs:
        if run.env == env and run.group == METHODS and run.variant in LABELS:
            settings = {name: value for name, value in run.settings.items() if name not in ("env_steps", "minutes")}
            timed.append(replace(run, group="speedup", settings={**settings, "generations": 1}))
    shared = {name: value for name, value in SCALES[size].settings.items() if name != "minutes"}
    flat = replace(timed[0], variant=FLAT, settings={**shared, "generations": 1, "algorithm": FLAT})
    return [timed[0], flat, *timed[1:]]


def measure(scale: str, out: Path, num_workers: int) -> None:
    """Time a generation of each of `measured_runs` on 1 to `num_workers` workers; write `fig6.csv` after each.

    What the file has of the same settings is not measured again.
    """
    from benchmarks import speedup  # takes its time, and is not needed to draw

    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
    path, runs = out / "fig6.csv", measured_runs(scale)
    rows = [row for row in read_rows(path) if row["settings"] in {run.digest for run in runs}]
    for run in runs:
        if run.digest not in {row["settings"] for row in rows}:
            found = speedup.measure_speedup(run.config(out, {"backend": "processes", "num_workers": num_workers}))
            here = {"settings": run.digest, **provenance_columns([provenance("cpu")])}
            rows += [{"variant": run.variant, "env": run.env, **row, **here} for row in found]
            write_csv(path, rows)


def read_rows(path: Path) -> list[Row]:
    """Return the rows of `fig6.csv`, none if there is no such file."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [{**row, "cores": int(row["cores"])} for row in csv.DictReader(file)]


def draw(out: Path) -> Path:
    """Draw `fig6.png` from `fig6.csv` in the folder `out`; return its path."""
    rows = read_rows(out / "fig6.csv")
    if not rows:
        raise RunFolderError(f"{out} has no fig6.csv with a measurement. Omit --no-run to make it.")
    figure = speedup_figure(rows)
    write_atomically(out / "fig6.png", partial(figure.savefig, format="png", dpi=150))
    plt.close(figure)
    return out / "fig6.png"


def slowdown(rows: Sequence[Mapping[str, Any]], variant: str) -> tuple[list[int], list[float]]:
    """Return numbers of cores, and by how much workers that only sleep were slower there than projected.

    The sleeping workers and their own projection are rows of earlier measurements alone.
    """
    seconds = {
        (row["kind"], int(row["cores"])): float(row["generation_s"]) for row in rows if row["variant"] == variant
    }
    cores = sorted(number for kind, number in seconds if kind == "asleep")
    return [1, *cores], [1.0, *(seconds["asleep", n] / seconds["projected asleep", n] for n in cores)]


def speedup_figure(rows: list[Row]) -> Figure:
    """Return a figure of speed-up over cores, with the paper's slope and the times of the authors' code."""
    figure, axis = plt.subplots(figsize=(WIDTH, 0.55 * WIDTH), layout="constrained")
    most = max(row["cores"] for row in rows)
    axis.plot([1, most], [1, most], color="black", linewidth=0.8)
    names = [(float(most), "perfect", "black")]
    knots, speedups = zip(*PAPER_SLOPE, strict=True)
    cores = np.arange(knots[0], knots[-1] + 1)  # on logarithmic axes the line is curved
    axis.plot(cores, np.interp(cores, knots, speedups), color="black", linestyle=":")
    names.append((float(speedups[-1]), "paper, Figure 6 (slope)", "black"))
    for variant in dict.fromkeys(row["variant"] for row in rows):
        color = COLORS[variant]
        if seconds := PAPER_SECONDS.get(variant):
            axis.plot(list(seconds), [seconds[1] / each for each in seconds.values()], "x", color=color)
        own = [row for row in rows if row["variant"] == variant]
        for kind, mark in (("measured", "o"), ("projected", "-")):
            found = [row for row in own if row["kind"] == kind]
            x, y = (np.array([float(row[key]) for row in found]) for key in ("cores", "speedup"))
            axis.plot(x, y, mark, color=color)
        axis.fill_between(x, y / np.interp(x, *slowdown(rows, variant)), y, color=color, alpha=0.2, linewidth=0)
        names.append((float(y[-1]), LABELS[variant], color))
    axis.set(xscale="log", yscale="log", xlabel="cores", ylabel="speed-up", title=rows[0]["env"])
    write_names(axis, names, 0.55 * WIDTH)
    grey = [Line2D([], [], color="grey", **look) for look in _MARKS.values()]
    axis.legend(grey, list(_MARKS), frameon=False)
    axis.spines[["top", "right"]].set_visible(False)
    return figure
