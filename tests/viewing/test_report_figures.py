"""The figures of a report: curves over three axes, maps of episodes, and the map of a search for a way."""

import json
import shutil

import numpy as np
import pytest

from shes.algorithms.contract import Explored
from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from shes.viewing.groups import group_runs, read_run
from shes.viewing.playback import Playback
from shes.viewing.report_figures import (
    MOST_EPISODES,
    X_AXES,
    Panel,
    curve_figure,
    map_figure,
    panels_of,
    play_episodes,
    search_figure,
)
from tests.e2e import runs

RETURNS = "Returns and scores"
SCORE, PRIMITIVE = Panel(RETURNS, "evaluation", "score_mean"), Panel(RETURNS, "progress", "primitive_return_mean")


def read(*paths):
    return [read_run(RunFolder.open(path)) for path in paths]


def traces(panel, *paths, x="generation"):
    """Return what is drawn of the column of a panel over `x`."""
    figure = curve_figure([panel], group_runs(read(*paths)))
    json.dumps(figure, allow_nan=False)
    return [trace for trace in figure["data"] if trace["meta"] == x]


def titles(*paths, section=RETURNS):
    return [panel.title for panel in panels_of(read(*paths)) if panel.section == section]


def test_every_column_that_changes_has_a_panel(kinds):
    assert titles("ant-maze")[:6] == [
        "score, evaluation",
        "return, evaluation",
        "primitive return, evaluation",
        "success rate, evaluation",
        "controller return, training",
        "primitive return, training",
    ]
    diagnostics = titles("ant-maze", section="Diagnostics")
    assert {"controller gradient norm", "controller halves cosine", "cells", "env steps per s"} <= set(diagnostics)
    assert not {"sigma", "wall time s", "rollout s", "episodes, evaluation"} & set(diagnostics)
    assert "policy return, training" in titles(kinds["flat"])
    assert not [title for title in titles(kinds["flat"]) if "primitive" in title]


@pytest.mark.parametrize("x", X_AXES)
def test_a_curve_of_one_run_has_two_standard_errors(kinds, x):
    low, high, mean = traces(SCORE, kinds["first"], x=x)
    table = read_csv(kinds["first"] / "evaluation.csv")
    np.testing.assert_allclose(mean["y"], table["score_mean"], rtol=1e-5)
    np.testing.assert_allclose(mean["x"], np.array(table[x]) * X_AXES[x][1], rtol=1e-5)
    error = 2 * np.array(table["score_std"]) / np.sqrt(3)
    np.testing.assert_allclose((low["y"], high["y"]), (mean["y"] - error, mean["y"] + error), atol=1e-5)
    assert mean["visible"] == (x == "env_steps")


def test_repetitions_are_a_mean_with_lines_or_a_band(kinds):
    first, second, third = kinds["first"], kinds["second"], kinds["third"]
    one, two, mean = traces(PRIMITIVE, first, second)
    columns = [read_csv(path / "progress.csv")["primitive_return_mean"] for path in (first, second)]
    assert mean["x"] == [1, 2, 3]
    np.testing.assert_allclose(mean["y"], np.mean([column[:3] for column in columns], axis=0), rtol=1e-5)
    np.testing.assert_allclose(one["y"], columns[0], rtol=1e-5)
    assert ("name" in one, "name" in two) == (False, False)
    low, high, mean = traces(PRIMITIVE, first, second, third)
    assert (np.array(low["y"]) < mean["y"]).all()
    assert (np.array(high["y"]) > mean["y"]).all()
    assert mean["name"] == "point-gather smoke (3 runs)"


def test_a_group_has_one_entry_in_the_legend(kinds):
    groups = group_runs(read(kinds["flat"], kinds["first"]))
    figure = curve_figure([PRIMITIVE, SCORE, SCORE], groups)
    for x in X_AXES:
        named = [trace["name"] for trace in figure["data"] if trace["meta"] == x and trace["showlegend"]]
        assert sorted(named) == sorted(group.label for group in groups)
    assert len({trace["line"]["color"] for trace in figure["data"]}) == 2


def test_a_button_shows_the_curves_over_its_axis(kinds):
    figure = curve_figure([PRIMITIVE, SCORE], group_runs(read(kinds["first"])))
    (menu,) = figure["layout"]["updatemenus"]
    for button, (x, (label, _)) in zip(menu["buttons"], X_AXES.items(), strict=True):
        shown, texts = button["args"]
        assert shown["visible"] == [trace["meta"] == x for trace in figure["data"]]
        assert texts == {"xaxis.title.text": label, "xaxis2.title.text": label}


def test_a_nan_is_a_gap_and_a_long_curve_is_thinned(run_copy):
    header, row, *_ = (run_copy / "progress.csv").read_text().splitlines()
    place, cells = header.split(",").index("primitive_return_mean"), row.split(",")
    cells[place] = "nan"
    rows = [f"{number},{','.join((cells if number == 1 else row.split(','))[1:])}" for number in range(1, 3502)]
    (run_copy / "progress.csv").write_text("\n".join([header, *rows]) + "\n")
    (trace,) = traces(PRIMITIVE, run_copy)
    assert trace["x"] == list(range(1, 3502, 4))
    assert trace["y"][0] is None
    assert trace["y"][1] is not None


def test_the_episodes_of_a_map_are_those_that_evaluate_runs(tiny_run):
    world = play_episodes(tiny_run, 3)
    found = evaluate(tiny_run, episodes=3, num_workers=1)
    assert [each.score for each in world.episodes] == found.scores.tolist()
    playback = Playback(tiny_run, "best")
    for number, episode in enumerate(world.episodes):
        poses = [step.pose[:2].copy() for step in playback.play(playback.seed_of(number))]
        np.testing.assert_allclose(episode.path, poses, atol=1e-9)
    playback.task.close()
    assert len(play_episodes(tiny_run, 10**12).episodes) == MOST_EPISODES


def test_each_goal_appears_once(kinds, tmp_path):
    path = runs.train_tiny(tmp_path / "run", generations=1, controller_interval=6)
    assert [episode.goals.shape for episode in play_episodes(path, 2).episodes] == [(4, 2)] * 2
    assert [episode.goals.shape for episode in play_episodes(kinds["flat"], 2).episodes] == [(0, 2)] * 2
    assert all(len(episode.goals) >= 1 for episode in play_episodes(kinds["flag"], 2).episodes)


def test_a_map_is_drawn_to_scale_and_names_each_episode(tmp_path):
    world = play_episodes(runs.train_tiny(tmp_path / "run", "point-push", generations=1), 2)
    figure = map_figure(world)
    layout, (block, *_) = figure["layout"], [s for s in figure["layout"]["shapes"] if s["fillcolor"] == "#d2a873"]
    assert block["path"] == "M-4.000,4.000L4.000,4.000L4.000,12.000L-4.000,12.000Z"
    assert (layout["xaxis"]["range"], layout["yaxis"]["scaleanchor"]) == ([-13, 13], "x")
    names = [f"episode {number}, score {each.score:g}" for number, each in enumerate(world.episodes)]
    assert [trace["name"] for trace in figure["data"] if trace.get("showlegend", True)] == names
    json.dumps(figure, allow_nan=False)
    assert world.explored is None


def test_the_map_of_a_search_shows_cells_and_the_way(tmp_path):
    settings = {"explore": "archive", "primitive_view": "egocentric", "controller_interval": 25}
    folder = RunFolder(runs.train_tiny(tmp_path / "run", "point-push", generations=1, **settings))
    shutil.copy(folder.checkpoint_path("0"), folder.checkpoint_path("best"))
    world = play_episodes(folder.path, 2)  # with what was found by the end of the run
    assert [0, 0] in world.explored.places.tolist()
    json.dumps(search_figure(world, world.explored), allow_nan=False)
    found = Explored(places=np.array([[0.0, 0], [3, 1]]), way=np.array([[0.0, 0], [3, 1], [6, 0]]))
    squares, way = search_figure(world, found)["data"]
    assert squares["x"] == [-0.45, 0.45, 0.45, -0.45, None, 2.55, 3.45, 3.45, 2.55, None]
    assert squares["y"][5:9] == [0.55, 0.55, 1.45, 1.45]
    assert (way["x"], way["y"], way["name"]) == ([0, 3, 6], [0, 1, 0], "way found, 3 points")
