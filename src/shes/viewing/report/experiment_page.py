"""The section of an experiment: the curves, figures and comparisons that `shes experiment` has written."""

from __future__ import annotations

import csv
from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from shes.errors import RunFolderError
from shes.viewing.report.curve_charts import Figure
from shes.viewing.report.experiment_charts import experiment_charts
from shes.viewing.report.page import cards, details, image_card, paragraph, plots, section, table
from shes.viewing.report.reading import RUNS_OF_STUDY

_HEADINGS = (
    *("group", "variant", "environment", "seeds", "mean ± standard error", "interquartile mean [95 %]"),
    *("success rate", "against", "p (Holm)", "p (Mann-Whitney)", "superiority", "hours"),
)
_NEEDED = ("group", "variant", "env", "seeds", "score_mean", "score_iqm")
_HINT = (
    "Mean and interquartile mean over seeds of the measure of the experiment, with a bootstrap interval; p values of a "
    "permutation test, corrected by Holm's method, and of a Mann-Whitney U test; superiority: the probability that a "
    "seed exceeds one of the variant it is compared with; hours: mean of the runs."
)
_CURVES_HINT = (
    "Mean over seeds, with a 95 % bootstrap interval where there are few curves, as far as all seeds reach. A curve "
    "with a transferred primitive begins where the training of its primitive ended, if curves.csv has that time."
)
_ORIGIN = ("hardware", "versions", "commit")
_SETTINGS = "table1-settings"
"""Table of the settings in Table I, beside those of scale paper."""


def experiment_section(folder: Path) -> tuple[str, dict[str, dict[str, Figure]]]:
    """Return the section of the experiment in `folder`, and the figures of plotly in it by name; empty without one.

    Raises:
        RunFolderError: A file cannot be read.
    """
    if not (folder / RUNS_OF_STUDY).is_file():
        return "", {}
    try:
        charts = {f"{folder} {title}": figures for title, figures in experiment_charts(folder).items()}
        tables = {path.stem: rows for path in sorted(folder.glob("*.csv")) if (rows := _read(path))}
        figures = {path.stem: b64encode(path.read_bytes()).decode() for path in sorted(folder.glob("*.png"))}
        parts = [paragraph(_CURVES_HINT, "hint") if charts else "", plots(charts)]
        parts += [cards(image_card(name, f"data:image/png;base64,{data}") for name, data in figures.items())]
        for name, rows in tables.items():
            parts += [f"<h3>{escape(name)}</h3>", table(_HEADINGS, map(_cells, rows), "figures")]
            parts += [paragraph(_origin(rows), "hint")]
        parts += [_settings_of_table_1(folder)]
    except (OSError, ValueError, KeyError, csv.Error) as error:
        raise RunFolderError(f"the experiment in {folder} cannot be read: {error}.") from error
    return section(f"Experiment {folder}", paragraph(_HINT, "hint"), *parts), charts


def _settings_of_table_1(folder: Path) -> str:
    """Return the settings that `shes experiment table1` has written, shown on demand; empty without them."""
    file = folder / f"{_SETTINGS}.csv"
    if not file.is_file():
        return ""
    with file.open(newline="", encoding="utf-8") as lines:
        headings, *rows = csv.reader(lines)
    return details(
        "Settings of Table I, and of scale paper", table([name.replace("_", " ") for name in headings], rows)
    )


def _read(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table of comparisons; none if it is another table."""
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        is_comparison = set(_NEEDED) <= set(reader.fieldnames or ())
        return list(reader) if is_comparison else []


def _cells(row: Mapping[str, str]) -> tuple[str, ...]:
    """Return the cells of `_HEADINGS` for a comparison."""

    def text(name: str, digits: int = 2) -> str:
        return f"{float(row[name]):.{digits}f}" if row.get(name) else "-"

    def estimate(name: str) -> str:
        return text(f"{name}_mean") + (f" ± {text(f'{name}_error')}" if row.get(f"{name}_error") else "")

    return (
        *(row[name] for name in ("group", "variant", "env", "seeds")),
        estimate("score"),
        f"{text('score_iqm')} [{text('score_iqm_low')}, {text('score_iqm_high')}]",
        estimate("success"),
        ", ".join(filter(None, (row.get("against_group"), row.get("against")))) or "-",
        *(text(name, digits) for name, digits in (("p_holm", 4), ("mann_whitney_p", 4), ("superiority", 2))),
        text("hours", 3),
    )


def _origin(rows: Sequence[Mapping[str, str]]) -> str:
    """Return hardware, versions and commits of the runs."""
    found = {name: dict.fromkeys(row[name] for row in rows if row.get(name)) for name in _ORIGIN}
    return " · ".join(f"{name}: {'; '.join(values)}" for name, values in found.items() if values)
