"""`shes experiment`: studies of many runs, with their tables and figures."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from time import monotonic
from typing import Annotated, Literal

import tyro

from shes.cli.output import print_error, print_facts, print_line, print_table, quote
from shes.cli.progress_display import format_duration
from shes.errors import ConfigError
from shes.runs.config import WorkerSettings
from shes.studies.comparison import Comparison, compare
from shes.studies.design import StudyDesign
from shes.studies.figures import draw_figures
from shes.studies.index import STUDIES
from shes.studies.study import (
    Outcome,
    Study,
    cell_steps,
    cells_left,
    check_study,
    choose,
    read_summaries,
    run_study,
)
from shes.studies.tables import write_csv, write_tables

Scale = Literal["laptop", "smoke"]
Group = Literal["choices", "sweep", "transfer", "horizon", "pieces", "form", "alternatives"]
_GROUPS = {
    "ablation": ("choices", "sweep", "transfer", "horizon"),
    "learning": ("pieces", "form", "alternatives", "sweep"),
}


def experiment(
    name: Annotated[Literal["ablation", "learning"], tyro.conf.Positional],
    *,
    out: Path | None = None,
    workers: int = 0,
    scale: Scale = "laptop",
    seeds: int | None = None,
    only: tuple[Group, ...] | None = None,
    json: bool = False,
) -> int:
    """Run a study of many runs and draw its figures. Stopped, it goes on by the same command.

    shes experiment ablation --out results/ablation --workers 2

    Args:
        name: ablation: the choices of the paper, a sweep of the settings, transfer and horizon, on Point Gather and
            Maze; learning: what each piece of the walker's learning is worth, on Ant Flagrun.
        out: Where its runs, tables and figures are kept, and not done again; runs/ and its name if none.
        workers: Runs at a time; 0 is one for every core.
        scale: laptop: hours on two cores; smoke: a minute, to see that everything works.
        seeds: Seeds of every variant; if none 10, and 5 in a sweep and in learning (smoke: 2).
        only: Groups to run, and always the base; all if none.
        json: Print one JSON object.
    """
    if only == ():
        raise ConfigError(f"--only needs at least one group: {', '.join(_GROUPS[name])}. Leave it away to run all.")
    if workers < 0:
        raise ConfigError(f"workers must be a whole number of at least 0, got {workers}. Set --workers.")
    out = out or Path("runs") / name
    study = STUDIES[name](scale, seeds)
    chosen = choose(study, only or ())
    check_study(study, out)
    left = {cell.name for cell in cells_left(chosen, out)}
    workers = WorkerSettings(num_workers=workers).count
    failed: list[Outcome] = []
    outcomes = run_study(chosen, out, num_workers=workers)
    with _Progress(chosen, left, workers, is_silent=json) as progress, closing(outcomes):
        for outcome in outcomes:
            progress.show(outcome)
            if outcome.summary is None:
                failed.append(outcome)
            else:
                write_tables(study.ordered(), read_summaries(study, out), out)
    summaries = read_summaries(study, out)
    comparisons = compare(study, summaries)
    write_tables(study.ordered(), summaries, out)
    write_csv(out / "comparison.csv", [comparison.row() for comparison in comparisons])
    figures = draw_figures(study, summaries, comparisons, out)
    if json:
        facts = {
            "out": str(out),
            "cells": len(chosen.cells),
            "failed": {outcome.cell.name: outcome.error for outcome in failed},
            "figures": [str(path) for path in figures],
            "comparisons": [comparison.row() for comparison in comparisons],
        }
        print_facts(facts, as_json=True)
    else:
        _print_comparisons(study.design, comparisons)
        print_line(f"Tables: runs.csv, curves.csv, comparison.csv in {quote(out)}")
        print_line(f"Figures: {' '.join(quote(path) for path in figures) or 'none'}")
    for outcome in failed:
        print_error(RuntimeError(f"{outcome.cell.name} failed: {outcome.error}"))
    if failed:
        again = "the same command does them again"
        print_error(RuntimeError(f"{len(failed)} of {len(chosen.cells)} runs failed: {again}."))
    return 1 if failed else 0


class _Progress:
    """Says what is ahead, what every finished run came to and how long the rest takes; after Ctrl-C, how to go on."""

    def __init__(self, study: Study, left: set[str], workers: int, *, is_silent: bool) -> None:
        self._design = study.design
        self._steps = {cell.name: cell_steps(cell, study.episodes) for cell in study.cells}
        self._left = {name: steps for name, steps in self._steps.items() if name in left}
        self._workers, self._is_silent = workers, is_silent
        self._start, self._made = monotonic(), 0

    def __enter__(self) -> _Progress:
        total, ahead = sum(self._steps.values()), sum(self._left.values())
        at_once = max(1, min(self._workers, len(self._left)))
        runs = f"{len(self._steps)} runs, {total / 1e6:,.1f} M environment steps"
        done = f"; {len(self._steps) - len(self._left)} are done" if len(self._left) < len(self._steps) else ""
        if not self._left:
            self._say(f"{runs}; all are done.")
            return self
        expected = format_duration(ahead / self._design.steps_per_s / at_once)
        pace = f"at {self._design.steps_per_s:,} steps a second on each of {at_once} core{'s' * (at_once != 1)}"
        self._say(f"{runs}{done}. About {expected} {pace}; Ctrl-C stops, the same command goes on.")
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        if kind is KeyboardInterrupt:
            self._say("Stopped; nothing that is done is lost. Go on with the same command.")

    def show(self, outcome: Outcome) -> None:
        """Say what came of a cell."""
        for event in outcome.events:
            self._say(event)
        self._made += self._left.pop(outcome.cell.name)
        count = f"[{len(self._steps) - len(self._left)}/{len(self._steps)}] {outcome.cell.name}"
        ahead = sum(self._left.values())
        left = format_duration(ahead * (monotonic() - self._start) / self._made)
        if outcome.summary is None:
            self._say(f"{count}: FAILED; {left} left")
            return
        row = outcome.summary.row
        measure = self._design.metric(outcome.cell.env)
        self._say(f"{count}: {measure.words} {row[measure.column]:.2f} in {row['seconds']:.0f} s; {left} left")

    def _say(self, text: str) -> None:
        if not self._is_silent:
            print_line(text)


def _print_comparisons(design: StudyDesign, comparisons: list[Comparison]) -> None:
    """Print a table per task, with a row per variant."""
    for env in dict.fromkeys(found.env for found in comparisons):
        rows: list[tuple[str, ...]] = []
        for found in (found for found in comparisons if found.env == env):
            other = "" if found.against in (None, design.base[1]) else f" (to {design.label(found.against)})"
            score = f"{found.score_mean:.2f} [{found.score_low:.2f}, {found.score_high:.2f}]"
            p = "-" if found.p_holm is None else f"{found.p_holm:.4f}"
            rows.append((found.group, design.label(found.variant) + other, str(found.seeds), score, p))
        print_line(env)
        print_table(("group", "variant", "seeds", "mean [95 %]", "p"), rows)
        print_line(f"mean: {design.metrics[env].words}, over seeds; p: to the base, by permutation, corrected by Holm.")
