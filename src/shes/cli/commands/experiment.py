"""`shes experiment`: studies of many runs, with their tables and figures."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from time import monotonic
from typing import Annotated, Literal

import tyro

from shes.cli.output import print_error, print_facts, print_line, print_table, quote
from shes.cli.parsing import Json
from shes.cli.progress_display import format_duration
from shes.runs.rooms import WorkerSettings
from shes.studies.comparison import Comparison, compare
from shes.studies.design import StudyDesign
from shes.studies.figures import draw_figures
from shes.studies.index import STUDIES
from shes.studies.running import Outcome, cells_left, check_study, read_summaries, run_study
from shes.studies.study import Study, cell_steps, choose
from shes.studies.tables import write_csv, write_tables


def experiment(
    name: Literal["ablation", "learning"],
    *,
    out: Path | None = None,
    workers: int = 0,
    scale: Literal["laptop", "smoke"] = "laptop",
    seeds: int | None = None,
    only: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="GROUP [GROUP ...]")] = None,
    json: Json = False,
) -> int:
    """Run a study of many runs and draw its figures. The same command continues a study that was stopped.

    shes experiment ablation --out results/ablation --workers 2

    Args:
        name: ablation: the paper's choices, a sweep of the settings, transfer and horizon, on Point Gather and Maze;
            learning: the worth of each part of the walker's learning, on Ant Flagrun.
        out: Folder of its runs, tables and figures; finished runs in it are kept. runs/ and its name if none.
        workers: Runs at a time; 0 is one for every core.
        scale: laptop: hours on two cores; smoke: a minute, as a test.
        seeds: Seeds of every variant; if none 10, and 5 in a sweep and in learning (smoke: 2).
        only: Groups to run beside the base; all if none. ablation: choices, horizon, sweep, transfer; learning:
            alternatives, form, pieces, sweep.
    """
    study, out = STUDIES[name](scale, seeds), out or Path("runs") / name
    chosen, workers = choose(study, only), WorkerSettings(num_workers=workers).count
    check_study(study, out)
    progress = _Progress(chosen, {cell.name for cell in cells_left(chosen, out)}, workers, is_silent=json)
    failed: list[Outcome] = []
    try:
        with closing(run_study(chosen, out, num_workers=workers)) as outcomes:
            for outcome in outcomes:
                progress.show(outcome)
                if outcome.summary is None:
                    failed.append(outcome)
                else:
                    write_tables(study.ordered(), read_summaries(study, out), out)
    except KeyboardInterrupt:
        progress.say("Stopped; finished runs are kept. Continue with the same command.")
        raise
    _print_results(study, out, len(chosen.cells), {each.cell.name: each.error for each in failed}, as_json=json)
    if failed:
        print_error(f"{len(failed)} of {len(chosen.cells)} runs failed: the same command does them again.")
    return 1 if failed else 0


def _print_results(study: Study, out: Path, num_cells: int, failed: dict[str, str], *, as_json: bool) -> None:
    """Write tables and figures of the finished cells into `out`, and print the comparisons and failed cells."""
    summaries = read_summaries(study, out)
    comparisons = compare(study, summaries)
    rows = [each.row() for each in comparisons]
    write_tables(study.ordered(), summaries, out)
    write_csv(out / "comparison.csv", rows)
    figures = [str(path) for path in draw_figures(study, summaries, comparisons, out)]
    if as_json:
        facts = {"out": str(out), "cells": num_cells, "failed": failed, "figures": figures}
        print_facts({**facts, "comparisons": rows}, as_json=True)
    else:
        _print_comparisons(study.design, comparisons)
        print_line(f"Tables: runs.csv, curves.csv, comparison.csv in {quote(out)}")
        print_line(f"Figures: {' '.join(map(quote, figures)) or 'none'}")
    for name, error in failed.items():
        print_error(f"{name} failed: {error}")


class _Progress:
    """Prints a forecast, then the result of every run and the time left."""

    def __init__(self, study: Study, left: set[str], workers: int, *, is_silent: bool) -> None:
        self._design, self._is_silent = study.design, is_silent
        steps = {cell.name: cell_steps(cell, study.episodes) for cell in study.cells}
        self._left = {name: count for name, count in steps.items() if name in left}
        self._total, self._start, self._made = len(steps), monotonic(), 0
        at_once = max(1, min(workers, len(left)))
        expected = format_duration(sum(self._left.values()) / self._design.steps_per_s / at_once)
        pace = f"at {self._design.steps_per_s:,} steps a second on each of {at_once} core{'s' * (at_once != 1)}"
        done = f"; {len(steps) - len(left)} are done" if len(left) < len(steps) else ""
        self.say(
            f"{len(steps)} runs, {sum(steps.values()) / 1e6:,.1f} M environment steps{done}. "
            f"About {expected} {pace}; Ctrl-C stops, the same command continues."
        )

    def show(self, outcome: Outcome) -> None:
        """Print the outcome of a cell."""
        for event in outcome.events:
            self.say(event)
        self._made += self._left.pop(outcome.cell.name)
        left = format_duration(sum(self._left.values()) * (monotonic() - self._start) / self._made)
        result = "FAILED"
        if outcome.summary is not None:
            row, measure = outcome.summary.row, self._design.metric(outcome.cell.env)
            result = f"{measure.words} {row[measure.column]:.2f} in {row['seconds']:.0f} s"
        self.say(f"[{self._total - len(self._left)}/{self._total}] {outcome.cell.name}: {result}; {left} left")

    def say(self, text: str) -> None:
        """Print `text`, unless silent."""
        if not self._is_silent:
            print_line(text)


def _print_comparisons(design: StudyDesign, comparisons: list[Comparison]) -> None:
    """Print a table for each environment, with a row for each variant."""
    for env in dict.fromkeys(found.env for found in comparisons):
        rows: list[tuple[str, ...]] = []
        for found in (found for found in comparisons if found.env == env):
            other = "" if found.against in (None, design.base[1]) else f" (to {design.label(found.against)})"
            score = f"{found.score_mean:.2f} [{found.score_low:.2f}, {found.score_high:.2f}]"
            p = "-" if found.p_holm is None else f"{found.p_holm:.4f}"
            rows.append((found.group, design.label(found.variant) + other, str(found.seeds), score, p))
        print_line(env)
        print_table(("group", "variant", "seeds", "mean [95 %]", "p"), rows)
        print_line(f"mean: {design.metrics[env].words}, over seeds; p: against the base, permutation test with Holm.")
