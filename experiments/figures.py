"""Figures: variants with their seeds and intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from experiments.design import Place
from experiments.results import PlacedResults
from shes.storage import write_atomically
from shes.viewing.curves import confidence_interval

WIDTH = 10.0
"""Width of a figure in inches."""
_STYLE: dict[Any, Any] = {"axes.spines.top": False, "axes.spines.right": False, "figure.dpi": 150, "font.size": 10}
_BASE_COLOR, _COLOR = "#0072b2", "#d55e00"
COLORS: Mapping[str, str] = {
    "published": _BASE_COLOR,
    "pieces": _COLOR,
    "hiro": "#009e73",
    "es": "#aa4499",
    "transfer published": "#56b4e9",
    "transfer pieces": "#e69f00",
}
"""Colour of each method in all figures: distinguishable for the colour-blind (Okabe and Ito 2008)."""


def color_of(group: str, variant: str, others: Sequence[str] = ()) -> str:
    """Return the colour of a method; of another variant, one for its place among the `others` of the figure."""
    form, _, workers = variant.partition("-")
    known = COLORS.get(f"{group} {form}", COLORS.get(form))
    if known is None:
        place = (1 + others.index(variant)) / (1 + len(others)) if variant in others else 0.5
        return to_hex(colormaps["viridis"](place))
    return to_hex(tuple(part**0.5 for part in to_rgb(known))) if workers not in ("", "1") else known


def draw_figures(results: PlacedResults, out: Path) -> list[Path]:
    """Draw the figures of an experiment of which there are results into `out`; return their paths."""
    drawn: list[Path] = []
    for name, draw in results.experiment.figures.items():
        with plt.rc_context(_STYLE):
            figure = draw(results)
            if figure is not None:
                write_atomically(out / name, partial(figure.savefig, format="png"))
                plt.close(figure)
                drawn.append(out / name)
    return drawn


def forest(results: PlacedResults, group: str) -> Figure | None:
    """Return a figure with a panel per environment: the base and the variants of `group`, a row each."""
    if not results.has(group):
        return None
    base = results.experiment.base
    panels = {
        env: [place for place in results.places if place[0] == env and (place[1:] == base or place[1] == group)]
        for env in results.experiment.metrics
    }
    panels = {env: sorted(places, key=lambda place: place[1:] != base) for env, places in panels.items() if places[1:]}
    heights = [len(places) for places in panels.values()]
    size = (WIDTH, sum(1.0 + 0.36 * height for height in heights))
    figure, axes = plt.subplots(
        len(panels), 1, figsize=size, height_ratios=heights, layout="constrained", squeeze=False
    )
    for axis, (env, places) in zip(axes[:, 0], panels.items(), strict=True):
        _draw_rows(axis, results, places)
        axis.set_title(env.replace("-", " ").title(), loc="left", fontweight="bold")
        axis.set_xlabel(f"{results.experiment.metrics[env].words}: each seed, mean with its 95 % t interval")
    return figure


def _draw_rows(axis: Axes, results: PlacedResults, places: Sequence[Place]) -> None:
    """Draw the variants at `places`, one per row, with their p against the base."""
    rng, experiment = np.random.default_rng(0), results.experiment
    p_values = {
        (row["env"], row["group"], row["variant"]): row["p_holm"]
        for row in results.comparisons
        if (row["against_group"], row["against"]) == experiment.base
    }
    for y, place in enumerate(places):
        values, is_base = results.scores(place), place[1:] == experiment.base
        color = _BASE_COLOR if is_base else _COLOR
        heights = y + rng.uniform(-0.16, 0.16, len(values))  # so that equal scores are distinguishable
        axis.scatter(values, heights, s=14, color=color, alpha=0.35, linewidth=0)
        low, high = confidence_interval(values[:, None])
        axis.plot([low[0], high[0]], [y, y], color=color, linewidth=2)
        axis.plot(values.mean(), y, "D", color=color, markersize=6, markeredgecolor="white")
        text = "against base" if is_base else _p_text(p_values.get(place))
        margin = blended_transform_factory(axis.transAxes, axis.transData)
        axis.text(1.01, y, text, transform=margin, va="center", fontsize="small")
        if is_base:
            axis.axvline(values.mean(), color=_BASE_COLOR, linewidth=1, alpha=0.5, zorder=0)
    axis.set_yticks(range(len(places)), [experiment.label(place[2]) for place in places])
    axis.set_ylim(len(places) - 0.5, -0.5)
    axis.grid(axis="x", alpha=0.3)


def _p_text(p: float | None) -> str:
    """Return a p value as text; empty if there is none."""
    if p is None:
        return ""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}" if p < 0.1 else f"p = {p:.2f}"
