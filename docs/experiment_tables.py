"""The tables of `experiments.md`, made from the comparisons in `results/paper`.

`python docs/experiment_tables.py` writes them into the page, each between `<!-- NAME -->` and `<!-- end -->`.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from pathlib import Path
from statistics import fmean

import numpy as np
from markdown_table import table

PAGE = Path(__file__).parent / "experiments.md"
RESULTS = Path(__file__).parents[1] / "results" / "paper"
_TABLE = re.compile(r"(<!-- (\w+) -->)\n.*?(<!-- end -->)", flags=re.DOTALL)
_PLACE = ("env", "group", "variant", "against_group", "against")
_BASE = ("methods", "published")
METHODS = {
    ("methods", "published"): "SHES as published",
    ("methods", "pieces"): "SHES with the changes",
    ("methods", "hiro"): "HIRO",
    ("transfer", "published"): "SHES-TL as published",
    ("transfer", "pieces"): "SHES-TL with the changes",
}
STEPS = {
    "published": "as published",
    "views": "egocentric views",
    "symmetry": "the body's symmetry",
    "branches": "branched intervals",
    "ties": "zero output layers, no update of ties",
    "gait": "clock, price of falls, zero output layers",
    "goals": "goals of 1 s at full distance",
    "patrol": "view turned to the nearest food",
    "pieces": "all changes",
}
SPEEDUPS = {"published": "SHES as published", "pieces": "SHES with the changes", "es": "S-ES"}

Row = Mapping[str, str]
Key = tuple[str, ...]


def filled(page: str) -> str:
    """Return `page` with its tables made anew."""
    makers = {"scores": scores, "budgets": budgets, "steps": steps, "workers": workers, "speedups": speedups}
    return _TABLE.sub(lambda found: f"{found[1]}\n\n{makers[found[2]]()}\n\n{found[3]}", page)


def scores() -> str:
    """Return the table of scores: mean and standard error."""
    compared, lines = {**_compared("fig5"), **_compared("fig3")}, []
    last: dict[Key, list[float]] = {}
    for run in _rows("runs"):
        if run["last_score"]:
            last.setdefault((run["env"], run["group"], run["variant"]), []).append(float(run["last_score"]))
    for env in _envs():
        for (group, variant), words in METHODS.items():
            other = ("", "") if (group, variant) == _BASE else _BASE
            row = compared[env, group, variant, *other]
            steps = (row[name] for name in ("primitive_env_steps", "env_steps") if row[name])
            spent = " + ".join(f"{float(each) / 1e6:.1f}" for each in steps)
            at_the_end = f"{fmean(last[env, group, variant]):.2f}"
            lines.append((_task(env), words, _score(row), at_the_end, spent))
    return table(("task", "method", "score", "last", "million steps"), _once(lines))


def _score(row: Row) -> str:
    return f"{float(row['score_mean']):.2f} ± {float(row['score_error']):.2f}"


def budgets() -> str:
    """Return the table of mean test scores over equal steps and equal time."""
    first, fifth = _compared("fig3"), _compared("fig5")
    lines = []
    for env in _envs():
        pairs = (
            ("changes, published", fifth[env, "methods", "pieces", *_BASE]),
            ("changes, HIRO", first[env, "methods", "pieces", "methods", "hiro"]),
            ("SHES-TL, SHES (changes)", fifth[env, "transfer", "pieces", "methods", "pieces"]),
        )
        for words, row in pairs[:2] if env in ("ant-maze", "ant-push") else pairs:  # too short with transfer
            both = [_budget(row, "steps", 1e-6), _budget(row, "hours", 60)]
            is_fair = row is pairs[-1][1]  # both were tuned alike
            lines.append((_task(env), words, *(cell for *cells, p in both for cell in (*cells, p if is_fair else "–"))))
    header = ("task", "compared", "million steps", "mean scores", "p", "minutes", "mean scores", "p")
    return table(header, _once(lines))


def _budget(row: Row, name: str, factor: float) -> tuple[str, str, str]:
    """Return span, mean scores and p of a comparison over equal budgets."""
    means = " / ".join(f"{float(row[f'{name}_score{end}']):.2f}" for end in ("", "_against"))
    return f"{factor * float(row[f'{name}_span']):.1f}", means, _p(row[f"{name}_p_holm"])


def steps() -> str:
    """Return the table of the steps between the two forms, in Gather."""
    lines, compared = [], _compared("fig3")
    for body, forms in {
        "Point": ("published", "views", "branches", "ties", "pieces"),
        "Ant": ("published", "views", "symmetry", "branches", "gait", "goals", "patrol", "pieces"),
    }.items():
        for form in forms:
            group = "methods" if form in ("published", "pieces") else "steps"
            row = compared[f"{body.lower()}-gather", group, form, *(("", "") if form == "published" else _BASE)]
            lines.append((body, STEPS[form], _score(row)))
    return table(("body", "added", "score"), _once(lines))


def workers() -> str:
    """Return the table of the time of two workers over that of one."""
    compared = _compared("fig4")
    lines = []
    for env in _envs():
        ratios = [compared[env, "workers", f"{form}-2", "workers", f"{form}-1"] for form in ("published", "pieces")]
        lines.append((_task(env), *("{:.2f} ({:.2f} to {:.2f})".format(*_ratios(row)) for row in ratios)))
    return table(("task", "as published", "with the changes"), lines)


def _ratios(row: Row) -> tuple[float, ...]:
    return tuple(float(row[name]) for name in ("ratio", "ratio_low", "ratio_high"))


def speedups() -> str:
    """Return the table of speed-ups: measured on two cores, and projected, down to what sleeping workers reached."""
    found = {(row["variant"], row["kind"], int(row["cores"])): row for row in _rows("fig6")}
    lines = []
    for name, words in SPEEDUPS.items():
        cells = [f"{float(found[name, 'measured', 2]['speedup']):.2f}"]
        times = [
            [float(found[name, kind, n]["generation_s"]) for n in (200, 600)] for kind in ("asleep", "projected asleep")
        ]
        slower = [1.0, *(asleep / projected for asleep, projected in zip(*times, strict=True))]
        for cores in (48, 240, 600):
            most = float(found[name, "projected", cores]["speedup"])
            cells.append(f"{most / np.interp(cores, (1, 200, 600), slower):.0f} to {most:.0f}")
        lines.append((words, *cells))
    return table(("method", "2 cores, measured", "48, projected", "240", "600"), lines)


def _rows(name: str) -> list[dict[str, str]]:
    with (RESULTS / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _compared(name: str) -> dict[Key, Row]:
    """Return the comparisons of a table by environment, group and variant, and the group and variant of the other."""
    return {tuple(row[each] for each in _PLACE): row for row in _rows(name)}


def _envs() -> list[str]:
    return [f"{body}-{task}" for body in ("point", "ant") for task in ("gather", "maze", "push")]


def _task(env: str) -> str:
    return env.replace("-", " ").title()


def _once(lines: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return `lines` with every task once in the first column."""
    before = ["", *(line[0] for line in lines[:-1])]
    return [("" if line[0] == name else line[0], *line[1:]) for line, name in zip(lines, before, strict=True)]


def _p(text: str) -> str:
    """Return a p value; a dash if there is none."""
    if not text:
        return "–"
    p = float(text)
    return "<0.001" if p < 0.001 else f"{p:.3f}" if p < 0.1 else f"{p:.2f}"


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
