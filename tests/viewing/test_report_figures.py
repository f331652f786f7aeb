"""The figures of a report: curves over three axes, maps of episodes, and the map of a search for a way."""

import json
import shutil

import numpy as np
import pytest

from shes.runs.evaluate import evaluate
from shes.runs.folder import RunFolder
from shes.viewing.curves import column_curve, group_runs, read_run
from shes.viewing.playback import Playback
from shes.viewing.report_figures import MOST_EPISODES, X_AXES, Panel, curve_figure, panels_of, play_maps
from tests.e2e import runs

RETURNS = "Returns and scores"
SCORE, PRIMITIVE = Panel("evaluation", "score_mean"), Panel("progress", "primitive_return_mean")


def read(*paths):
    return [read_run(RunFolder.open(path)) for path in paths]


def traces(panel, *paths, x="generation"):
    """Return what is drawn of the column of a panel over `x`."""
    figure = curve_figure([panel], group_runs(read(*paths)))
    json.dumps(figure, allow_nan=False)
    return [trace for trace in figure["data"] if trace["meta"] == x]


def titles(*paths, section=RETURNS):
    return [panel.title for panel in panels_of(read(*paths), section)]


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
    assert "goals reached, evaluation" in titles("ant-walker")
    assert "policy return, training" in titles(kinds["flat"])
    assert not [title for title in titles(kinds["flat"]) if "primitive" in title]


@pytest.mark.parametrize(
    ("names", "x"),
    [
        *((["first"], x) for x in X_AXES),
        (["first", "second"], "env_steps"),
        (["first", "second", "third"], "generation"),
    ],
)
@pytest.mark.parametrize("panel", [SCORE, PRIMITIVE])
def test_traces_are_the_band_single_runs_and_the_mean(kinds, panel, names, x):
    paths = [kinds[name] for name in names]
    curve = column_curve([run.tables[panel.table] for run in read(*paths)], panel.column, x)
    expected = [*((curve.grid, bound) for bound in curve.band or ()), *curve.singles]
    expected += [] if curve.is_apart else [(curve.grid, curve.mean)]
    found = traces(panel, *paths, x=x)
    for trace, values in zip(found, expected, strict=True):
        np.testing.assert_allclose((trace["x"], trace["y"]), values, rtol=1e-5, atol=1e-5)
        assert trace["visible"] == (x == "env_steps")
    label = "point-gather smoke" + (f" ({len(names)} runs)" if len(names) > 1 else "")
    named = found[0 if curve.is_apart else -1]
    assert [trace.get("name") for trace in found] == [label if trace is named else None for trace in found]


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


def paths_of(figure):
    """Return path, goals and end of each episode of a map."""
    pairs = [np.transpose([trace["x"], trace["y"]]) for trace in figure["data"]]
    return list(zip(pairs[::3], pairs[1::3], pairs[2::3], strict=True))


def test_the_episodes_of_a_map_are_those_that_evaluate_runs(tiny_run):
    (figure,) = play_maps(tiny_run, 3)
    found = evaluate(tiny_run, episodes=3, num_workers=1)
    names = [trace["name"] for trace in figure["data"] if trace.get("showlegend", True)]
    assert names == [f"episode {number}, score {score:g}" for number, score in enumerate(found.scores)]
    playback = Playback(tiny_run, "best")
    for number, (path, _, end) in enumerate(paths_of(figure)):
        poses = [step.pose[:2].copy() for step in playback.play(playback.seed_of(number))]
        np.testing.assert_allclose(path, poses, rtol=1e-5)
        np.testing.assert_array_equal(end, path[-1:])
    playback.task.close()
    assert len(paths_of(play_maps(tiny_run, 10**12)[0])) == MOST_EPISODES


def test_each_goal_appears_once(kinds, tmp_path):
    path = runs.train_tiny(tmp_path / "run", generations=1, controller_interval=6)
    for run, expected in ((path, [4, 4]), (kinds["flat"], [0, 0]), (kinds["flag"], [1, 1])):
        assert [len(goals) for _, goals, _ in paths_of(play_maps(run, 2)[0])] == expected


def test_the_map_of_a_search_shows_cells_and_the_way(tmp_path):
    settings = {"explore": "archive", "primitive_view": "egocentric", "controller_interval": 20}
    folder = RunFolder(runs.train_tiny(tmp_path / "run", "point-push", generations=1, **settings))
    last = folder.checkpoint_path("last")
    with np.load(last) as file:
        arrays = dict(file)
    found = {"archive/positions": [[3.0, 1], [0, 0], [6, 0]], "archive/nodes": [0], "archive/way_nodes": [1, 0, 2]}
    np.savez(last, **arrays | found)
    shutil.copy(folder.checkpoint_path("0"), folder.checkpoint_path("best"))
    paths, search = play_maps(folder.path, 2)  # with what was found by the end of the run
    json.dumps([paths, search], allow_nan=False)
    for layout in (paths["layout"], search["layout"]):
        block, *_ = (shape for shape in layout["shapes"] if shape["fillcolor"] == "#d2a873")
        assert block["path"] == "M-4.000,4.000L4.000,4.000L4.000,12.000L-4.000,12.000Z"
        assert (layout["xaxis"]["range"], layout["yaxis"]["scaleanchor"]) == ([-13, 13], "x")
    squares, way = search["data"]
    assert (squares["x"], squares["y"][:4]) == ([2.55, 3.45, 3.45, 2.55, None], [0.55, 0.55, 1.45, 1.45])
    assert (way["x"], way["y"], way["name"]) == ([0, 3, 6], [0, 1, 0], "way found, 3 points")
