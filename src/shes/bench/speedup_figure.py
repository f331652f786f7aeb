"""The figure of `shes bench speedup`: speed-up over cores, beside the paper's. Source: SHES paper, Figure 6."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

from shes.storage import write_atomically

PAPER_SLOPE = ((1, 1.0), (250, 50.0), (600, 100.0))
"""Cores and speed-up in the paper: about 1/5 of a core for each core added up to 250, 1/6 up to 600."""
PAPER_SECONDS: Mapping[str, Mapping[int, float]] = {
    "shes": {1: 149.5, 2: 79.8, 4: 41.8, 8: 22.7},
    "es": {1: 6345, 24: 523, 48: 310, 72: 199, 120: 148, 240: 84.6},
}
"""Raw times of the authors' code by cores, in seconds: SHES on Ant Maze with threads, S-ES over MPI."""
_NAMES = {"shes": "SHES", "es": "S-ES"}
_COLORS = {"shes": "#c44e00", "es": "#1f77b4"}


def draw_speedup(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Draw the rows of `speedup.csv` to `path`, a PNG file."""
    figure, axis = plt.subplots(figsize=(7, 5), dpi=150)
    most = max(int(row["cores"]) for row in rows)
    axis.plot([1, most], [1, most], color="black", linewidth=0.8, label="perfect")
    axis.plot(*zip(*PAPER_SLOPE, strict=True), color="black", linestyle=":", label="paper, Figure 6 (slope)")
    for algorithm in dict.fromkeys(str(row["algorithm"]) for row in rows):
        name, color = _NAMES[algorithm], _COLORS[algorithm]
        raw = PAPER_SECONDS[algorithm]
        axis.plot(list(raw), [raw[1] / s for s in raw.values()], "x", color=color, label=f"{name}, authors' code")
        own = [row for row in rows if row["algorithm"] == algorithm]
        axis.plot(*_points(own, "projected"), "-", color=color, label=f"{name}, projected")
        axis.plot(*_points(own, "measured"), "o", color=color, label=f"{name}, measured")
        axis.plot(*_points(own, "asleep"), "s", color=color, mfc="none", label=f"{name}, sleeping workers")
    axis.set(xscale="log", yscale="log", xlabel="cores", ylabel="speed-up", title=str(rows[0]["env"]))
    axis.legend(frameon=False, fontsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    write_atomically(path, lambda file: figure.savefig(file, format="png"))
    plt.close(figure)


def _points(rows: Iterable[Mapping[str, Any]], kind: str) -> tuple[list[float], list[float]]:
    """Return cores and speed-ups of the rows of one kind, by cores."""
    points = sorted((float(row["cores"]), float(row["speedup"])) for row in rows if row["kind"] == kind)
    return [cores for cores, _ in points], [speedup for _, speedup in points]
