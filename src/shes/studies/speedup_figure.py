"""The figure of speed-up over cores, beside the paper's. Source: SHES paper, Figure 6."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from statistics import fmean
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from shes.types import F64Array

PAPER_SLOPE = ((1, 1.0), (250, 50.0), (600, 100.0))
"""Cores and speed-up in the paper, linear between them: a fifth of the cores at 250, a sixth at 600."""
PAPER_SECONDS: Mapping[str, Mapping[int, float]] = {
    "shes": {1: 149.5, 2: 79.8, 4: 41.8, 8: 22.7},
    "es": {1: 6345, 24: 523, 48: 310, 72: 199, 120: 148, 240: 84.6},
}
"""Raw times of the authors' code by cores, in seconds: SHES on Ant Maze with threads, S-ES over MPI."""
_COLORS = ("#c44e00", "#1f77b4", "#2a7f3f")
_NAMES = {"shes": "SHES", "es": "S-ES"}
KINDS = {"projected": "projected", "measured": "measured", "asleep": "sleeping workers"}
"""Kinds of rows in words."""
_LOOKS: dict[str, dict[str, Any]] = {
    "projected": {"linestyle": "-"},
    "measured": {"marker": "o"},
    "asleep": {"marker": "s", "mfc": "none"},
}


class SpeedupLine(NamedTuple):
    """One series of the figure, drawn in one colour."""

    words: str
    rows: Sequence[Mapping[str, Any]]
    """Rows with the columns `kind`, `cores` and `speedup`."""
    authors: str = ""
    """Key of `PAPER_SECONDS`; without, there are no times of the authors' code."""


class AuthorsSpeedup(NamedTuple):
    """Speed-ups of the authors' code."""

    words: str
    cores: list[float]
    speedup: list[float]


def authors_speedup(algorithm: str) -> AuthorsSpeedup | None:
    """Return the speed-ups of the authors' code for a key of `PAPER_SECONDS`; None if it has no times."""
    seconds = PAPER_SECONDS.get(algorithm)
    if seconds is None:
        return None
    speedup = [seconds[1] / each for each in seconds.values()]
    return AuthorsSpeedup(f"{_NAMES[algorithm]}, authors' code", [float(cores) for cores in seconds], speedup)


def speedup_figure(lines: Sequence[SpeedupLine], title: str, size: tuple[float, float] = (7, 5)) -> Figure:
    """Return a figure of speed-up over cores, the mean of the rows of each kind and number; `size` is in inches."""
    figure, axis = plt.subplots(figsize=size, layout="constrained")
    most = max(int(row["cores"]) for line in lines for row in line.rows)
    axis.plot([1, most], [1, most], color="black", linewidth=0.8, label="perfect")
    axis.plot(*paper_line(), color="black", linestyle=":", label="paper, Figure 6 (slope)")
    for line, color in zip(lines, _COLORS, strict=False):
        if authors := authors_speedup(line.authors):
            axis.plot(authors.cores, authors.speedup, "x", color=color, label=authors.words)
        for kind, words in KINDS.items():
            if points := _points(line.rows, kind):
                style: dict[str, Any] = {"linestyle": "", "color": color, **_LOOKS[kind]}
                axis.plot(*zip(*points, strict=True), **style, label=f"{line.words}, {words}")
    axis.set(xscale="log", yscale="log", xlabel="cores", ylabel="speed-up", title=title)
    axis.legend(frameon=False, fontsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def paper_line() -> tuple[F64Array, F64Array]:
    """Return cores and speed-ups of the paper's line, at every core: on logarithmic axes it is curved."""
    knots, speedups = zip(*PAPER_SLOPE, strict=True)
    cores = np.arange(knots[0], knots[-1] + 1, dtype=np.float64)
    return cores, np.interp(cores, knots, speedups)


def _points(rows: Iterable[Mapping[str, Any]], kind: str) -> list[tuple[float, float]]:
    """Return cores and mean speed-ups of the rows of one kind that are known, by cores."""
    by_cores: dict[float, list[float]] = {}
    for row in rows:
        if row["kind"] == kind and row["speedup"] not in (None, ""):
            by_cores.setdefault(float(row["cores"]), []).append(float(row["speedup"]))
    return [(cores, fmean(by_cores[cores])) for cores in sorted(by_cores)]
