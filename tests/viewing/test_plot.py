"""Learning curves of single runs and of repetitions, and the groups of runs."""

import itertools
import shutil

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

from shes.errors import RunFolderError
from shes.runs.folder import RunFolder
from shes.viewing.curves import X_AXES, column_curve, group_runs, read_run, read_runs
from shes.viewing.plot import plot
from tests.e2e import runs
from tests.messages import raises

RUNS = "band: 95 % t interval of the mean over runs, which may leave the panel"
PAIR = "thin lines: each of two runs, too few for a band"
APART = "thin lines without a mean: runs apart, which hardly overlap"
EPISODES = "band: mean ± 2 standard errors over the episodes of an evaluation"
PANELS = {
    "evaluation score": ("evaluation", "score_mean"),
    **{f"{level} return (training)": ("progress", f"{level}_return_mean") for level in ("controller", "primitive")},
}


@pytest.fixture
def drawn(monkeypatch):
    """The figures that were drawn, still open, and not saved, which takes longest."""
    figures, close = [], plt.close
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: None)
    monkeypatch.setattr(plt, "close", figures.append)
    yield figures
    for figure in figures:
        close(figure)


def legend(figure):
    """Return the texts of the figure's legend."""
    (found,) = figure.legends
    return [text.get_text().replace("\n", " ") for text in found.get_texts()]


@pytest.mark.parametrize(("name", "start"), [("a.png", b"\x89PNG"), ("a.SVG", b"<?xml")])
def test_the_suffix_says_the_format(kinds, tmp_path, name, start):
    assert plot(kinds["first"], tmp_path / name).read_bytes().startswith(start)
    assert plt.get_fignums() == []


@pytest.mark.parametrize(
    ("names", "x", "words"),
    [
        *((["first"], x, ["", EPISODES]) for x in X_AXES),
        (["first", "second"], "env_steps", [" (2 runs)", PAIR]),
        (["first", "second", "third"], "generation", [" (3 runs)", RUNS, APART]),  # one has other evaluations
    ],
)
def test_lines_are_the_single_runs_and_the_mean(kinds, tmp_path, drawn, names, x, words):
    plot([kinds[name] for name in names], tmp_path / "a.png", x=x)
    assert legend(drawn[0]) == ["point-gather smoke" + words[0], *words[1:]]
    assert [axis.get_title() for axis in drawn[0].axes] == list(PANELS)
    read = [read_run(RunFolder(kinds[name])) for name in names]
    for axis, (table, column) in zip(drawn[0].axes, PANELS.values(), strict=True):
        curve = column_curve([run.tables[table] for run in read], column, x)
        lines = [*curve.singles, *([] if curve.is_apart else [(curve.grid, curve.mean)])]
        for line, expected in zip(axis.lines, lines, strict=True):
            np.testing.assert_array_equal(line.get_data(), expected)
        assert axis.get_xlabel() == X_AXES[x][0]
        assert len(axis.collections) == (curve.band is not None)
        for band in axis.collections:
            (low, high), (bottom, top) = curve.band, axis.get_ylim()
            edge = band.get_paths()[0].vertices[:, 1]
            assert (edge.min(), edge.max()) == pytest.approx((low.min(), high.max()))
            is_shown = len(names) == 1  # the interval of few runs may leave the panel
            assert (bottom < low.min(), high.max() < top) == (is_shown, is_shown)
            assert bottom < curve.values.min() < curve.values.max() < top


def labels(*paths):
    return [group.label for group in group_runs(read_runs(paths, "plot")[0])]


def test_labels_say_what_differs_between_groups(kinds, tmp_path):
    first = kinds["first"]
    others = [runs.train_tiny(tmp_path / str(width), sigma=0.5, hidden=(width, 4), num_workers=1) for width in (8, 16)]
    assert labels(first, *others) == ["sigma 0.07, hidden 4", "sigma 0.5, hidden 8x4", "sigma 0.5, hidden 16x4"]
    assert labels(first.parent, kinds["other"], first) == ["sigma 0.07 (3 runs)", "sigma 0.5"]  # each counts once


def test_no_label_leaves_the_picture_or_meets_another(kinds, tmp_path, drawn):
    deep = tmp_path / "_a$b$" / "/".join(["a rather long name of a folder"] * 7)
    copies = [shutil.copytree(kinds["first"], deep / str(number)) for number in range(13)]
    plot(copies, tmp_path / "a.png")
    figure = drawn[0]
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    (box,) = (each.get_window_extent(renderer) for each in figure.legends)
    assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
    assert figure.bbox.y0 <= box.y0 < box.y1 <= min(axis.get_tightbbox(renderer).y0 for axis in figure.axes)
    assert min(axis.get_window_extent(renderer).height for axis in figure.axes) > 200  # the panels keep their height
    assert len({(line.get_color(), line.get_linestyle()) for line in figure.axes[0].lines}) == 13
    for axis in figure.axes:
        ticks = [label.get_window_extent(renderer) for label in axis.get_xticklabels() if label.get_text()]
        assert all(left.x1 < right.x0 for left, right in itertools.pairwise(ticks))


def test_runs_of_other_levels_share_a_picture(kinds, tmp_path, drawn):
    plot([kinds[name] for name in ("flat", "first", "flag")], tmp_path / "a.png")
    counts = {axis.get_title(): len(axis.lines) for axis in drawn[0].axes}
    levels = {"policy": 1, "controller": 1, "primitive": 2}
    assert counts == {"evaluation score": 3, **{f"{name} return (training)": count for name, count in levels.items()}}
    score, *others = drawn[0].axes
    colors = {line.get_label(): line.get_color() for line in score.lines}
    assert len(set(colors.values())) == 3
    assert all(line.get_color() == colors[line.get_label()] for axis in others for line in axis.lines)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("progress.csv", "", "cannot be drawn. progress.csv has no row ... Train it first"),
        ("evaluation.csv", None, "cannot be drawn. evaluation.csv is missing"),
        ("evaluation.csv", "generation,score_mean\n1,2\n", "evaluation.csv has no column 'env_steps'"),
        ("evaluation.csv", "generation,env_steps\n1,x\n", "cannot be read as a table of numbers"),
        ("config.json", "{", "config.json cannot be read"),
    ],
)
def test_a_run_that_cannot_be_drawn_says_why(run_copy, tmp_path, name, content, message):
    (run_copy / name).unlink() if content is None else (run_copy / name).write_text(content)
    with raises(RunFolderError, message):
        plot(run_copy, tmp_path / "a.png")


def test_a_damaged_run_is_not_left_out_but_a_young_one_is(kinds, run_copy, tmp_path, drawn):
    (run_copy / "evaluation.csv").write_text("")
    plot([kinds["second"], run_copy], tmp_path / "a.png")
    assert legend(drawn[0])[0] == "point-gather smoke"
    (run_copy / "evaluation.csv").write_text("generation\nx\n")
    with pytest.raises(RunFolderError):
        plot([kinds["second"], run_copy], tmp_path / "a.png")
