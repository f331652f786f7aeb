"""Figures from results: what they show. What is measured once for figure 6 is not measured again."""

import csv
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from experiments.comparisons import compare
from experiments.curve_figure import Curve, Panel, draw_curves
from experiments.design import Measure
from experiments.figure6 import LABELS, PAPER_SECONDS, draw, measure, measured_runs, read_rows, slowdown, speedup_figure
from experiments.figures import COLORS, color_of, forest
from experiments.results import PlacedResults, RunResults
from tests.experiments.tiny import experiment, run

SCORE = Measure("score_mean", "test score")


@pytest.fixture(autouse=True)
def closed():
    """Close what a test has drawn."""
    yield
    plt.close("all")


def results_of(made, only=lambda _: True):
    """Return results of the runs of an experiment, whose scores rise and fall, with their comparisons."""
    found = {}
    for each in filter(only, made.runs):
        before = (None, None) if each.primitive is None else (5e5, 30.0)
        common = dict(zip(("primitive_env_steps", "primitive_seconds"), before, strict=True))
        scores = ("score_mean", "training_return_mean", "primitive_return_mean")
        curve = [
            {**common, "env_steps": 1e6 * step, "seconds": 60.0 * step, **dict.fromkeys(scores, each.seed + score)}
            for step, score in enumerate((0, 2, 1, 3, 2))
        ]
        row = {**each.identity, "best_score": each.seed + len(each.variant), "env_steps": 9, "seconds": 9.0}
        found[each.name] = RunResults(row=row, curve=curve)
    return PlacedResults(made, found, compare(PlacedResults(made, found)))


def test_a_forest_shows_every_seed_and_the_corrected_p():
    made = experiment(*(run(name, seed) for name in ("base", "other") for seed in (1, 2, 3)))
    results = results_of(made)
    [axis] = forest(results, "choices").axes
    assert [text.get_text() for text in axis.get_yticklabels()] == ["base", "other"]
    points = [sorted(dots.get_offsets()[:, 0]) for dots in axis.collections]
    assert points == [[5, 6, 7], [6, 7, 8]]
    p = next(row["p_holm"] for row in results.comparisons if row["variant"] == "other")
    assert {"against base", f"p = {p:.2f}"} <= {text.get_text() for text in axis.texts}


def test_a_forest_has_what_is_finished_alone():
    made = experiment(*(run(name, env=env) for env in ("point-gather", "point-maze") for name in ("base", "other")))
    assert forest(results_of(made, lambda each: each.variant == "base"), "choices") is None
    figure = forest(results_of(made, lambda each: each.env == "point-maze"), "choices")
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["Point Maze"]


def lines(axis, color, style="-"):
    """Return the lines of a colour and style of an axis."""
    looks = color, style, None  # those of single seeds are transparent
    return [line for line in axis.lines if (line.get_color(), line.get_linestyle(), line.get_alpha()) == looks]


def test_a_curve_is_the_mean_with_its_running_best():
    made = experiment(*(run(name, seed) for name in ("base", "other") for seed in (1, 2, 3)))
    curves = tuple(Curve("choices", name) for name in ("base", "other"))
    panel = Panel("point-gather", "Gather", curves, SCORE, references={"published": 4.5}, has_running_best=True)
    figure = draw_curves(results_of(made), [panel], 3)
    [axis] = figure.axes
    [mean], [best] = (lines(axis, color_of("choices", "base", ("base", "other")), style) for style in ("-", "--"))
    assert np.array(mean.get_data()).tolist() == [[0, 1, 2, 3, 4], [2, 4, 3, 5, 4]]
    assert best.get_ydata().tolist() == [2, 4, 4, 5, 5]
    assert (axis.get_title(), axis.get_xlabel()) == ("Gather (3 seeds)", "million environment steps")
    names = {text.get_text(): text.get_position()[1] for text in axis.texts}
    assert sorted(names, key=names.get) == ["base", "other", "published"]
    assert np.diff(sorted(names.values())).min() > 0.06
    assert [line.get_ydata()[0] for line in axis.lines if line.get_label() == "published"] == [4.5]
    notes = [text.get_text() for text in figure.legends[0].get_texts()]
    assert [note.partition(":")[0] for note in notes] == ["thin lines", "dashed", "grey"]


@pytest.mark.parametrize("x", ["env_steps", "seconds"])
def test_a_transferred_run_begins_after_its_primitive(x):
    source = [run("source", seed, group="transfer", env="point-flagrun") for seed in (1, 2, 3)]
    taken = [run("taker", each.seed, group="transfer", primitive=each) for each in source]
    panel = Panel("point-gather", "Gather", (Curve("transfer", "taker", is_after_primitive=True),), SCORE, x=x)
    [axis] = draw_curves(results_of(experiment(*source, *taken)), [panel], 1).axes
    [mean], [span] = (lines(axis, color_of("transfer", "taker", ("taker",)), style) for style in ("-", ":"))
    assert (mean.get_xdata()[0], mean.get_xdata()[-1]) == (0.5, 4.5)
    assert np.array(span.get_data()).tolist() == [[0, 0.5], [2, 2]]


def test_the_picture_has_every_kind_of_row_and_the_authors_times():
    rows = read_rows(Path(__file__).parents[2] / "results" / "paper" / "fig6.csv")
    [axis] = speedup_figure(rows).axes
    drawn = {(line.get_color(), line.get_linestyle(), line.get_marker()): line for line in axis.lines}
    assert {*LABELS.values(), "perfect"} <= {text.get_text().replace("\n", " ") for text in axis.texts}
    for variant in LABELS:
        own = [float(row["speedup"]) for row in rows if (row["variant"], row["kind"]) == (variant, "projected")]
        assert drawn[COLORS[variant], "-", "None"].get_ydata().tolist() == own
        assert [round(slower, 1) for slower in slowdown(rows, variant)[1]] in ([1, 1, 1.2], [1, 1.1, 1.2])
    slope = dict(zip(*drawn["black", ":", "None"].get_data(), strict=True))
    assert (slope[1], slope[250], slope[600]) == (1, 50, 100)
    assert drawn[COLORS["es"], "None", "x"].get_ydata()[-1] == PAPER_SECONDS["es"][1] / PAPER_SECONDS["es"][240]


@pytest.mark.extras
@pytest.mark.timeout(600)
def test_a_measurement_is_kept_and_not_made_again(tmp_path):
    measure("smoke", tmp_path, 2)
    with (tmp_path / "fig6.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["variant"] for row in rows} == {run.variant for run in measured_runs("smoke")}
    for row in rows:
        assert float(row["speedup"]) > 0
        assert row["hardware"]
        assert row["versions"]
    before = (tmp_path / "fig6.csv").read_bytes()
    measure("smoke", tmp_path, 2)
    assert (tmp_path / "fig6.csv").read_bytes() == before
    assert draw(tmp_path).stat().st_size > 10_000
