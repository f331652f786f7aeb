"""Curves of several runs on axes of matplotlib: the mean with its band, or each run as a thin line."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from shes.types import F64Array
from shes.viewing.curves import MeanCurve

_THIN, _OPACITY = 0.7, 0.16


def draw_mean_curve(axis: Axes, curve: MeanCurve, color: str, label: str, style: str = "-") -> None:
    """Draw the mean of runs with its band, and the runs that are to be shown singly.

    The axis keeps to the values of the runs: the band of few may leave it. `label` is that of a line of the curve.
    """
    look: dict[str, Any] = {"color": color, "linestyle": style}
    for number, (x, y) in enumerate(curve.singles):
        name = label if curve.is_apart and number == 0 else None
        axis.plot(x, y, linewidth=_THIN, marker=_marker(x), label=name, **look)
    if not curve.is_apart:
        axis.plot(curve.grid, curve.mean, marker=_marker(curve.grid), label=label, **look)
    if curve.band is not None:
        low, high = curve.band
        edge = np.concatenate([np.column_stack([curve.grid, low]), np.column_stack([curve.grid, high])[::-1]])
        axis.add_collection(PolyCollection([edge], color=color, alpha=_OPACITY, linewidth=0), autolim=False)
        axis.update_datalim([(curve.grid[0], curve.values.min()), (curve.grid[-1], curve.values.max())])
        axis.autoscale_view()


def _marker(x: F64Array) -> str:
    """Return the marker of a curve, which shows one that is a single point."""
    return "." if len(x) == 1 else ""


def legend_keys(curves: Iterable[MeanCurve], runs: str) -> list[tuple[Artist, str]]:
    """Return handles and words for what is drawn beside the means of `curves`; `runs` is the word for their runs."""
    drawn = list(curves)
    thin = Line2D([], [], color="black", linewidth=_THIN)
    keys: list[tuple[Artist, str]] = []
    if any(curve.band is not None for curve in drawn):
        words = f"band: 95 % t interval of the mean over {runs}, which may leave the panel"
        keys.append((Patch(color="grey", alpha=2 * _OPACITY), words))
    if any(curve.singles and not curve.is_apart for curve in drawn):
        keys.append((thin, f"thin lines: each of two {runs}, too few for a band"))
    if any(curve.is_apart for curve in drawn):
        keys.append((thin, f"thin lines without a mean: {runs} apart, which hardly overlap"))
    return keys
