"""`shes experiment`: studies of many runs, with their tables and figures."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import closing
from itertools import groupby
from operator import attrgetter
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
    say = _say_nothing if json else print_line
    left = {cell.name for cell in cells_left(chosen, out)}
    failed: dict[str, str] = {}
    try:
        with closing(run_study(chosen, out, num_workers=workers)) as outcomes:
            for outcome in _with_progress(chosen, outcomes, left, workers, say):
                if outcome.summary is None:
                    failed[outcome.cell.name] = outcome.error
                else:
                    write_tables(study.ordered(), read_summaries(study, out), out)
    except KeyboardInterrupt:
        say("Stopped; finished runs are kept. Continue with the same command.")
        raise
    summaries = read_summaries(study, out)
    comparisons = compare(study, summaries)
    rows = [each.row() for each in comparisons]
    write_tables(study.ordered(), summaries, out)
    write_csv(out / "comparison.csv", rows)
    figures = [str(path) for path in draw_figures(study, summaries, comparisons, out)]
    if json:
        facts = {"out": str(out), "cells": len(chosen.cells), "failed": failed, "figures": figures}
        print_facts({**facts, "comparisons": rows}, as_json=True)
    else:
        _print_comparisons(study.design, comparisons)
        print_line(f"Tables: runs.csv, curves.csv, comparison.csv in {quote(out)}")
        print_line(f"Figures: {' '.join(map(quote, figures)) or 'none'}")
    for cell, error in failed.items():
        print_error(f"{cell} failed: {error}")
    if failed:
        print_error(f"{len(failed)} of {len(chosen.cells)} runs failed: the same command does them again.")
    return 1 if failed else 0


def _say_nothing(_text: str) -> None: ...


def _with_progress(
    study: Study, outcomes: Iterable[Outcome], left: Collection[str], workers: int, say: Callable[[str], None]
) -> Iterator[Outcome]:
    """Yield the outcomes of the cells that are `left`; say a forecast, and after each its result and the time left."""
    steps = {cell.name: cell_steps(cell, study.episodes) for cell in study.cells}
    to_make, made, start = {name: steps[name] for name in left}, 0, monotonic()
    at_once = max(1, min(workers, len(left)))
    expected = format_duration(sum(to_make.values()) / study.design.steps_per_s / at_once)
    done = f"; {len(steps) - len(left)} are done" if len(left) < len(steps) else ""
    say(
        f"{len(steps)} runs, {sum(steps.values()) / 1e6:,.1f} M environment steps{done}. About {expected} at "
        f"{study.design.steps_per_s:,} steps a second on each of {at_once} core{'s' * (at_once != 1)}; "
        "Ctrl-C stops, the same command continues."
    )
    for outcome in outcomes:
        for event in outcome.events:
            say(event)
        made += to_make.pop(outcome.cell.name)
        result = "FAILED"
        if outcome.summary is not None:
            row, measure = outcome.summary.row, study.design.metric(outcome.cell.env)
            result = f"{measure.words} {row[measure.column]:.2f} in {row['seconds']:.0f} s"
        time_left = format_duration(sum(to_make.values()) * (monotonic() - start) / made)
        say(f"[{len(steps) - len(to_make)}/{len(steps)}] {outcome.cell.name}: {result}; {time_left} left")
        yield outcome


def _print_comparisons(design: StudyDesign, comparisons: Iterable[Comparison]) -> None:
    """Print a table for each environment, with a row for each variant."""
    for env, found in groupby(comparisons, attrgetter("env")):
        print_line(env)
        print_table(("group", "variant", "seeds", "mean [95 %]", "p"), [_row(design, each) for each in found])
        print_line(f"mean: {design.metrics[env].words}, over seeds; p: against the base, permutation test with Holm.")


def _row(design: StudyDesign, found: Comparison) -> tuple[str, ...]:
    """Return the cells of a variant's row."""
    other = "" if found.against in (None, design.base[1]) else f" (to {design.label(found.against)})"
    score = f"{found.score_mean:.2f} [{found.score_low:.2f}, {found.score_high:.2f}]"
    p = "-" if found.p_holm is None else f"{found.p_holm:.4f}"
    return found.group, design.label(found.variant) + other, str(found.seeds), score, p
