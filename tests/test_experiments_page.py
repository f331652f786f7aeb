"""The tables of docs/experiments.md are those of the comparisons, and these are those of the runs."""

import csv
import json
import re
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from shes.studies.comparison import compare
from shes.studies.named_studies import STUDIES
from shes.studies.study import cell_steps
from shes.studies.summaries import read_summaries

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results" / "paper"
PAGES = " ".join(
    " ".join((ROOT / "docs" / n).read_text("utf-8") for n in ("experiments.md", "how-to/paper.md")).split()
)
COMPARISONS = {
    "ablation": "ablation/comparison",
    "learning": "learning/comparison",
    **{name: f"paper/{name}" for name in STUDIES if (RESULTS / f"{name}-design.json").is_file()},
}


@pytest.fixture
def tables(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    import experiment_tables

    yield experiment_tables
    for name in ("experiment_tables", "markdown_table"):
        del sys.modules[name]


def rows_of(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def split(row):
    """Return the numbers of a row of texts, and its other cells."""
    numbers = {}
    for name, text in row.items():
        with suppress(ValueError):
            numbers[name] = float(text)
    return numbers, {name: text for name, text in row.items() if name not in numbers}


def test_the_tables_of_the_page_are_up_to_date(tables):
    page = tables.PAGE.read_text(encoding="utf-8")
    assert tables.filled(page) == page, "run: python docs/experiment_tables.py"
    places = [match[2] for match in tables._PLACE.finditer(page)]
    assert page.count("<!-- ") == 2 * len(places)
    assert {*tables._KINDS, "missing"} >= set(places) >= {"scores", "budgets", "missing"}


@pytest.mark.parametrize("experiment", COMPARISONS)
def test_the_comparisons_are_those_of_the_runs(experiment):
    study, path = STUDIES[experiment]("laptop", None), ROOT / "results" / f"{COMPARISONS[experiment]}.csv"
    made = [comparison.row() for comparison in compare(study, read_summaries(study, path.parent))]
    there = rows_of(path)
    assert len(made) == len(there) > 0
    for mine, row in zip(made, there, strict=True):
        numbers, words = split({name: "" if value is None else str(value) for name, value in mine.items()})
        expected, words_there = split(row)
        assert words == words_there
        assert numbers == pytest.approx(expected, rel=1e-9)


def test_a_table_has_every_method_once_and_the_tests_against_the_base(tables, tmp_path):
    empty = dict.fromkeys(rows_of(RESULTS / "fig5.csv")[0], "")
    score = {"seeds": "3", "score_mean": "0.5", "score_error": "0.288", "hours": "0.1", "env_steps": "2e6"}
    score |= {"score_iqm": "0.5", "score_iqm_low": "0", "score_iqm_high": "1"}
    ends = {"steps_span": "3e6", "steps_score": "0.25", "steps_score_against": "0.125", "steps_p_holm": "0.0004"}
    primitive = {"primitive_hours": "0.5", "primitive_env_steps": "1e6"}
    base, other = ({"group": "methods", "variant": name} for name in ("first", "second"))
    against = {"against_group": "methods", "against": "first", "p_holm": "0.0512", "mann_whitney_p": "0.3"}
    rows = [
        {**base, **score},
        {**other, **score, **against, **ends, **primitive, "score_error": ""},
        {**base, **score, **against, "against": "second"},
    ]
    with (tmp_path / "fig9.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(empty))
        writer.writeheader()
        writer.writerows({**empty, "env": "ant-maze", **row} for row in rows)
    design = {
        "variants": {"methods": {"first": "one", "second": "two"}},
        "charts": [{"curves": [{**base, "words": words}]} for words in ("the first", "a later figure's")],
    }
    (tmp_path / "fig9-design.json").write_text(json.dumps(design), encoding="utf-8")
    page = "before\n<!-- scores of fig9 -->\nold\n<!-- end -->\n<!-- budgets of fig9 -->\n<!-- end -->\nafter"
    lines = tables.filled(page, tmp_path).splitlines()
    assert "old" not in lines
    assert (lines[0], lines[-1]) == ("before", "after")
    assert [
        line.replace("\N{NO-BREAK SPACE}", "_") for line in lines if line.startswith("|") and re.search(r"\d", line)
    ] == [
        "| Ant Maze | the first | 3 | 0.50_±_0.29 | 0.50 (0.00_to_1.00) | – | – | 2.0 | 6.0 |",
        "|  | two | 3 | 0.50 | 0.50 (0.00_to_1.00) | 0.051 | 0.30 | 1.0_+_2.0 | 30_+_6.0 |",
        "| Ant Maze | two | the first | 3.0 | 0.25,_0.12 | <0.001 | – | – | – |",
    ]


def test_every_group_of_runs_is_at_the_papers_scale_once(tables):
    groups = [group for name in ("fig3", "fig4", "fig5") for group in STUDIES[name]("paper", None).design.groups]
    assert sorted(group for _, group in tables._AT_THE_PAPERS_SCALE) == sorted(set(groups))
    lines = tables.missing().splitlines()[2:]
    assert [line.split(" | ")[0] for line in lines] == [f"| {name}" for name, _ in tables._AT_THE_PAPERS_SCALE]


def column(name, env, group="methods", variant="pieces", table="runs", body="ant"):
    """Return the values of a column of a table for the seeds of a variant, sorted."""
    place = {"env": f"{body}-{env}", "group": group, "variant": variant}
    rows = [row for row in rows_of(RESULTS / f"{table}.csv") if place.items() <= row.items()]
    return sorted(float(row[name]) for row in rows)


def listed(values, sign):
    *first, last = (sign.format(value) for value in values)
    return f"{', '.join(first)} and {last}"


def spread(values, sign="{:.0f}"):
    return f"{sign.format(min(values))} to {sign.format(max(values))}"


def per_cent(env):
    return f"{listed([100 * score for score in column('best_score', env)], '{:.0f}')} %"


def equal(env, first, second, budget="steps"):
    """Return the mean test scores of the second method and of the first over equal budgets, and p."""
    place = dict(zip(("group", "variant", "against_group", "against"), (*second, *first), strict=True))
    rows = [row for row in rows_of(RESULTS / "fig5.csv") if {**place, "env": env}.items() <= row.items()]
    score, other, p = (float(rows[0][f"{budget}_{name}"]) for name in ("score", "score_against", "p_holm"))
    return (
        f"{score:.2f} against {other:.2f}",
        "p < 0.001" if p < 0.001 else f"p = {p:.3f}" if p < 0.1 else f"p = {p:.2f}",
    )


def compared(env, group="transfer", variant="pieces", against="pieces", budget="steps"):
    return "{}, {}".format(*equal(env, ("methods", against), (group, variant), budget))


def first_at(score, group):
    """Return the million steps of a run after which an evaluation has this mean score, for each seed."""
    place = {"env": "ant-gather", "group": group, "variant": "pieces"}
    rows = [row for row in rows_of(RESULTS / "curves.csv") if place.items() <= row.items()]
    steps = {}
    for row in rows:
        if float(row["score_mean"]) >= score:
            steps.setdefault(row["seed"], float(row["env_steps"]) / 1e6)
    assert steps.keys() == {row["seed"] for row in rows}
    return list(steps.values())


def most_as_published(env):
    return max(max(column("best_score", env, group, "published")) for group in ("methods", "transfer"))


def of_point(env, variant="pieces"):
    return column("best_score", env, "methods", variant, body="point")


def first_of_both(score):
    """Return the million steps of a transferred run, with its primitive's, until a score."""
    runs = column("env_steps", "flagrun", "transfer")
    assert max(runs) - min(runs) < 5e4
    return [steps + np.mean(runs) / 1e6 for steps in first_at(score, "transfer")]


def point_as_published():
    gather, maze, push = (of_point(env, "published") for env in ("gather", "maze", "push"))
    assert (sum(each > 0.5 for each in maze), sum(each > 0.5 for each in push)) == (3, 2)
    assert push[-2] == 1.0
    return (
        f"It scores {np.mean(gather):.1f} in Gather on average ({spread(gather, '{:.1f}')} by seed)",
        f"in at least {100 * maze[-3]:.0f} % of the episodes with three seeds of ten and that of Push in every episode",
        f"two, and in at most {100 * max(maze[-4], push[-3]):.0f} % with the others",
    )


def point_with_changes():
    gather, maze, push = (of_point(env) for env in ("gather", "maze", "push"))
    over_steps = {
        env: compared(f"point-{env}", "methods", against="published").replace(", ", f" in {env.title()} (")
        for env in ("gather", "maze", "push")
    }
    return (
        f"it scores {np.mean(gather):.1f} ({spread(gather, '{:.1f}')})",
        f"reaches the targets in at least {100 * maze[0]:.0f} and {100 * push[0]:.0f} % with every seed",
        "the mean test score is {gather}), {maze}) and {push}).".format(**over_steps),
    )


def point_transfer():
    def published(env):
        return compared(f"point-{env}", variant="published", against="published").replace(", ", f" in {env.title()} (")

    steps = column("env_steps", "push", body="point")[0]
    walker = np.mean(column("seconds", "flagrun", "transfer", body="point"))
    push = np.mean(column("seconds", "push", body="point")) * 5e5 / steps
    behind = compared("point-gather", budget="hours")
    return (
        f"it has {published('gather')}), {published('maze')}) and {published('push')}).",
        f"behind over equal time ({behind}; over equal steps {compared('point-gather')})",
        f"ahead in Push ({compared('point-push', budget='hours')})",
        f"take {walker:.0f} s, as many of Push {push:.0f} s",
    )


def evaluations():
    rows = (row for row in rows_of(RESULTS / "curves.csv") if row["variant"] != "hiro")
    count = Counter((row["env"], row["group"], row["variant"], row["seed"]) for row in rows)
    falls = ("ant-push", "transfer", "pieces")
    ant, push, point, walkers = (
        spread([times for run, times in count.items() if kind(run)])
        for kind in (
            lambda run: run[0].startswith("ant-") and run[1] in ("methods", "transfer") and run[:3] != falls,
            lambda run: run[:3] == falls,
            lambda run: run[0].startswith("point-") and run[0] != "point-flagrun",
            lambda run: run[0] == "point-flagrun",
        )
    )
    return (
        f"The ant is evaluated {ant} times in every run of SHES (",
        f"with the learning changes {push} times, because",
        f"the point {point} times, its walkers {walkers.replace('to', 'and')} times",
    )


def number(count):
    return ("no", "one", "two", "three", "four", "five")[count]


CLAIMS = {
    "evaluations": evaluations,
    "point as published": point_as_published,
    "point with the changes": point_with_changes,
    "point, transfer": point_transfer,
    "Gather, steps of both": lambda: f"of the primitive it is {spread(first_of_both(2), '{:.1f}')}.",
    "as published in Gather": lambda: f"scores more than {most_as_published('gather'):.2f},",
    "walkers as published": lambda: f"return {spread(column('best_score', 'flagrun', 'transfer', 'published'))} on",
    "walkers": lambda: f"they return {spread(column('best_score', 'flagrun', 'transfer'))},",
    "Gather": lambda: f"SHES scores {listed(column('best_score', 'gather'), '{:.1f}')} in Gather",
    "Maze": lambda: f"the target of Maze in {per_cent('maze')}",
    "Push": lambda: f"that of Push in {per_cent('push')} of the episodes",
    "Gather, transfer": lambda: (
        f"scores {listed(column('best_score', 'gather', 'transfer'), '{:.1f}')}, and over equal"
    ),
    "Gather, equal steps": lambda: "it has a mean test score of {} ({}).".format(
        *equal("ant-gather", ("methods", "pieces"), ("transfer", "pieces"))
    ),
    "Maze, slow seeds": lambda: (
        f"they have {listed(column('metres_behind_mean', 'maze', table='metres_behind')[:2], '{:.0f}')} m of the 48 m"
    ),
    "Gather, a score of 2": lambda: (
        f"after at most {max(first_at(2, 'transfer')):.1f} million steps of its own, from scratch after "
        f"{spread(first_at(2, 'methods'), '{:.1f}')}."
    ),
    "Maze, transfer": lambda: f"have {spread(column('metres_behind_mean', 'maze', 'transfer', table='metres_behind'))}",
    "Maze, scratch": lambda: f"{spread(column('metres_behind_mean', 'maze', table='metres_behind'))} m of it",
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_the_page_says_what_the_results_say(claim):
    said = CLAIMS[claim]()
    for words in [said] if isinstance(said, str) else said:
        assert words in PAGES


def test_the_page_says_how_long_a_run_of_scale_paper_takes_on_48_cores(tables):
    study = STUDIES["fig3"]("paper", 1)
    steps = [sum(cell_steps(cell, study.episodes)) for cell in study.cells if cell.variant != "hiro"]
    hours = [each / speed / 3600 / 48 for each in (min(steps), max(steps)) for speed in tables.SPEEDS]
    assert f"a run of 3000 generations takes {spread(hours)} hours" in PAGES


def test_the_pages_say_how_many_core_hours_all_experiments_take_at_scale_paper(tables):
    steps = 0
    for name, group in tables._AT_THE_PAPERS_SCALE:
        study = STUDIES[name]("paper", None)
        cells = [cell for cell in study.cells if cell.group == group and cell.variant != "hiro"]
        steps += sum(sum(cell_steps(cell, study.episodes)) for cell in cells)
    assert spread([steps / speed / 3.6e6 for speed in tables.SPEEDS], "{:.0f},000") in PAGES


def test_no_ant_as_published_reaches_a_target():
    assert most_as_published("maze") == most_as_published("push") == 0
