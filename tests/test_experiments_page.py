"""The tables of docs/experiments.md are those of the comparisons, and these are those of the runs."""

import csv
import itertools
import json
import re
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shes.studies.comparison import compare
from shes.studies.equal_budget import compare_curves
from shes.studies.named_studies import STUDIES
from shes.studies.paper_scales import STEPS, WITH_OTHER_GOALS
from shes.studies.significance import holm, permutation_test
from shes.studies.study import cell_steps
from shes.studies.summaries import read_summaries
from tests.studies.stored import RENAMED, stored_summaries

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
    read = stored_summaries if path.parent == RESULTS else read_summaries
    made = [comparison.row() for comparison in compare(study, read(study, path.parent))]
    there = rows_of(path)
    assert len(made) == len(there) > 0
    for mine, row in zip(made, there, strict=True):
        numbers, words = split(
            {name: "" if value is None else RENAMED.get(str(value), str(value)) for name, value in mine.items()}
        )
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
    runs = [{**base, "env": "ant-maze", "last_score": last} for last in ("0.25", "0.5", "0.75")]
    runs.append({**other, "env": "ant-maze", "last_score": ""})
    with (tmp_path / "runs.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(runs[0]))
        writer.writeheader()
        writer.writerows(runs)
    page = "before\n<!-- scores of fig9 -->\nold\n<!-- end -->\n<!-- budgets of fig9 -->\n<!-- end -->\nafter"
    lines = tables.filled(page, tmp_path).splitlines()
    assert "old" not in lines
    assert (lines[0], lines[-1]) == ("before", "after")
    assert [
        line.replace("\N{NO-BREAK SPACE}", "_") for line in lines if line.startswith("|") and re.search(r"\d", line)
    ] == [
        "| Ant Maze | the first | 3 | 0.50_±_0.29 | 0.50 (0.00_to_1.00) | 0.50 | – | – | 2.0 | 6.0 |",
        "|  | two | 3 | 0.50 | 0.50 (0.00_to_1.00) | – | 0.051 | 0.30 | 1.0_+_2.0 | 30_+_6.0 |",
        "| Ant Maze | two | the first | 3.0 | 0.25,_0.12 | <0.001 | – | – | – |",
    ]
    (tmp_path / "runs.csv").write_text("group,variant,env,last_score\nmethods,first,ant-maze,1\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"runs\.csv has 1 runs of ant-maze methods first, fig9\.csv is of 3"):
        tables.filled(page, tmp_path)


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


def comparison(env, first, second, table="fig5"):
    """Return the row that compares the second method with the first, each a group and a variant."""
    place = dict(zip(("group", "variant", "against_group", "against"), (*second, *first), strict=True))
    [row] = (row for row in rows_of(RESULTS / f"{table}.csv") if {**place, "env": env}.items() <= row.items())
    return row


def p_value(text):
    p = float(text)
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}" if p < 0.1 else f"p = {p:.2f}"


def equal(env, first, second, budget="steps", table="fig5"):
    """Return the mean test scores of the second method and of the first over equal budgets, and p."""
    row = comparison(env, first, second, table)
    score, other = (float(row[f"{budget}_{name}"]) for name in ("score", "score_against"))
    return f"{score:.2f} against {other:.2f}", p_value(row[f"{budget}_p_holm"])


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
    last = column("last_score", "maze", body="point")
    over_steps = {
        env: compared(f"point-{env}", "methods", against="published").replace(", ", f" in {env.title()} (")
        for env in ("gather", "maze", "push")
    }
    return (
        f"it scores {np.mean(gather):.1f} ({spread(gather, '{:.1f}')})",
        f"reaches the targets in at least {100 * maze[0]:.0f} and {100 * push[0]:.0f} % with every seed",
        f"of {number(last.count(0))} seeds never reach that of Maze",
        f"the ten reach it in {100 * np.mean(last):.0f} % on average",
        "the mean test score is {gather}), {maze}) and {push}).".format(**over_steps),
    )


def last_training_reward(env, group, variant):
    """Return the mean training reward before the last evaluation, for each seed."""
    last = {}
    for row in rows_of(RESULTS / "curves.csv"):
        if (row["env"], row["group"], row["variant"]) == (env, group, variant):
            last[row["seed"]] = float(row["training_return_mean"])
    return np.array(list(last.values()))


def transferred_reward(env, variant):
    """Return the mean training rewards at the end, with a transferred primitive and without, and p."""
    alone, transferred = (last_training_reward(env, group, variant) for group in ("methods", "transfer"))
    sign = "{:.2f}" if env.endswith("gather") else "{:,.0f}"
    words = " against ".join(sign.format(side.mean()).replace("-", "\N{MINUS SIGN}") for side in (transferred, alone))
    return words, permutation_test(alone, transferred)


def training_rewards():
    tasks = ("gather", "maze", "push")
    words, p = zip(*(transferred_reward(f"point-{task}", "published") for task in tasks), strict=True)
    ant, p_of_ant = transferred_reward("ant-gather", "pieces")
    gather, maze, push = (
        f"{each} in {task.title()} ({p_value(corrected)}"
        for each, task, corrected in zip(words, tasks, holm(p), strict=True)
    )
    return f"at the end {gather}), {maze}) and {push};", f"its training reward ends at {ant} ({p_value(p_of_ant)})"


def machines():
    """The two machines are compared by the methods that have seeds on both, of runs in one process."""
    times = {}
    for row in rows_of(RESULTS / "runs.csv"):
        if row["group"] not in ("workers", "speedup"):
            of = times.setdefault((row["env"], row["group"], row["variant"]), {})
            of.setdefault("Xeon" in row["hardware"], []).append(float(row["seconds"]))
    ratios = [np.mean(of[False]) / np.mean(of[True]) for of in times.values() if len(of) == 2]
    assert len(ratios) >= 10
    return f"an AMD EPYC, which takes {spread(ratios, '{:.1f}')} times as long for the same runs"


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
            lambda run: run[0].startswith("point-") and run[0] != "point-flagrun" and run[1] != "workers",
            lambda run: run[0] == "point-flagrun",
        )
    )
    timed = spread([times for run, times in count.items() if run[0].startswith("ant-") and run[1] == "workers"])
    return (
        f"The ant is evaluated {ant} times in every run of SHES (in `fig4` {timed} times;",
        f"with the learning changes {push} times, because",
        f"the point {point} times, its walkers {walkers.replace('to', 'and')} times",
    )


def number(count):
    return ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "all ten")[count]


def third(env, budget, first="hiro", second="pieces"):
    """Return the mean test scores of two methods over equal budgets and p, from the comparisons of Figure 3."""
    row = comparison(env, ("methods", first), ("methods", second), "fig3")
    score, other = (f"{float(row[f'{budget}_{name}']):.2f}" for name in ("score", "score_against"))
    return score, other, p_value(row[f"{budget}_p_holm"])


def last_and_best(env, variant):
    """Return the means over seeds of the last test score of a run and of its best one."""
    runs = {}
    for row in rows_of(RESULTS / "curves.csv"):
        if (row["env"], row["group"], row["variant"]) == (env, "methods", variant):
            runs.setdefault(row["seed"], []).append(float(row["score_mean"]))
    return tuple(
        float(np.mean([choose(scores) for scores in runs.values()])) for choose in (lambda each: each[-1], max)
    )


def passes(score):
    """Return when the first test score of at least `score` comes in Ant Gather, over seeds."""
    minutes = {}
    for row in rows_of(RESULTS / "curves.csv"):
        is_ours = (row["env"], row["group"], row["variant"]) == ("ant-gather", "methods", "pieces")
        if is_ours and float(row["score_mean"]) >= score:
            minutes.setdefault(row["seed"], float(row["seconds"]) / 60)
    steps = spread(first_at(score, "methods"), "{:.1f}")
    return f"of at least {score} comes after {steps} million steps, {spread(minutes.values(), '{:.1f}')} minutes"


def minutes_of(variant, *envs, body="ant"):
    return [each / 60 for env in envs for each in column("seconds", env, variant=variant, body=body)]


def if_hiro_were_as_fast(env, slower=1.4):
    """Return the mean test scores of SHES and HIRO over equal time and p, were HIRO's times on the slower machine less.

    The machine takes 1.2 to 1.4 times as long as the other one.
    """
    study = STUDIES["fig3"]("laptop", None)
    study = replace(study, cells=tuple(cell for cell in study.cells if (cell.env, cell.group) == (env, "methods")))
    found = stored_summaries(study, RESULTS)
    for cell in study.cells:
        if cell.variant == "hiro" and "EPYC" in found[cell.name].row["hardware"]:
            curve = tuple({**row, "seconds": row["seconds"] / slower} for row in found[cell.name].curve)
            found[cell.name] = replace(found[cell.name], curve=curve)
    [made] = (each for each in compare(study, found) if (each.variant, each.against) == ("pieces", "hiro"))
    return f"{made.hours_score:.2f} against {made.hours_score_against:.2f}", p_value(made.hours_p_holm)


def hiro_in_point_gather():
    scores = of_point("gather", "hiro")
    assert len(scores) == 10
    row = comparison("point-gather", ("methods", "hiro"), ("methods", "pieces"), "fig3")
    steps, hours = (third("point-gather", budget) for budget in ("steps", "hours"))
    ours = np.mean(of_point("gather"))
    took = spread(minutes_of("hiro", "gather", body="point"), "{:.1f}")
    return (
        f"HIRO scores {np.mean(scores):.1f} ({spread(scores, '{:.1f}')} by seed) after 300,000 steps",
        f"{took} minutes of a core",
        f"{ours:.1f} after 3 million steps and {60 * float(row['hours_span']):.1f} minutes ({p_value(row['p_holm'])})",
        f"Over the first {60 * float(row['hours_span']):.1f} minutes SHES has the higher mean test score, "
        "{} against {} ({};".format(*hours),
        "with HIRO's times on the slower machine divided by 1.4, {}, {})".format(*if_hiro_were_as_fast("point-gather")),
        "over equal steps HIRO has, {1} against {0} ({2})".format(*steps),
    )


def hiro_in_point_push():
    best, last = of_point("push", "hiro"), column("last_score", "push", variant="hiro", body="point")
    assert len(best) == 10
    ours = np.mean(column("last_score", "push", body="point"))
    steps, hours = (third("point-push", budget) for budget in ("steps", "hours"))
    return (
        f"the best checkpoints of {number(sum(score > 0.5 for score in best))} seeds of HIRO",
        f"the last policies in {100 * np.mean(last):.0f} % of the episodes (SHES: {100 * ours:.0f} %)",
        "over equal steps HIRO is ahead, {1} against {0} ({2})".format(*steps),
        "over equal time SHES is, {} against {} ({};".format(*hours),
        "with HIRO's times divided so, {}, {}).".format(*if_hiro_were_as_fast("point-push")),
    )


def hiro_in_point_maze():
    assert max(of_point("maze", "hiro")) == max(last_and_best("point-maze", "hiro")) == 0
    rows = rows_of(ROOT / "results" / "hiro" / "curves.csv")
    without = {
        row["seed"]
        for row in rows
        if row["group"] == "hiro-point-maze" and float(row["env_steps"]) < 3.01e5 and float(row["success_rate"]) > 0.5
    }
    return (f"{number(len(without))} seeds of five reached it within 300,000 steps without waypoints",)


def hiro_of_the_ant():
    gather, *others = (column("best_score", env, variant="hiro") for env in ("gather", "maze", "push"))
    assert all(max(scores) == 0 for scores in others)
    assert len(gather) == 5
    tasks = ("gather", "maze", "push")
    steps = {task: third(f"ant-{task}", "steps") for task in tasks}
    hours = {task: third(f"ant-{task}", "hours") for task in tasks}
    assert all(each[:2] == ("0.00", "0.00") for task, each in steps.items() if task != "gather")
    _, published, p = third("ant-gather", "hours", "published", "hiro")
    return (
        f"it scores at most {max(gather):.2f} in Gather",
        f"({steps['gather'][0]} against {steps['gather'][1]} in Gather, 0 against 0 in Maze and Push)",
        "it is ahead in Gather ({} against {}, {})".format(*hours["gather"]),
        "and in Push ({} against {}, {})".format(*hours["push"]),
        f"in Maze this is not shown ({hours['maze'][2]})",
        f"no difference is shown (HIRO {hours['gather'][1]}, SHES {published} over equal time in Gather, {p}).",
        f"HIRO has {spread(minutes_of('hiro', *tasks))} minutes here, SHES",
        f"with the learning changes {spread(minutes_of('pieces', *tasks))}.",
    )


def machines_of_hiro():
    rows = [row for row in rows_of(RESULTS / "runs.csv") if row["group"] == "methods"]
    fast = {
        variant: Counter(row["env"] for row in rows if row["variant"] == variant and "Xeon" in row["hardware"])
        for variant in ("hiro", "pieces")
    }
    assert fast["hiro"] == {f"{body}-{task}": 3 for body in ("point", "ant") for task in ("gather", "maze", "push")}
    ours = {env: 10 if env.startswith("point") else 5 for env in fast["hiro"] if env != "ant-gather"}
    assert fast["pieces"] == ours
    return ("Three seeds of HIRO on each task ran on the faster of the two machines and the others on the slower one",)


def running_best():
    cases = (("point-maze", "pieces"), ("point-push", "hiro"))
    (maze, maze_best), (push, push_best) = (last_and_best(*case) for case in cases)
    return (
        f"ends at {maze_best:.2f} where the last test score is {maze:.2f}",
        f"at {push_best:.2f} where it is {push:.2f}.",
    )


def step_scores(body):
    """Return the mean scores of the steps between the forms, and of the form with the changes."""
    names = [RENAMED.get(name, name) for name in STEPS[body]]
    means = [np.mean(column("best_score", "gather", "steps", name, body=body)) for name in names]
    return [*means, np.mean(column("best_score", "gather", body=body))]


def steps_of_the_point():
    published = np.mean(of_point("gather", "published"))
    views, branches, ties, pieces = (f"{score:.1f}" for score in step_scores("point"))
    of_views, of_ties = (
        "{} ({})".format(*equal("point-gather", ("methods", "published"), ("steps", name), table="fig3"))
        for name in ("views", "ties")
    )
    row = comparison("point-gather", ("methods", "pieces"), ("steps", "ties"), "fig3")
    return (
        f"The point scores {published:.1f} as published, {views} with egocentric views",
        f"{branches} with branched intervals added, {ties} with output layers at zero",
        f"and {pieces} with all changes",
        f"the views have {of_views}, all three steps {of_ties};",
        f"no difference is shown ({p_value(row['steps_p_holm'])}; of",
        f"of the scores of the best checkpoints, {p_value(row['p_holm'])})",
    )


def steps_of_the_ant():
    def returns_of(name):
        return np.mean(column("last_primitive_return", "gather", "steps" if name in names else "methods", name))

    names = [RENAMED.get(name, name) for name in STEPS["ant"]]
    with_other_goals = {RENAMED.get(name, name) for name in WITH_OTHER_GOALS}
    returns = [returns_of(name) for name in ("published", *names) if name not in with_other_goals]
    scores = [np.mean(column("best_score", "gather", variant="published")), *step_scores("ant")]
    rows = {
        name: comparison("ant-gather", ("steps", before), ("steps", name), "fig3")
        for before, name in itertools.pairwise(names)
    }
    first = min(float(rows[name]["p_holm"]) for name in ("symmetry", "branches", "gait"))
    last = comparison("ant-gather", ("methods", "pieces"), ("steps", "patrol"), "fig3")
    goals, patrol = (
        f"{score:.2f} ({p_value(rows[name]['p_holm'])}; U {p_value(rows[name]['mann_whitney_p'])})"
        for name, score in (("goals", scores[5]), ("patrol", scores[6]))
    )
    return (
        f"the last primitives return {listed(returns, '{:.0f}')}",
        f"the scores are {listed(scores[:5], '{:.2f}')}.",
        f"none of the next three differs from the one before (p at least {first:.2f})",
        f"With goals of 1 s at full distance the score is {goals}",
        f"with the controller's view turned to the nearest food {patrol}",
        f"With all changes it is {scores[-1]:.2f} ({p_value(last['p_holm'])})",
    )


BODIES = {"point": "point-(gather|maze|push)", "ant": "ant-(gather|maze|push)"}


def ratios_of_workers(of):
    """Return the comparisons of two workers with one, of the tasks whose name matches."""
    rows = [row for row in rows_of(RESULTS / "fig4.csv") if re.fullmatch(of, row["env"])]
    return [
        row
        for row in rows
        if row["variant"].endswith("-2") and row["against"] == f"{row['variant'].removesuffix('-2')}-1"
    ]


def more_workers():
    rows = [row for row in rows_of(RESULTS / "runs.csv") if row["group"] == "workers"]
    times = {"seconds", "variant", "workers", "commit", "hardware", "settings"}
    pairs = {}
    for row in rows:
        form, _, workers = row["variant"].partition("-")
        pairs.setdefault((form, row["env"], row["seed"]), {})[workers] = row
    curves = {}
    for row in rows_of(RESULTS / "curves.csv"):
        if row["group"] == "workers":
            form, _, workers = row["variant"].partition("-")
            place = curves.setdefault((form, row["env"], row["seed"]), {})
            place.setdefault(workers, []).append({name: row[name] for name in row.keys() - times})
    assert curves.keys() == pairs.keys()
    assert all(of["1"] == of["2"] for of in curves.values())
    for one, two in (pair.values() for pair in pairs.values()):
        assert {name: one[name] for name in one.keys() - times} == {name: two[name] for name in two.keys() - times}
    assert {row["hardware"] for row in rows} == {"AMD EPYC, 2 cores"}
    said = [f"steps of the {len(pairs)} pairs of runs are the same"]
    for body, pattern in BODIES.items():
        found = ratios_of_workers(pattern)
        means = [float(row["ratio"]) for row in found]
        ends = min(float(row["ratio_low"]) for row in found), max(float(row["ratio_high"]) for row in found)
        assert len(found) == 6
        said.append(f"with the {body} {spread(means, '{:.2f}')} ({spread(ends, '{:.2f}')} by seed)")
    gather = equal("point-gather", ("workers", "pieces-1"), ("workers", "pieces-2"), "hours", "fig4")
    found = stored_summaries(study := STUDIES["fig4"]("laptop", None), RESULTS)
    one, two = (
        [found[cell.name] for cell in study.cells if (cell.env, cell.variant) == ("point-gather", f"pieces-{workers}")]
        for workers in (1, 2)
    )
    made = compare_curves(one, two, "seconds")
    assert all(second > first for first, second in zip(made.first, made.second, strict=True))
    ahead = len(made.second)
    assert ahead == 10
    said.append(f"In Point Gather, {gather[0]}, two workers are ahead in each of the ten seeds")
    said.append(f"gives {gather[1]} (a sign test of the ten pairs p = {2 * 0.5**ahead:.3f})")
    for env in ("point-push", "ant-gather"):
        said.append("{} ({})".format(*equal(env, ("workers", "pieces-1"), ("workers", "pieces-2"), "hours", "fig4")))
    others = [row for row in ratios_of_workers(".*") if float(row["hours_p_holm"]) < 0.05]
    assert [(row["env"], row["variant"]) for row in others] == [("point-push", "pieces-2"), ("ant-gather", "pieces-2")]
    return said


def speed_ups():
    found = {}
    for row in rows_of(RESULTS / "curves.csv"):
        if row["group"] == "speedup":
            found[row["variant"], row["kind"], row["cores"]] = row
    forms = ("published", "pieces", "es")

    def of(kind, cores, sign="{:.0f}", column="speedup"):
        return listed([float(found[form, kind, cores][column]) for form in forms], sign)

    def parts(form):
        row = found[form, "projected", "600"]
        start, update, play, whole = (float(row[f"{name}_s"]) for name in ("start", "update", "episodes", "generation"))
        return start, update, whole - start - update - play, play

    errors = {
        cores: [
            float(found[form, "asleep", cores]["generation_s"])
            / float(found[form, "projected asleep", cores]["generation_s"])
            for form in forms
        ]
        for cores in ("200", "600")
    }
    slower = {cores: [100 * (error - 1) for error in errors[cores]] for cores in errors}
    here = [
        100
        * (
            float(found[form, "projected here", cores]["generation_s"])
            / float(found[form, "measured", cores]["generation_s"])
            - 1
        )
        for form in forms
        for cores in ("1", "2")
    ]
    plan = {cell.variant: cell_steps(cell, 0)[0] for cell in STUDIES["fig6"]("laptop", None).cells}
    speeds = [plan[form] / float(found[form, "measured", "1"]["generation_s"]) for form in ("published", "pieces")]
    on_600 = [600 / float(found[form, "projected", "600"]["speedup"]) for form in ("published", "pieces")]
    return (
        "That one made {:,} as published and {:,} with the".format(*(round(speed, -2) for speed in map(int, speeds))),
        "cost {:.1f} times as many core-hours as published, and {:.1f} times with the".format(*on_600),
        f"two workers are {of('measured', '2', '{:.2f}')} times as fast as one",
        *(f"{of('projected', cores)} on {cores}" for cores in ("48", "240", "600")),
        f"a generation takes {of('measured', '1', '{:.0f}', 'generation_s')} s on one core",
        f"With 200 sleeping workers a generation takes {spread(slower['200'])} % longer than projected",
        f"with 600 it takes {spread(slower['600'])} % longer",
        "workers wait {} s for their first tasks, {} s for the update and {} s for the slowest worker of a stage, and "
        "play for {} s; as published these are {}, {}, {} and {} s.".format(
            *(f"{seconds:.2f}" for form in ("pieces", "published") for seconds in parts(form))
        ),
        f"The projection is {-min(here):.0f} % too fast to {max(here):.0f} % too slow",
    )


CLAIMS = {
    "speed-ups": speed_ups,
    "more workers": more_workers,
    "evaluations": evaluations,
    "point as published": point_as_published,
    "point with the changes": point_with_changes,
    "point, transfer": point_transfer,
    "Gather, steps of both": lambda: f"of the primitive it is {spread(first_of_both(2), '{:.1f}')}, so",
    "as published in Gather": lambda: f"scores more than {most_as_published('gather'):.2f},",
    "walkers as published": lambda: f"return {spread(column('best_score', 'flagrun', 'transfer', 'published'))} on",
    "walkers": lambda: f"they return {spread(column('best_score', 'flagrun', 'transfer'))},",
    "Gather": lambda: f"SHES scores {listed(column('best_score', 'gather'), '{:.1f}')} in Gather",
    "Maze": lambda: f"the target of Maze in {per_cent('maze')}",
    "Push": lambda: f"that of Push in {per_cent('push')} of the episodes",
    "Gather, transfer": lambda: f"scores {listed(column('best_score', 'gather', 'transfer'), '{:.1f}')}, its training",
    "Gather, equal steps": lambda: "it has a mean test score of {} ({}).".format(
        *equal("ant-gather", ("methods", "pieces"), ("transfer", "pieces"))
    ),
    "Maze, slow seeds": lambda: (
        "have covered only "
        f"{listed(column('metres_behind_mean', 'maze', table='metres_behind')[:2], '{:.0f}')} m of the 48 m"
    ),
    "Gather, a score of 2": lambda: (
        f"after at most {max(first_at(2, 'transfer')):.1f} million steps of their own, from scratch after "
        f"{spread(first_at(2, 'methods'), '{:.1f}')}."
    ),
    "Maze, transfer": lambda: (
        f"have covered {spread(column('metres_behind_mean', 'maze', 'transfer', table='metres_behind'))}"
    ),
    "HIRO, machines": machines_of_hiro,
    "machines": machines,
    "training rewards": training_rewards,
    "HIRO, Point Gather": hiro_in_point_gather,
    "HIRO, Point Push": hiro_in_point_push,
    "HIRO, Point Maze": hiro_in_point_maze,
    "HIRO, ant": hiro_of_the_ant,
    "published scores": lambda: (passes(3.02), passes(3.74)),
    "running best": running_best,
    "steps of the point": steps_of_the_point,
    "steps of the ant": steps_of_the_ant,
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
    assert f"a run would take {spread([48 / 10 * each for each in hours])} hours" in PAGES


def test_the_pages_say_how_many_core_hours_all_experiments_take_at_scale_paper(tables):
    steps = 0
    for name, group in tables._AT_THE_PAPERS_SCALE:
        study = STUDIES[name]("paper", None)
        cells = [cell for cell in study.cells if cell.group == group and cell.variant != "hiro"]
        steps += sum(sum(cell_steps(cell, study.episodes)) for cell in cells)
    assert spread([steps / speed / 3.6e6 for speed in tables.SPEEDS], "{:.0f},000") in PAGES


def test_no_ant_as_published_reaches_a_target():
    assert most_as_published("maze") == most_as_published("push") == 0
