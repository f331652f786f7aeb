"""A study from the forecast to its tables and figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from shlex import quote
from time import monotonic, time
from typing import Annotated, Any, Literal

from shes.checked import checked
from shes.console import LineConsole
from shes.errors import ConfigError, RunFolderError
from shes.listing import Listing, Table
from shes.runs.progress_display import format_duration
from shes.runs.sections import WorkerSettings
from shes.settings import Gt
from shes.studies.comparison import Comparison, compare
from shes.studies.design import STEPS_PER_S, StudyDesign
from shes.studies.figures import draw_figures
from shes.studies.named_studies import STUDIES
from shes.studies.running import Outcome, check_study, run_study
from shes.studies.study import Study, cell_steps, choose
from shes.studies.study_tables import Cell, CellResults, read_tables, write_csv, write_tables
from shes.studies.summaries import cells_left, read_summaries
from shes.studies.table1 import settings_beside

_OF_THE_PAPER = ("table1", "fig3", "fig4", "fig5", "fig6")
_COMPARISON = "comparison"


@checked
def experiment(
    name: Literal["ablation", "learning", "table1", "fig3", "fig4", "fig5", "fig6"],
    *,
    out: Path | None = None,
    num_workers: int = 0,
    backend: str = "processes",
    scale: Literal["paper", "laptop", "smoke"] = "laptop",
    seeds: int | None = None,
    only: Sequence[str] | None = None,
    budget: Annotated[float, Gt(0)] | None = None,
    run: bool = True,
) -> Listing:
    """Run a study of many runs and draw its figures. The same command continues a study that was stopped.

    shes experiment ablation --out results/ablation --workers 2

    Args:
        name: ablation: the paper's choices, a sweep of the settings, transfer and horizon, on Point Gather and Maze;
            learning: an ablation of the walker's training method, on Ant Flagrun; the others: Table I and the figures
            of the paper, with SHES as published and with the changes of the learning study; table1 and fig3 also
            with HIRO (extra hiro). Every study needs SciPy (extra study).
        out: Folder of its runs, tables and figures; finished runs in it are kept. Default: runs/NAME, with -SCALE
            unless that is laptop; the paper's experiments share runs/paper.
        num_workers: Runs at a time, or the workers of each run of scale paper; 0 is one for every core. fig4 sets its
            own worker counts; fig6 measures every count up to this one, once.
        backend: Backend of runs that have all workers, those of scale paper, fig4 and fig6: for example ray.
        scale: paper: Table I, ten runs of up to ten hours, for experiments of the paper only; laptop: hours on two
            cores; smoke: minutes, as a test.
        seeds: Number of seeds per variant. Default: 10, and 1 for fig6; at scale laptop, 5 for sweeps, the learning
            study and the ant; at scale smoke, 1 or 2.
        only: Groups or environments to run, groups beside the base; all if none. ablation: choices, horizon, sweep,
            transfer; learning: alternatives, form, grid, pieces, sweep; table1: methods, steps; fig3: methods, steps;
            fig4: workers; fig5: methods, transfer; fig6: speedup.
        budget: Hours after which all runs stop, and no measurement of fig6 begins; the same command continues them.
        run: Whether to run what is missing. --no-run draws figures and comparisons of the finished runs and of the rows
            in runs.csv and curves.csv.

    Raises:
        ConfigError: The backend would not be used, there is nothing to draw, or the folder has another comparison.
        ShesError: Raised by `choose` or `run_study`.
    """
    study = STUDIES[name](scale, seeds)
    out = out or Path("runs") / (
        ("paper" if name in _OF_THE_PAPER else name) + ("" if scale == "laptop" else f"-{scale}")
    )
    if backend != "processes" and not study.has_large_runs:
        raise ConfigError(
            f"--backend {backend} is for runs that have all workers: those of scale paper, fig4 and fig6. Every run of "
            f"{name} at scale {scale} has one core of this machine. Omit --backend."
        )
    chosen = choose(study, only)
    check_study(study, out)
    facts: dict[str, Any] = {"out": str(out), "cells": len(chosen.cells)}
    lines: list[str] = []
    errors: list[str] = []
    if run:
        until = math.inf if budget is None else time() + 3600 * budget
        failed, stopped = _run(study, chosen, out, num_workers, backend, until)
        facts |= {"failed": failed, "stopped": stopped}
        errors = [f"{cell} failed: {error}" for cell, error in failed.items()]
        if failed:
            errors.append(f"{len(failed)} of {len(chosen.cells)} runs failed: the same command repeats them.")
        if stopped:
            lines = [f"The budget is used up: {len(stopped)} runs are left. The same command continues them."]
    summaries = read_summaries(study, out)
    if run:
        summaries = _in_tables(study, summaries, out)
    else:
        facts["missing"] = [cell.name for cell in chosen.cells if cell.name not in summaries]
        if not summaries:
            raise ConfigError(
                f"{out} has no finished run of {name} at scale {scale}, and no row of one in runs.csv and curves.csv. "
                "Choose another folder with --out or another --scale, or omit --no-run."
            )
        if facts["missing"]:
            lines = [f"{len(facts['missing'])} of {len(chosen.cells)} runs are missing. Omit --no-run to make them."]
    if seeds is not None and read_tables(STUDIES[name](scale, None).cells, out).keys() - summaries.keys():
        lines.append(f"Comparisons and figures are of {seeds} seed{'s' * (seeds > 1)} alone; runs.csv has more.")
    found, parts = _write_results(name, study, out, summaries)
    return Listing({**facts, **found}, [*parts, *lines], errors)


def _in_tables(study: Study, summaries: Mapping[str, CellResults], out: Path) -> dict[str, CellResults]:
    """Return the summaries of finished runs as the tables have them, from which alone figures are made.

    The tables are written only if a run is not, or not as a whole, in them, as after a crash: each run was written with
    the folder's lock, which another study may hold now.
    """
    cells = [cell for cell in study.ordered() if cell.name in summaries]
    found: dict[str, CellResults] = {}
    with suppress(RunFolderError):  # one that nothing can be written to is met again
        found = read_tables(cells, out)
    if found.keys() != summaries.keys():
        write_tables(study.ordered(), summaries, out)
    return read_tables(cells, out)


def _table(name: str) -> str:
    """Return the name of the table with the comparisons of a study; those of the paper share a folder."""
    return name if name in _OF_THE_PAPER else _COMPARISON


def _run(
    study: Study, chosen: Study, out: Path, num_workers: int, backend: str, until: float
) -> tuple[dict[str, str], list[str]]:
    """Run what is left of `chosen`, a part of `study`; return the errors of failed runs, and the runs stopped."""
    at_once = WorkerSettings(num_workers=num_workers).count
    left = {cell.name for cell in cells_left(chosen, out)}
    failed: dict[str, str] = {}
    stopped: list[str] = []
    try:
        with closing(run_study(chosen, out, num_workers=num_workers, backend=backend, until=until)) as outcomes:
            for outcome in with_progress(chosen, outcomes, left, at_once, LineConsole().print_line):
                if outcome.error:
                    failed[outcome.cell.name] = outcome.error
                elif outcome.summary is None:
                    stopped.append(outcome.cell.name)
                else:
                    write_tables(study.ordered(), read_summaries(study, out), out)
    except KeyboardInterrupt as stop:
        stop.add_note("Stopped; finished runs are kept. Continue with the same command.")
        raise
    return failed, stopped


def _write_results(
    name: str, study: Study, out: Path, summaries: Mapping[str, CellResults]
) -> tuple[dict[str, Any], list[Table | str]]:
    """Write comparisons and figures of finished runs into `out`; return what they hold, as facts and as text."""
    comparisons = compare(study, summaries)
    rows = [each.row() for each in comparisons]
    table = _table(name)
    if rows:  # else what earlier settings have left stays
        write_csv(out / f"{table}.csv", rows)
    figures = [str(path) for path in draw_figures(study, summaries, comparisons, out)]
    tables = [name for name in ("runs.csv", "curves.csv", f"{table}.csv") if (out / name).is_file()]
    facts: dict[str, Any] = {"figures": figures, "comparisons": rows}
    parts = [
        *_parts(study.design, comparisons),
        f"Tables: {', '.join(tables) or 'none'} in {quote(str(out))}",
        f"Figures: {' '.join(map(quote, figures)) or 'none'}",
    ]
    if name == "table1":
        rows = settings_beside()
        write_csv(out / "table1-settings.csv", rows)
        texts = [["-" if value is None else f"{value}" for value in row.values()] for row in rows]
        headings = ("Table I", "SHES, SHES-TL", "scale paper", "HIRO", "scale paper")
        facts["settings"] = rows
        parts = [Table(headings, texts), *parts]
    return facts, parts


def _parts(design: StudyDesign, comparisons: Iterable[Comparison]) -> Iterator[Table | str]:
    """Yield the tables of each environment: a row for each variant, and the comparisons over equal budgets."""
    last = "ratio [of seeds]" if design.has_ratios else "p"
    for env, found in groupby(comparisons, attrgetter("env")):
        rows = list(found)
        yield env
        yield Table(("group", "variant", "seeds", "mean [95 %]", last), [each.texts(design) for each in rows])
        test = "" if design.has_ratios else "; p: permutation test, with Holm's correction"
        yield f"mean: {design.metrics[env].words}, over seeds{test}."
        if equal := [texts for each in rows if (texts := each.equal_texts(design)) is not None]:
            yield Table(("group", "variant", "mean test score, equal steps", "equal time"), equal)
            yield (
                "Over the steps and the time that both have, a transferred primitive's included; p: permutation test, "
                "with Holm's correction."
            )


def forecast(study: Study, num_workers: int) -> dict[str, float]:
    """Return the seconds that each cell, by name, should take of the whole study's, with `num_workers` workers."""
    design, found = study.design, dict[str, float]()
    for cell in study.cells:
        # Large runs have all workers one after another, the others one each side by side.
        workers = cell.settings.get("num_workers", num_workers) if study.has_large_runs else num_workers
        training, evaluation = cell_steps(cell, study.episodes)
        of_body = STEPS_PER_S[cell.body]
        speed = design.slower.get(cell.variant, of_body)
        if study.run_cell is not None:  # a generation is timed on every core alone, then on 2, 3, ... workers
            found[cell.name] = training / speed * (num_workers + sum(1 / count for count in range(2, 1 + num_workers)))
        else:
            found[cell.name] = (training / speed + evaluation / of_body) / min(workers, num_workers)
    return found


def with_progress(
    study: Study, outcomes: Iterable[Outcome], left: Collection[str], num_workers: int, say: Callable[[str], None]
) -> Iterator[Outcome]:
    """Yield the outcomes of the cells that are `left`; say a forecast, and after each its result and the time left."""
    to_do = [cell for cell in study.cells if cell.name in left]
    # Large runs have all cores in turn, but no more than their own workers where they set them.
    most = max((cell.settings.get("num_workers", num_workers) for cell in to_do), default=1)
    at_once = max(1, min(num_workers, most if study.has_large_runs else len(left)))
    seconds = forecast(study, at_once)
    to_make, made, start = {cell.name: seconds[cell.name] for cell in to_do}, 0.0, monotonic()
    say(_forecast_text(study, to_do, sum(to_make.values()), at_once))
    for outcome in outcomes:
        for event in outcome.events:
            say(event)
        made += to_make.pop(outcome.cell.name)
        result = "FAILED" if outcome.error else "stopped"
        if outcome.summary is not None:
            row, measure = outcome.summary.row, study.design.metric(outcome.cell.env)
            result = f"{measure.words} {row[measure.column]:.2f} in {row['seconds']:.0f} s"
        time_left = format_duration(sum(to_make.values()) * (monotonic() - start) / made)
        say(f"[{len(seconds) - len(to_make)}/{len(seconds)}] {outcome.cell.name}: {result}; {time_left} left")
        yield outcome


def _forecast_text(study: Study, to_do: Sequence[Cell], seconds: float, num_cores: int) -> str:
    """Return in words how much there is `to_do` of a study, and for how many seconds."""
    steps = sum(sum(cell_steps(cell, study.episodes)) for cell in study.cells)
    in_words = f"{steps / 1e6:,.1f} M" if steps >= 1e5 else f"{steps:,}"
    num_done = len(study.cells) - len(to_do)
    bodies, variants = {cell.body for cell in to_do}, {cell.variant for cell in to_do}
    speeds = {body: speed for body, speed in STEPS_PER_S.items() if body in bodies}
    speeds |= {study.design.label(name): speed for name, speed in study.design.slower.items() if name in variants}
    each = ", ".join(f"{name}: {speed:,}" for name, speed in speeds.items())
    return (
        f"{len(study.cells)} runs, {in_words} environment steps{f'; {num_done} are done' if num_done else ''}. About "
        f"{format_duration(seconds)} on {num_cores} core{'s' * (num_cores != 1)}"
        f"{f' (steps a second and core: {each})' if each else ''}; Ctrl-C stops, the same command continues."
    )
