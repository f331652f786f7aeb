"""Figures of the ablation: what every choice does, how sensitive the settings are, transfer and horizon over steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import blended_transform_factory

from shes.experiments.ablation import BASE, CURVES, ENVS, FACTORS, LABELS, METRICS, SWEPT, Comparison, label, sweep_name
from shes.experiments.plot import interval
from shes.experiments.study import Study
from shes.experiments.study_tables import Cell, Summary
from shes.storage import write_atomically
from shes.types import F64Array

__all__ = ["draw_figures"]

_SHORT = {"point-gather": "score", "point-maze": "targets reached"}
_WIDTH = 10.0
"""Inches: at 100 % of a page of 900 pixels, text is as large as the page's own."""
_DPI = 150
_BASE_COLOR, _COLOR = "#1f77b4", "#c44e00"
_TITLES = {"point-gather": "Point Gather", "point-maze": "Point Maze"}
_Place = tuple[str, str, str]
"""Environment, group, variant."""


class _Results:
    """The finished cells of the ablation by place, seed after seed."""

    def __init__(self, study: Study, summaries: Mapping[str, Summary], comparisons: Sequence[Comparison]) -> None:
        self.summaries: dict[_Place, list[Summary]] = {}
        self.cells: dict[_Place, Cell] = {}
        for cell in study.cells:
            place = (cell.env, cell.group, cell.variant)
            self.cells[place] = cell
            if cell.name in summaries:
                self.summaries.setdefault(place, []).append(summaries[cell.name])
        self._p = {(c.env, c.group, c.variant): c.p_holm for c in comparisons if c.against == BASE}

    def scores(self, place: _Place) -> F64Array:
        """Return what is compared, of every seed."""
        column = METRICS[place[0]][0]
        return np.array([summary.row[column] for summary in self.summaries.get(place, ())], dtype=np.float64)

    def p(self, place: _Place) -> str:
        """Return the corrected p against the base, in words; their heading beside the base itself."""
        p = self._p.get(place)
        if p is None:
            return "against base" if place[1:] == ("choices", BASE) else ""
        return "p < 0.001" if p < 0.001 else f"p = {p:.3f}" if p < 0.1 else f"p = {p:.2f}"

    def has(self, *groups: str) -> bool:
        """Tell whether a cell of one of `groups`, other than the base, is finished."""
        return any(group in groups and variant != BASE for _, group, variant in self.summaries)


def draw_figures(
    study: Study, summaries: Mapping[str, Summary], comparisons: Sequence[Comparison], out: Path
) -> list[Path]:
    """Draw what the finished cells of the ablation show into `out`; return the pictures.

    `choices.png`, `sweep.png` and `transfer.png`, each if a cell of it is finished.

    Raises:
        StorageError: A picture cannot be written.
    """
    results = _Results(study, summaries, comparisons)
    drawn: list[Path] = []
    figures: tuple[tuple[str, tuple[str, ...], Callable[[_Results], Figure]], ...] = (
        ("choices.png", ("choices",), _draw_choices),
        ("sweep.png", ("sweep",), _draw_sweep),
        ("transfer.png", ("transfer", "horizon"), _draw_curves),
    )
    for name, groups, draw in figures:
        if results.has(*groups):
            with _style():
                figure = draw(results)
            try:
                write_atomically(out / name, lambda file, figure=figure: figure.savefig(file, format="png"))
            finally:
                plt.close(figure)
            drawn.append(out / name)
    return drawn


@contextmanager
def _style() -> Iterator[None]:
    """Draw without a box around, and with letters of one size."""
    with plt.rc_context({"axes.spines.top": False, "axes.spines.right": False, "figure.dpi": _DPI, "font.size": 10}):
        yield


def _draw_choices(results: _Results) -> Figure:
    """Draw a row of the figure per task: every variant with its seeds, its mean and its interval."""
    variants = [variant for variant in LABELS if any(("choices", variant) == place[1:] for place in results.summaries)]
    figure, axes = plt.subplots(
        len(ENVS), 1, figsize=(_WIDTH, len(ENVS) * (1.0 + 0.36 * len(variants))), layout="constrained", squeeze=False
    )
    for axis, env in zip(axes[:, 0], ENVS, strict=True):
        _forest(axis, results, env, variants)
    for axis, env in zip(axes[:, 0], ENVS, strict=True):
        axis.set_xlabel(f"{METRICS[env][1]}: each seed, mean with its 95 % interval")
    return figure


def _forest(axis: Axes, results: _Results, env: str, variants: Sequence[str]) -> None:
    """Draw the variants of a task below each other."""
    rng = np.random.default_rng(0)
    for y, variant in enumerate(variants):
        place = (env, "choices", variant)
        values = results.scores(place)
        if not len(values):
            continue
        color = _BASE_COLOR if variant == BASE else _COLOR
        heights = y + rng.uniform(-0.16, 0.16, len(values))  # seeds of one score stay apart
        axis.scatter(values, heights, s=14, color=color, alpha=0.35, linewidth=0)
        low, high = interval(values[:, None])
        axis.plot([low[0], high[0]], [y, y], color=color, linewidth=2)
        axis.plot(values.mean(), y, "D", color=color, markersize=6, markeredgecolor="white")
        beside = blended_transform_factory(axis.transAxes, axis.transData)
        axis.text(1.01, y, results.p(place), transform=beside, va="center", fontsize="small")
        if variant == BASE:
            axis.axvline(values.mean(), color=_BASE_COLOR, linewidth=1, alpha=0.5, zorder=0)
    axis.set_yticks(range(len(variants)), [label(variant) for variant in variants])
    axis.set_ylim(len(variants) - 0.5, -0.5)
    axis.set_title(_TITLES[env], loc="left", fontweight="bold")
    axis.grid(axis="x", alpha=0.3)


def _draw_sweep(results: _Results) -> Figure:
    """Draw a row per task and a column per setting: mean and interval over the factor."""
    figure, axes = plt.subplots(
        len(ENVS), len(SWEPT), figsize=(_WIDTH, 2.6 * len(ENVS)), layout="constrained", sharey="row"
    )
    for row, env in zip(axes, ENVS, strict=True):
        for axis, setting in zip(row, SWEPT, strict=True):
            _sensitivity(axis, results, env, setting)
        row[0].set_ylabel(f"{_TITLES[env]}\n{_SHORT[env]}")
    for axis, setting in zip(axes[0], SWEPT, strict=True):
        axis.set_title(setting.replace("_", " "), fontsize="medium")
    return figure


def _sensitivity(axis: Axes, results: _Results, env: str, setting: str) -> None:
    """Draw what the factors of a setting do on a task, the base in the middle."""
    places = {factor: (env, "sweep", sweep_name(setting, factor)) for factor in FACTORS}
    places = dict(sorted({**places, 1.0: (env, "choices", BASE)}.items()))
    found = {factor: values for factor, place in places.items() if len(values := results.scores(place))}
    bounds = [interval(values[:, None]) for values in found.values()]
    means = [values.mean() for values in found.values()]
    axis.fill_between(
        list(found),
        [low[0] for low, _ in bounds],
        [high[0] for _, high in bounds],
        color=_COLOR,
        alpha=0.2,
        linewidth=0,
    )
    axis.plot(list(found), means, "o-", color=_COLOR, markersize=4)
    if 1.0 in found:
        axis.plot(1.0, found[1.0].mean(), "D", color=_BASE_COLOR, markersize=7, markeredgecolor="white")
        axis.axhline(found[1.0].mean(), color=_BASE_COLOR, linewidth=1, alpha=0.5, zorder=0)
    axis.set_xscale("log", base=2)
    labels = [f"{results.cells[place].settings[setting]:g}" for place in places.values()]
    axis.set_xticks(list(places), labels, fontsize="small", rotation=45)
    axis.minorticks_off()
    axis.set_xlim(0.2, 5.0)
    axis.grid(alpha=0.3)


def _draw_curves(results: _Results) -> Figure:
    """Draw scores over environment steps: transfer on each task, then the maze's horizons."""
    base = ("choices", BASE)
    transfers = [("transfer", variant) for variant in ("scratch", "frozen", "unfrozen")]
    horizons = [base, *(place[1:] for place in results.cells if place[1] == "horizon")]
    panels = [*((env, _TITLES[env], transfers) for env in ENVS), ("point-maze", "Point Maze, horizon", horizons)]
    figure, axes = plt.subplots(1, len(panels), figsize=(_WIDTH, 3.8), layout="constrained")
    for axis, (env, title, variants) in zip(axes, panels, strict=True):
        for number, (group, variant) in enumerate(variants):
            place = (env, group, variant)
            if place in results.summaries:
                steps = f"{results.cells[place].settings['horizon']} steps"
                name = steps if variants is horizons else label(variant)
                _draw_curve(axis, results.summaries[place], CURVES[env][0], name, f"C{number}")
        axis.set_title(title, fontsize="medium", fontweight="bold")
        axis.set_ylabel(CURVES[env][1])
        axis.set_xlabel("thousand environment steps")
        axis.grid(alpha=0.3)
        if axis.lines:
            axis.legend(fontsize="small", frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.22))
    return figure


def _draw_curve(axis: Axes, runs: Sequence[Summary], column: str, name: str, color: str) -> None:
    """Draw the mean of the seeds and its interval, where all of them reach."""
    steps = [np.array([row["env_steps"] for row in run.curve], dtype=np.float64) for run in runs]
    scores = [np.array([row[column] for row in run.curve], dtype=np.float64) for run in runs]
    start, end = max(x[0] for x in steps), min(x[-1] for x in steps)
    places = np.concatenate(steps)
    grid = np.unique(places[(places >= start) & (places <= end)])
    values = np.stack([np.interp(grid, x, y) for x, y in zip(steps, scores, strict=True)])
    low, high = interval(values)
    words = f"{name} ({len(runs)} seed{'s' * (len(runs) != 1)})"
    axis.plot(grid / 1000, values.mean(axis=0), color=color, label=words)
    axis.fill_between(grid / 1000, low, high, color=color, alpha=0.2, linewidth=0)
