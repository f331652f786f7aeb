"""The section of an experiment: the curves, figures and comparisons that `shes experiment` has written."""

from __future__ import annotations

import csv
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from shes.errors import RunFolderError
from shes.viewing.report.experiment_charts import Charts, experiment_charts
from shes.viewing.report.experiment_design import Designs, read_designs
from shes.viewing.report.page import cards, details, heading, image_card, paragraph, plots, section, table
from shes.viewing.report.reading import RUNS_OF_STUDY

_RESULTS = (
    *("environment", "runs", "seeds", "mean ± standard error", "interquartile mean [95 %]"),
    *("success rate", "hours"),
)
_COMPARISONS = (
    *("environment", "runs", "compared with", "difference", "p (Holm)", "p (Mann-Whitney)", "superiority"),
    *("ratio", "equal steps", "equal time"),
)
_NEEDED = ("group", "variant", "env", "seeds", "score_mean", "score_iqm")
_HINT = (
    "Results: mean over seeds of the measure of the experiment ± standard error, and interquartile mean, with a "
    "bootstrap interval; hours: mean of the runs, after those of a transferred primitive. Comparisons: p values of a "
    "permutation test, corrected by Holm's method, and of a Mann-Whitney U test, not corrected; superiority: the "
    "probability that a seed exceeds one of those it is compared with; ratio: of the measure of each seed, with the "
    "lowest and the highest; equal steps, equal time: mean test score over the steps and the time that both have, a "
    "transferred primitive's included, with p values like the first."
)
_CURVES_HINT = (
    "Mean over seeds, with a 95 % t interval of three seeds or more if there are at most ten curves, as far as all "
    "seeds reach. A curve with a transferred primitive begins where the training of its primitive ended (dotted), if "
    "curves.csv has that time. The training reward of a primitive alone is that of a branch where branches evaluate it."
)
_ORIGIN = ("hardware", "versions", "commit")
_SETTINGS = "table1-settings"
"""Table of the settings in Table I, beside those of scale paper."""


def experiment_section(folder: Path) -> tuple[str, Charts]:
    """Return the section of the experiment in `folder`, and the figures of plotly in it by name; empty without one.

    Raises:
        RunFolderError: A file cannot be read.
    """
    if not (folder / RUNS_OF_STUDY).is_file():
        return "", {}
    try:
        designs = read_designs(folder)
        by_experiment = experiment_charts(folder, designs)
        charts = {
            name: {f"{folder} {name} {title}".replace("  ", " "): figure for title, figure in own.items()}
            for name, own in by_experiment.items()
        }
        tables = {path.stem: rows for path in sorted(folder.glob("*.csv")) if (rows := _read(path))}
        figures = {path.stem: b64encode(path.read_bytes()).decode() for path in sorted(folder.glob("*.png"))}
        parts = [
            paragraph(_questions(folder, designs), "hint"),
            paragraph(_CURVES_HINT, "hint") if charts else "",
        ]
        for name, own in charts.items():
            title = designs.title(name) if name else "Further curves"
            parts += [heading(title) if designs.by_name else "", plots(own)]
        parts += [cards((image_card(name, f"data:image/png;base64,{data}") for name, data in figures.items()), "wide")]
        parts += [paragraph(_HINT, "hint") if tables else ""]
        parts += [part for name, rows in tables.items() for part in _tables(name, rows, designs)]
        parts += [_settings_of_table_1(folder)]
    except (OSError, ValueError, KeyError, TypeError, csv.Error) as error:
        raise RunFolderError(f"the experiment in {folder} cannot be read: {error}.") from error
    return section(f"Experiment {folder}", *parts), {
        name: each for own in charts.values() for name, each in own.items()
    }


def _questions(folder: Path, designs: Designs) -> str:
    """Return the questions of the groups that have runs; empty without a design."""
    with (folder / RUNS_OF_STUDY).open(newline="", encoding="utf-8") as file:
        groups = {row["group"] for row in csv.DictReader(file)}
    return "; ".join(f"{group}: {words}" for group, words in designs.questions.items() if group in groups)


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


def _tables(name: str, rows: Sequence[Mapping[str, str]], designs: Designs) -> Iterator[str]:
    """Yield the results of an experiment, once for all comparisons of the same runs, then these and their origin."""
    title = designs.title(name)
    results = dict.fromkeys(_result(row, designs) for row in rows)
    comparisons = [_comparison(row, designs) for row in rows if row.get("against")]
    yield heading(f"{title}: results")
    yield table(_RESULTS, results, "figures")
    if comparisons:
        yield heading(f"{title}: comparisons")
        yield table(*_without_empty(_COMPARISONS, comparisons), "figures")
    yield paragraph(_origin(rows), "hint")


def _text(row: Mapping[str, str], name: str, digits: int = 2) -> str:
    return f"{float(row[name]):.{digits}f}" if row.get(name) else "-"


def _p(row: Mapping[str, str], name: str) -> str:
    return "-" if not row.get(name) else "<0.001" if float(row[name]) < 0.001 else _text(row, name, 3)


def _estimate(row: Mapping[str, str], name: str) -> str:
    error = f" ± {_text(row, f'{name}_error')}" if row.get(f"{name}_error") else ""
    return _text(row, f"{name}_mean") + error


def _result(row: Mapping[str, str], designs: Designs) -> tuple[str, ...]:
    """Return the cells of `_RESULTS`."""
    interval = "" if row["seeds"] == "1" else f" [{_text(row, 'score_iqm_low')}, {_text(row, 'score_iqm_high')}]"
    return (
        row["env"],
        designs.method(row["group"], row["variant"]),
        row["seeds"],
        _estimate(row, "score"),
        _text(row, "score_iqm") + interval,
        _estimate(row, "success"),
        " + ".join(_text(row, name, 3) for name in ("primitive_hours", "hours") if row.get(name)) or "-",
    )


def _comparison(row: Mapping[str, str], designs: Designs) -> tuple[str, ...]:
    """Return the cells of `_COMPARISONS`."""
    return (
        row["env"],
        designs.method(row["group"], row["variant"]),
        designs.method(row.get("against_group") or row["group"], row["against"]),
        f"{float(row['difference']):+.2f}" if row.get("difference") else "-",
        *(_p(row, "p_holm"), _p(row, "mann_whitney_p"), _text(row, "superiority")),
        _ratio(row),
        *(_at_equal(row, name) for name in ("steps", "hours")),
    )


def _ratio(row: Mapping[str, str]) -> str:
    return f"{_text(row, 'ratio')} [{_text(row, 'ratio_low')}, {_text(row, 'ratio_high')}]" if row.get("ratio") else "-"


def _at_equal(row: Mapping[str, str], name: str) -> str:
    """Return the mean test scores of both over the steps, or the hours, that both have."""
    if not row.get(f"{name}_span"):
        return "-"
    scores = f"{_text(row, f'{name}_score')} against {_text(row, f'{name}_score_against')}"
    span = float(row[f"{name}_span"])
    words = f"{span / 1e6:.2f} M" if name == "steps" else f"{60 * span:.1f} min"
    p = f", p {_p(row, f'{name}_p_holm')}" if row.get(f"{name}_p_holm") else ""
    return f"{scores} in {words}{p}"


def _without_empty(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[list[str], list[tuple[str, ...]]]:
    """Return a table without the columns in which every cell is a dash."""
    kept = [i for i in range(len(headings)) if any(row[i] != "-" for row in rows)]
    return [headings[i] for i in kept], [tuple(row[i] for i in kept) for row in rows]


def _origin(rows: Sequence[Mapping[str, str]]) -> str:
    """Return hardware, versions and commits of the runs."""
    found = {
        name: dict.fromkeys(each for row in rows if row.get(name) for each in row[name].split("; ")) for name in _ORIGIN
    }
    return " · ".join(f"{name}: {'; '.join(values)}" for name, values in found.items() if values)
