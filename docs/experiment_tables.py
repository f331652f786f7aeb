"""Markdown tables of `experiments.md`, made from the comparisons in `results/paper` and from the experiments' plans.

`python docs/experiment_tables.py` writes them into the page, each between `<!-- KIND of EXPERIMENT -->` and
`<!-- end -->`.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean

from markdown_table import table

from shes.studies.named_studies import STUDIES
from shes.studies.paper_runs import HIRO
from shes.studies.study import cell_steps

PAGE = Path(__file__).parent / "experiments.md"
RESULTS = Path(__file__).parents[1] / "results" / "paper"
SPEEDS = (14_700, 6_350)
"""Environment steps per second and core at the paper's size, with 3 x 256 hidden units: of an Intel Xeon
(`results/policy_limit.csv`) and of an AMD EPYC (`results/speed.csv`)."""
_AT_THE_PAPERS_SCALE = (("fig3", "methods"), ("fig3", "steps"), ("fig4", "workers"), ("fig5", "transfer"))
"""Experiments and groups of runs; `table1` has those of `fig3`, and so has `fig5` beside its own."""
_PLACE = re.compile(r"(<!-- (\w+) of (\w+) -->)\n.*?(<!-- end -->)", flags=re.DOTALL)
_UNBROKEN = re.compile(r" (?!\()")
"""Spaces within a number, its error or its interval."""

Row = Mapping[str, str]
Named = tuple[Row, str, str, float | None]
"""A comparison, the name of its method and of the one that it is compared with (a dash if there is none), and the mean
score of the method's last policies."""


def filled(page: str, results: Path = RESULTS) -> str:
    """Return `page` with its tables made anew from the comparisons in the folder `results`."""

    def fill(place: re.Match[str]) -> str:
        begin, kind, experiment, end = place.groups()
        made = missing() if kind == "missing" else _KINDS[kind](list(_named(experiment, results)))
        return f"{begin}\n\n{made}\n\n{end}"

    return _PLACE.sub(fill, page)


def _table(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table whose first column has each task once, and whose numbers are not broken."""
    shown, before = [], ""
    for env, *others in lines:
        cells = [_UNBROKEN.sub("\N{NO-BREAK SPACE}", cell) if cell[:1].isdigit() else cell for cell in others]
        shown.append(["" if env == before else env.replace("-", " ").title(), *cells])
        before = env
    return table(header, shown)


def scores(rows: list[Named]) -> str:
    """Return the table of all methods: statistics of the score over seeds, and tests against the base."""
    header = ("task", "method", "seeds", "mean ± s.e.", "IQM", "last", "p", "U", "million steps", "minutes")
    lines, base = [], ("", "")
    for row, words, _, last in rows:
        if not row["against"]:
            base = row["group"], row["variant"]
        elif (row["against_group"], row["against"]) != base:
            continue
        error = f" ± {float(row['score_error']):.2f}" if row["score_error"] else ""
        interval = f"({float(row['score_iqm_low']):.2f} to {float(row['score_iqm_high']):.2f})"
        spent = [
            " + ".join(show(row[name]) for name in (f"primitive_{column}", column) if row[name])
            for column, show in (("env_steps", _millions), ("hours", _minutes))
        ]
        lines.append(
            (
                *(row["env"], words, row["seeds"], f"{float(row['score_mean']):.2f}{error}"),
                *(f"{float(row['score_iqm']):.2f} {interval}", "–" if last is None else f"{last:.2f}"),
                *(_p(row["p_holm"]), _p(row["mann_whitney_p"])),
                *spent,
            )
        )
    return _table(header, lines)


def budgets(rows: list[Named]) -> str:
    """Return the table of the comparisons over equal environment steps and equal time."""
    means = ("mean test scores", "p")
    header = ("task", "method", "against", "million steps", *means, "minutes", *means)
    lines = []
    for row, words, other, _ in rows:
        if row["steps_span"] or row["hours_span"]:
            steps = _millions(row["steps_span"]) if row["steps_span"] else "–"
            budget = _minutes(row["hours_span"]) if row["hours_span"] else "–"
            lines.append((row["env"], words, other, steps, *_both(row, "steps"), budget, *_both(row, "hours")))
    return _table(header, lines)


def ratios(rows: list[Named]) -> str:
    """Return the table of variants that are compared by the ratio of each seed."""
    lines = []
    for row, words, other, _ in rows:
        has_ends = row["ratio_low"] and row["seeds"] != "1"
        ends = f" ({float(row['ratio_low']):.2f} to {float(row['ratio_high']):.2f})" if has_ends else ""
        ratio = f"{float(row['ratio']):.2f}{ends}" if row["ratio"] else "–"
        lines.append((row["env"], words, row["seeds"], f"{float(row['score_mean']):.4g}", ratio, other))
    return _table(("task", "method", "seeds", "mean", "ratio (of seeds)", "to"), lines)


_KINDS: Mapping[str, Callable[[list[Named]], str]] = {"scores": scores, "budgets": budgets, "ratios": ratios}


def missing() -> str:
    """Return the table of the runs of every experiment at the paper's scale, those of SHES in core-hours."""
    lines = []
    for name, group in _AT_THE_PAPERS_SCALE:
        study = STUDIES[name]("paper", None)
        cells = [cell for cell in study.cells if cell.group == group and cell.variant != HIRO]
        steps = sum(sum(cell_steps(cell, study.episodes)) for cell in cells)
        hours = [steps / speed / 3600 for speed in SPEEDS]
        core_hours, of_cluster = (
            " to ".join(f"{round(each / cores, digits):,.0f}" for each in hours)
            for cores, digits in ((1, -2), (48, -1))
        )
        lines.append((name, study.design.groups[group], len(cells), f"{steps / 1e9:,.0f}", core_hours, of_cluster))
    return table(("experiment", "methods", "runs", "billion steps", "core-hours", "hours of 48 cores"), lines)


def _named(experiment: str, results: Path) -> Iterator[Named]:
    """Yield each comparison of an experiment with the names of its methods: those of the figures, if they have one."""
    design = json.loads((results / f"{experiment}-design.json").read_text(encoding="utf-8"))
    words = {(group, name): text for group, names in design["variants"].items() for name, text in names.items()}
    for chart in reversed(design["charts"]):  # the names of the first figure take precedence
        words |= {(curve["group"], curve["variant"]): curve["words"] for curve in chart["curves"]}
    last: dict[tuple[str, ...], list[float]] = {}
    for run in _rows(results / "runs.csv"):
        if run["last_score"]:
            last.setdefault(_method(run), []).append(float(run["last_score"]))
    for row in _rows(results / f"{experiment}.csv"):
        other = words[row["against_group"], row["against"]] if row["against"] else "–"
        scores_there = last.get(_method(row), [])
        if scores_there and len(scores_there) != int(row["seeds"]):
            raise ValueError(
                f"{results / 'runs.csv'} has {len(scores_there)} runs of {' '.join(_method(row))}, {experiment}.csv is "
                f"of {row['seeds']}: run shes experiment {experiment} --no-run, and remove rows of other settings"
            )
        yield row, words[row["group"], row["variant"]], other, fmean(scores_there) if scores_there else None


def _method(row: Row) -> tuple[str, ...]:
    return row["env"], row["group"], row["variant"]


def _rows(path: Path) -> list[Row]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _both(row: Row, budget: str) -> tuple[str, str]:
    """Return the mean scores of both methods over a budget, and p."""
    if not row[f"{budget}_score"]:
        return "–", "–"
    score, other = (float(row[f"{budget}_score{end}"]) for end in ("", "_against"))
    return f"{score:.2f}, {other:.2f}", _p(row[f"{budget}_p_holm"])


def _p(text: str) -> str:
    """Return a p value; a dash if there is none."""
    if not text:
        return "–"
    p = float(text)
    return "<0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


def _millions(steps: str) -> str:
    """Return a number of environment steps in millions."""
    return f"{float(steps) / 1e6:.1f}"


def _minutes(hours: str) -> str:
    """Return `hours` in minutes."""
    minutes = 60 * float(hours)
    return f"{minutes:.1f}" if minutes < 9.95 else f"{minutes:.0f}"


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
