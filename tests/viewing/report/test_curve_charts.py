"""The figures of a report's curves and of its times."""

import json
import shutil

import numpy as np
import pytest
from scipy import stats

from shes.runs.tables import read_csv
from shes.viewing.report import page_sections
from shes.viewing.report.curve_charts import (
    SECTIONS,
    X_AXES,
    Panel,
    constants,
    curve_figure,
    mean_traces,
    numbers,
    panels_of,
)
from shes.viewing.report.reading import read_runs
from shes.viewing.report.timing import time_figures, wall_parts, worker_parts

SCORE = Panel(section=0, table="evaluation", column="score_mean")
PRIMITIVE = Panel(section=0, table="progress", column="primitive_return_mean")


def titles(runs, section):
    return [panel.title for panel in panels_of(runs) if SECTIONS[panel.section] == section]


def test_the_panels_of_a_run_of_two_levels():
    read = read_runs(["ant-maze"])
    assert titles(read.runs, "Returns and scores")[:5] == [
        "score, evaluation",
        "return, evaluation",
        "success rate, evaluation",
        "controller return, training",
        "primitive return, training",
    ]
    assert titles(read.runs, "Goals") == ["primitive return, evaluation", "goals reached, evaluation"]
    diagnostics = titles(read.runs, "Diagnostics")
    assert {"controller gradient norm", "controller halves cosine", "cells"} <= set(diagnostics)
    assert titles(read.runs, "Speed") == ["steps per second"]


def test_what_does_not_change_has_no_panel_and_is_named(kinds):
    read = read_runs([kinds["first"], kinds["other"]])
    assert "sigma" not in titles(read.runs, "Diagnostics")
    assert constants(read.runs)["sigma"] == ["0.07", "0.5"]
    names = {panel.column.replace("_", " ") for panel in panels_of(read.runs)}
    assert not names & constants(read.runs).keys()


def test_a_flat_run_has_one_level(kinds):
    read = read_runs([kinds["flat"]])
    assert "policy return, training" in titles(read.runs, "Returns and scores")
    assert not [panel for panel in panels_of(read.runs) if "primitive" in panel.column]


@pytest.mark.parametrize("x", X_AXES)
def test_a_curve_of_one_run_is_its_column_with_two_standard_errors(kinds, x):
    read = read_runs([kinds["first"]])
    low, high, mean = curve_figure(SCORE, read.groups, x)["data"]
    table = read_csv(kinds["first"] / "evaluation.csv")
    np.testing.assert_allclose(mean["y"], table["score_mean"], rtol=1e-5)
    np.testing.assert_allclose(mean["x"], np.array(table[x]) * X_AXES[x][1], rtol=1e-5)
    error = 2 * np.array(table["score_std"]) / np.sqrt(3)
    np.testing.assert_allclose(low["y"], table["score_mean"] - error, atol=1e-5)
    np.testing.assert_allclose(high["y"], table["score_mean"] + error, atol=1e-5)
    assert len(curve_figure(PRIMITIVE, read.groups, x)["data"]) == 1


def test_a_curve_of_two_repetitions_is_their_mean_beside_both(kinds):
    read = read_runs([kinds["first"], kinds["second"]])
    both, mean = curve_figure(PRIMITIVE, read.groups, "generation")["data"]
    first, second = (read_csv(kinds[name] / "progress.csv")["primitive_return_mean"] for name in ("first", "second"))
    assert mean["x"] == [1, 2, 3]
    np.testing.assert_allclose(mean["y"], np.mean([first[:3], second[:3]], axis=0), rtol=1e-5)
    gap = len(first)
    assert (both["x"][gap], both["y"][gap], both["x"][-1], both["y"][-1]) == (None,) * 4
    np.testing.assert_allclose([*both["y"][:gap], *both["y"][gap + 1 : -1]], [*first, *second], rtol=1e-5)
    assert "name" not in both
    assert both["line"]["width"] < mean["line"]["width"]


def test_a_curve_of_more_repetitions_is_their_mean_with_an_interval_where_all_have_values():
    xs = [np.linspace(0, end, 6) for end in (10, 10, 15)]
    low, high, mean = mean_traces("a < b", ("--curve-1", "dash"), xs, [x + number for number, x in enumerate(xs)])
    assert mean["x"] == low["x"] == high["x"] == numbers(np.unique(np.concatenate([*xs[:1], xs[2][xs[2] <= 10]])))
    np.testing.assert_allclose(mean["y"], np.array(mean["x"]) + 1)
    np.testing.assert_allclose(np.array(high["y"]) - mean["y"], stats.t.ppf(0.975, 2) / np.sqrt(3), rtol=1e-4)
    np.testing.assert_allclose(np.array(mean["y"]) - low["y"], stats.t.ppf(0.975, 2) / np.sqrt(3), rtol=1e-4)
    assert (mean["name"], mean["line"]) == ("a &lt; b", {"color": "--curve-1", "dash": "dash", "width": 2})


def test_repetitions_that_hardly_overlap_are_one_trace_with_gaps():
    xs = [np.arange(3.0) + start for start in (0, 0, 100)]
    (trace,) = mean_traces("a < b", ("--curve-1", "solid"), xs, [np.full(3, each) for each in (1.0, 2.0, 3.0)])
    assert trace["name"] == "a &lt; b, apart"
    assert trace["x"] == [0, 1, 2, None, 0, 1, 2, None, 100, 101, 102, None]
    assert trace["y"] == [1, 1, 1, None, 2, 2, 2, None, 3, 3, 3, None]


def test_runs_without_a_column_have_no_curve(kinds):
    read = read_runs([kinds["flat"], kinds["first"]])
    (trace,) = curve_figure(PRIMITIVE, read.groups, "env_steps")["data"]
    assert trace["meta"] == read.groups[1].label


def test_a_value_that_is_not_finite_is_a_gap(run_copy):
    path = run_copy / "progress.csv"
    header, first, *rest = path.read_text().splitlines()
    place = header.split(",").index("primitive_return_mean")
    cells = first.split(",")
    cells[place] = "nan"
    path.write_text("\n".join([header, ",".join(cells), *rest]) + "\n")
    figure = curve_figure(PRIMITIVE, read_runs([run_copy]).groups, "generation")
    assert figure["data"][0]["y"][0] is None
    json.dumps(figure, allow_nan=False)
    assert numbers(np.array([np.inf, 1 / 3, -np.nan])) == [None, 0.333333, None]


def test_a_long_curve_is_thinned(run_copy):
    path = run_copy / "progress.csv"
    header, row, *_ = path.read_text().splitlines()
    rest = row.partition(",")[2]
    path.write_text("\n".join([header, *(f"{number},{rest}" for number in range(1, 3502))]) + "\n")
    figure = curve_figure(PRIMITIVE, read_runs([run_copy]).groups, "generation")
    assert figure["data"][0]["x"] == list(range(1, 3502, 4))


def test_texts_of_files_are_escaped(kinds, tmp_path):
    path = shutil.copytree(kinds["first"], tmp_path / "<b>bold")
    table = path / "progress.csv"
    table.write_text(table.read_text().replace("sigma", "<img src=x>", 1))
    read = read_runs([path, kinds["first"]])
    figure = curve_figure(SCORE, read.groups, "generation")
    assert "<b>" in read.groups[0].label
    assert "&lt;b&gt;" in figure["data"][-4]["name"]
    strange = Panel(section=2, table="progress", column="<img src=x>")
    assert curve_figure(strange, read.groups, "generation")["layout"]["title"]["text"] == "&lt;img src=x&gt;"


def test_the_parts_of_the_time_are_those_of_the_table():
    table = {
        "wall_time_s": np.array([5.0, 10.0]),
        "env_steps_per_s": np.array([7.0, 7.0]),
        "rollout_s": np.array([3.0, 4.0]),
        "update_s": np.array([1.0, np.nan]),
        "physics_s": np.array([4.0, 8.0]),
        "policy_s": np.array([1.0, 2.0]),
    }
    assert wall_parts(table) == {"rollout": 7, "update": 1, "rest": 2}
    assert worker_parts(table) == {"physics": 12, "policy": 3}
    assert wall_parts({}) == worker_parts({}) == {}


def test_the_shares_of_a_group_make_up_its_bar(kinds):
    read = read_runs([kinds["first"], kinds["second"], kinds["flat"]])
    for figure in time_figures(read.groups):
        np.testing.assert_allclose(np.sum([trace["x"] for trace in figure["data"]], axis=0), 1, atol=1e-3)
        assert len(figure["layout"]["yaxis"]["ticktext"]) == 2
    assert time_figures([]) == []


def test_each_environment_has_panels_of_its_own_and_comes_into_the_pictures(monkeypatch):
    sections = page_sections.Sections(read_runs(["ant-gather", "ant-gather-coevolved", "ant-maze"]), lambda: None)
    sections.curves()
    labels = {group.runs[0].name: group.label for group in sections.read.groups}
    for env, runs in {"ant-gather": ["ant-gather", "ant-gather-coevolved"], "ant-maze": ["ant-maze"]}.items():
        for x in X_AXES:
            figure = sections.figures[f"{env} evaluation score_mean"][x]
            assert figure["layout"]["title"]["text"] == f"{env}: score, evaluation"
            assert {trace["meta"] for trace in figure["data"]} == {labels[run] for run in runs}
    shown = []
    monkeypatch.setattr(page_sections, "_MOST_SHOWN", 2)
    monkeypatch.setattr(page_sections, "play_episodes", lambda path, *_: shown.append(path.name))
    sections.pictures(1, None, has_videos=False)
    assert shown == ["ant-gather", "ant-maze"]
