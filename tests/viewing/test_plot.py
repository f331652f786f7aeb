"""Learning curves of single runs and of repetitions, and the groups of runs."""

import csv
import itertools
import shutil

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

from shes.errors import ConfigError, RunFolderError, StorageError, UnknownNameError
from shes.runs.tables import read_csv
from shes.viewing.curves import confidence_interval
from shes.viewing.plot import plot
from tests.e2e import runs

RUNS = "band: 95 % t interval of the mean over runs, which may leave the panel"
PAIR = "thin lines: each of two runs, too few for a band"
APART = "thin lines without a mean: runs apart, which hardly overlap"
EPISODES = "band: mean ± 2 standard errors over the episodes of an evaluation"


@pytest.fixture
def drawn(monkeypatch):
    """The figures that were drawn, still open, and not saved, which takes longest."""
    figures, close = [], plt.close
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: None)
    monkeypatch.setattr(plt, "close", figures.append)
    yield figures
    for figure in figures:
        close(figure)


@pytest.fixture
def seeds(kinds):
    return [kinds[name] for name in ("first", "second", "third")]


def table(path, name="progress"):
    return read_csv(path / f"{name}.csv")


def write_table(path, name, columns):
    with (path / f"{name}.csv").open("w", newline="") as file:
        csv.writer(file).writerows([columns, *zip(*columns.values(), strict=True)])


def legend(figure):
    """Return the texts of the figure's legend."""
    (found,) = figure.legends
    return [text.get_text().replace("\n", " ") for text in found.get_texts()]


def panels(figure):
    """Return the title of each panel with the columns y of its curves."""
    return {axis.get_title(): [line.get_ydata().tolist() for line in axis.lines] for axis in figure.axes}


def heights(axis):
    """Return the least and the greatest height of the only band of a panel."""
    (band,) = axis.collections
    return band.get_paths()[0].vertices[:, 1].min(), band.get_paths()[0].vertices[:, 1].max()


@pytest.mark.parametrize(("name", "start"), [("a.png", b"\x89PNG"), ("a.PDF", b"%PDF"), ("a.svg", b"<?xml")])
def test_the_suffix_says_the_format(seeds, tmp_path, name, start):
    assert plot(seeds[:1], tmp_path / name).read_bytes().startswith(start)
    assert plt.get_fignums() == []


@pytest.mark.parametrize(
    ("x", "label", "unit"),
    [
        ("generation", "generation", 1),
        ("env_steps", "environment steps (millions)", 1e6),
        ("wall_time_s", "minutes", 60),
    ],
)
def test_a_run_alone_is_drawn_as_its_tables_say(seeds, tmp_path, drawn, x, label, unit):
    plot(seeds[:1], tmp_path / "a.png", x=x)
    evaluation, progress = table(seeds[0], "evaluation"), table(seeds[0])
    score, controller, primitive = drawn[0].axes
    (line,) = score.lines
    assert (line.get_ydata().tolist(), score.get_xlabel()) == (evaluation["score_mean"], label)
    np.testing.assert_allclose(line.get_xdata() * unit, evaluation[x], rtol=1e-12)
    assert controller.lines[0].get_ydata().tolist() == progress["controller_return_mean"]
    assert primitive.lines[0].get_ydata().tolist() == progress["primitive_return_mean"]
    assert legend(drawn[0]) == ["point-gather smoke", EPISODES]
    error = 2 * np.array(evaluation["score_std"]) / np.sqrt(3)
    assert heights(score)[1] == pytest.approx((evaluation["score_mean"] + error).max())
    assert score.get_ylim()[1] > heights(score)[1]
    assert len(controller.collections) == len(primitive.collections) == 0


def test_repetitions_become_a_mean_with_an_interval(seeds, tmp_path, drawn):
    plot(seeds, tmp_path / "a.png", x="generation")
    controller = drawn[0].axes[1]
    values = np.array([table(path)["controller_return_mean"][:3] for path in seeds])
    np.testing.assert_allclose(controller.lines[0].get_ydata(), values.mean(axis=0))
    assert legend(drawn[0])[:2] == ["point-gather smoke (3 runs)", RUNS]
    low, high = confidence_interval(values)
    assert heights(controller) == (pytest.approx(low.min()), pytest.approx(high.max()))
    limits = controller.get_ylim()
    assert low.min() < limits[0] < values.min() < values.max() < limits[1] < high.max()


def test_the_legend_says_what_differs_between_groups(kinds, seeds, tmp_path, drawn):
    others = [runs.train_tiny(tmp_path / str(width), sigma=0.5, hidden=(width, 4), num_workers=1) for width in (8, 16)]
    plot([seeds[0], *others], tmp_path / "a.png")
    assert legend(drawn[0])[:3] == ["sigma 0.07, hidden 4", "sigma 0.5, hidden 8x4", "sigma 0.5, hidden 16x4"]
    shutil.copytree(seeds[0].parent, tmp_path / "all" / "base")
    shutil.copytree(kinds["other"], tmp_path / "all" / "other" / "seed-1")
    plot([tmp_path / "all", tmp_path / "all"], tmp_path / "a.png")  # counted once
    assert legend(drawn[1])[:3] == ["sigma 0.07 (3 runs)", "sigma 0.5", RUNS]


def test_no_label_leaves_the_picture_or_meets_another(seeds, tmp_path, drawn):
    deep = tmp_path / "_a$b$" / "/".join(["a rather long name of a folder"] * 7)
    copies = [shutil.copytree(seeds[0], deep / str(number)) for number in range(13)]
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
    flat, first, flag = (kinds[name] for name in ("flat", "first", "flag"))
    plot([flat, first, flag], tmp_path / "a.png")
    found = panels(drawn[0])
    assert len(found.pop("evaluation score")) == 3
    assert found == {
        "policy return (training)": [table(flat)["policy_return_mean"]],
        "controller return (training)": [table(first)["controller_return_mean"]],
        "primitive return (training)": [table(path)["primitive_return_mean"] for path in (first, flag)],
    }
    score, *others = drawn[0].axes
    colors = {line.get_label(): line.get_color() for line in score.lines}
    assert len(set(colors.values())) == 3
    assert all(line.get_color() == colors[line.get_label()] for axis in others for line in axis.lines)


def test_runs_that_hardly_overlap_are_drawn_each_by_itself(seeds, tmp_path, drawn):
    """One of them took long for what the others did in a moment."""
    late = shutil.copytree(seeds[0], tmp_path / "late")
    for name in ("progress", "evaluation"):
        write_table(
            late, name, {**table(late, name), "wall_time_s": [s + 1000 for s in table(late, name)["wall_time_s"]]}
        )
    plot([late, *seeds[1:]], tmp_path / "a.png", x="wall_time_s")
    assert legend(drawn[0]) == ["point-gather smoke (3 runs)", APART]
    controller = drawn[0].axes[1]
    assert len(controller.collections) == 0
    for line, path in zip(controller.lines, [late, *seeds[1:]], strict=True):
        assert line.get_ydata().tolist() == table(path)["controller_return_mean"]


@pytest.mark.parametrize(
    ("count", "arguments", "error", "message"),
    [
        (0, {}, ConfigError, "plot needs at least one run folder: shes plot RUN"),
        (1, {"x": "generatio"}, UnknownNameError, r"unknown x 'generatio'\. Did you mean 'generation'\?.*Set --x"),
        (1, {"out": "a.foo"}, ConfigError, r"out must end in \.png, \.pdf or \.svg, got 'a\.foo'\. Set --out"),
        (1, {"out": "none/a.png"}, StorageError, "there is no such folder: create it first"),
    ],
)
def test_a_wrong_argument_is_refused(seeds, tmp_path, monkeypatch, count, arguments, error, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        plot(seeds[:count], **arguments)
    with pytest.raises(RunFolderError, match="is not a run folder"):
        plot(tmp_path)
    assert (plt.get_fignums(), list(tmp_path.iterdir())) == ([], [])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("progress.csv", "", r"cannot be drawn\. progress\.csv has no row.* Train it first"),
        ("evaluation.csv", None, r"cannot be drawn\. evaluation\.csv is missing"),
        ("evaluation.csv", "generation,score_mean\n1,2\n", r"evaluation\.csv has no column 'env_steps'"),
        ("evaluation.csv", "generation,env_steps\n1,x\n", "cannot be read as a table of numbers"),
        ("config.json", "{", r"config\.json cannot be read"),
    ],
)
def test_a_run_that_cannot_be_drawn_says_why(run_copy, tmp_path, name, content, message):
    (run_copy / name).unlink() if content is None else (run_copy / name).write_text(content)
    with pytest.raises(RunFolderError, match=message):
        plot(run_copy, tmp_path / "a.png")


def test_a_damaged_run_is_not_left_out_but_a_young_one_is(seeds, run_copy, tmp_path, drawn):
    (run_copy / "evaluation.csv").write_text("")
    plot([seeds[1], run_copy], tmp_path / "a.png")
    assert legend(drawn[0])[0] == "point-gather smoke"
    (run_copy / "evaluation.csv").write_text("generation\nx\n")
    with pytest.raises(RunFolderError, match="cannot be read as a table of numbers"):
        plot([seeds[1], run_copy], tmp_path / "a.png")
