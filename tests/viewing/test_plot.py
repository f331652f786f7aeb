"""Learning curves of single runs and of repetitions."""

import csv
import itertools
import json
import shutil

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure

from shes.errors import ConfigError, RunFolderError, StorageError, UnknownNameError
from shes.runs.folder import RunFolder
from shes.runs.tables import read_csv
from shes.viewing.curves import confidence_interval
from shes.viewing.plot import plot
from tests.e2e import runs


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    """Three runs that differ only in the seed."""
    folder = tmp_path_factory.mktemp("seeds")
    return [runs.train_tiny(folder / str(seed), seed=seed) for seed in (5, 6, 7)]


@pytest.fixture
def drawn(monkeypatch):
    """The figures that were drawn, still open, and not saved, which takes longest."""
    figures, close = [], plt.close
    monkeypatch.setattr(Figure, "savefig", lambda *_, **__: None)
    monkeypatch.setattr(plt, "close", figures.append)
    yield figures
    for figure in figures:
        close(figure)


def test_a_picture_is_written(seeds, tmp_path):
    path = plot(seeds[:1], tmp_path / "curves.png")
    assert path == tmp_path / "curves.png"
    assert path.read_bytes().startswith(b"\x89PNG")
    assert plt.get_fignums() == []


@pytest.mark.parametrize(("suffix", "start"), [(".PDF", b"%PDF"), (".svg", b"<?xml")])
def test_the_suffix_says_the_format(seeds, tmp_path, suffix, start):
    assert plot(seeds[:1], tmp_path / f"curves{suffix}").read_bytes().startswith(start)


def test_a_run_alone_is_drawn_as_its_tables_say(seeds, tmp_path, drawn):
    plot(seeds[:1], tmp_path / "a.png", x="generation")
    evaluation, progress = read_csv(seeds[0] / "evaluation.csv"), read_csv(seeds[0] / "progress.csv")
    score, controller, primitive = drawn[0].axes
    assert score.lines[0].get_xydata().T.tolist() == [evaluation["generation"], evaluation["score_mean"]]
    assert legend(drawn[0]) == ["point-gather smoke", EPISODES]
    assert controller.lines[0].get_ydata().tolist() == progress["controller_return_mean"]
    assert primitive.lines[0].get_ydata().tolist() == progress["primitive_return_mean"]
    error = 2 * np.array(evaluation["score_std"]) / np.sqrt(3)
    (spread,) = score.collections
    heights = spread.get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx((evaluation["score_mean"] + error).max())
    assert len(controller.collections) == len(primitive.collections) == 0


def test_repetitions_become_a_mean_with_an_interval(seeds, tmp_path, drawn):
    plot(seeds, tmp_path / "a.png")
    controller = drawn[0].axes[1]
    (line,) = controller.lines
    values = np.array([read_csv(path / "progress.csv")["controller_return_mean"] for path in seeds])
    np.testing.assert_allclose(line.get_ydata(), values.mean(axis=0))
    assert legend(drawn[0]) == ["point-gather smoke (3 runs)", RUNS]
    (band,) = controller.collections
    low, high = confidence_interval(values)
    heights = band.get_paths()[0].vertices[:, 1]
    assert (heights.min(), heights.max()) == (pytest.approx(low.min()), pytest.approx(high.max()))
    limits = controller.get_ylim()
    assert low.min() < limits[0] < values.min() < values.max() < limits[1] < high.max()


RUNS = "band: 95 % t interval of the mean over runs, which may leave the panel"
PAIR = "thin lines: each of two runs, too few for a band"
APART = "thin lines without a mean: runs apart, which hardly overlap"
EPISODES = "band: mean ± 2 standard errors over the episodes of an evaluation"


def legend(figure):
    """Return the texts of the figure's legend."""
    (found,) = figure.legends
    return [text.get_text().replace("\n", " ") for text in found.get_texts()]


def test_the_legend_says_what_differs_between_groups(seeds, tmp_path, drawn):
    others = [runs.train_tiny(tmp_path / str(width), sigma=0.5, hidden=(width, 4), num_workers=1) for width in (8, 16)]
    plot([seeds[0], *others], tmp_path / "a.png")
    assert legend(drawn[0])[:3] == ["sigma 0.07, hidden 4", "sigma 0.5, hidden 8x4", "sigma 0.5, hidden 16x4"]


def test_a_folder_of_runs_is_drawn_as_its_groups(seeds, tmp_path, drawn):
    for number, path in enumerate(seeds):
        shutil.copytree(path, tmp_path / "all" / "base" / f"seed-{number}")
    runs.train_tiny(tmp_path / "all" / "other" / "seed-1", sigma=0.5)
    runs.train_tiny(tmp_path / "all" / "begun", sigma=0.6, minutes=1e-9)  # it has nothing to draw
    plot(tmp_path / "all", tmp_path / "a.png")
    assert legend(drawn[0]) == ["sigma 0.07 (3 runs)", "sigma 0.5", RUNS, EPISODES]


def on_another_machine(path, copy, **changed):
    """Copy a run as if it had been made with other workers or on another machine."""
    shutil.copytree(path, copy)
    record = json.loads((copy / "config.json").read_text())
    record["config"]["workers"] |= {name: value for name, value in changed.items() if name == "num_workers"}
    record["machine"] |= {name: value for name, value in changed.items() if name == "processor"}
    (copy / "config.json").write_text(json.dumps(record))
    return copy


@pytest.mark.parametrize(("name", "value"), [("num_workers", 7), ("processor", "Z80")])
def test_a_run_made_again_elsewhere_is_no_repetition(seeds, tmp_path, drawn, name, value):
    again = on_another_machine(seeds[0], tmp_path / "again", **{name: value})
    plot([*seeds, again], tmp_path / "a.png")
    first, second, *_ = legend(drawn[0])
    assert first.endswith("(3 runs)")
    assert second == f"{name.replace('_', ' ')} {value}"
    plot([seeds[0], shutil.copytree(seeds[0], tmp_path / "copy")], tmp_path / "a.png")  # nor is a copy
    assert legend(drawn[1]) == [str(seeds[0]), str(tmp_path / "copy"), EPISODES]


def test_over_time_runs_of_other_machines_are_no_repetitions(seeds, tmp_path, drawn):
    other = on_another_machine(seeds[1], tmp_path / "other", processor="Z80")
    for number, (x, curves) in enumerate([("env_steps", 1), ("generation", 1), ("wall_time_s", 2)]):
        plot([seeds[0], other], tmp_path / "a.png", x=x)
        assert len({line.get_color() for line in drawn[number].axes[0].lines}) == curves


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


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    """A run of flat S-ES."""
    return runs.train_tiny(tmp_path_factory.mktemp("flat") / "run", algorithm="es")


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """A run that trained a primitive alone."""
    return runs.train_tiny(tmp_path_factory.mktemp("alone") / "run", "point-flagrun")


def panels(figure):
    """Return the title of each panel with the columns y of its curves."""
    return {axis.get_title(): [line.get_ydata().tolist() for line in axis.lines] for axis in figure.axes}


@pytest.mark.parametrize(("kind", "level"), [("flat", "policy"), ("alone", "primitive")])
def test_a_run_of_one_level_has_two_panels(request, tmp_path, drawn, kind, level):
    path = request.getfixturevalue(kind)
    plot([path], tmp_path / "a.png")
    assert panels(drawn[0]) == {
        "evaluation score": [read_csv(path / "evaluation.csv")["score_mean"]],
        f"{level} return (training)": [read_csv(path / "progress.csv")[f"{level}_return_mean"]],
    }


def test_runs_of_other_levels_share_a_picture_and_each_is_drawn_where_it_has_something(
    seeds, flat, alone, tmp_path, drawn
):
    plot([flat, seeds[0], alone], tmp_path / "a.png")
    tables = {path: read_csv(path / "progress.csv") for path in (flat, seeds[0], alone)}
    found = panels(drawn[0])
    assert len(found.pop("evaluation score")) == 3
    assert found == {
        "policy return (training)": [tables[flat]["policy_return_mean"]],
        "controller return (training)": [tables[seeds[0]]["controller_return_mean"]],
        "primitive return (training)": [tables[path]["primitive_return_mean"] for path in (seeds[0], alone)],
    }
    assert len(set(legend(drawn[0]))) == 4


def test_a_curve_has_the_same_colour_in_every_panel(seeds, flat, alone, tmp_path, drawn):
    """The legend is only in the first panel and holds for all."""
    plot([flat, seeds[0], alone], tmp_path / "a.png")
    score, _, controller, primitive = drawn[0].axes
    colours = {line.get_label(): line.get_color() for line in score.lines}
    for axis in (controller, primitive):
        for line in axis.lines:
            assert line.get_color() == colours[line.get_label()]


def test_execution_does_not_part_repetitions(seeds, tmp_path, drawn):
    other = runs.train_tiny(tmp_path / "other", seed=9, keep_checkpoints=3)
    plot([seeds[0], other], tmp_path / "a.png")
    assert legend(drawn[0]) == ["point-gather smoke (2 runs)", PAIR]
    for axis in drawn[0].axes:
        one, two, mean = axis.lines
        np.testing.assert_allclose(mean.get_ydata(), (one.get_ydata() + two.get_ydata()) / 2)
        assert one.get_linewidth() == two.get_linewidth() < mean.get_linewidth()
        assert len({line.get_color() for line in axis.lines}) == 1


def test_curves_of_different_lengths_end_where_the_shorter_one_does(seeds, tmp_path, drawn):
    short = runs.train_tiny(tmp_path / "short", seed=9, generations=2)
    plot([seeds[0], short], tmp_path / "a.png", x="generation")
    assert drawn[0].axes[1].lines[-1].get_xdata().tolist() == [1, 2]


def test_a_curve_of_a_single_generation_is_a_dot(seeds, tmp_path, drawn):
    short = [runs.train_tiny(tmp_path / str(seed), seed=seed, generations=1) for seed in (5, 6)]
    plot(short, tmp_path / "a.png")
    assert all([line.get_marker() for line in axis.lines] == ["."] * 3 for axis in drawn[0].axes)
    plot(seeds, tmp_path / "a.png")
    assert all(line.get_marker() != "." for axis in drawn[1].axes for line in axis.lines)


def test_runs_that_hardly_overlap_are_drawn_each_by_itself(seeds, tmp_path, drawn):
    """One of them took long for what the others did in a moment."""
    late = shutil.copytree(seeds[0], tmp_path / "late")
    for table in ("progress.csv", "evaluation.csv"):
        header, *rows = csv.reader((late / table).read_text().splitlines())
        place = header.index("wall_time_s")
        lines = [header, *([*row[:place], str(float(row[place]) + 1000), *row[place + 1 :]] for row in rows)]
        (late / table).write_text("".join(",".join(line) + "\n" for line in lines))
    plot([late, *seeds[1:]], tmp_path / "a.png", x="wall_time_s")
    assert legend(drawn[0]) == ["point-gather smoke (3 runs)", APART]
    for axis, table, column in zip(
        drawn[0].axes[:2], ("evaluation", "progress"), ("score_mean", "controller_return_mean"), strict=True
    ):
        assert len(axis.collections) == 0
        for line, path in zip(axis.lines, [late, *seeds[1:]], strict=True):
            rows = read_csv(path / f"{table}.csv")
            assert line.get_ydata().tolist() == rows[column]
            np.testing.assert_allclose(line.get_xdata() * 60, rows["wall_time_s"])


@pytest.mark.parametrize(
    ("x", "label"),
    [("generation", "generation"), ("env_steps", "environment steps (millions)"), ("wall_time_s", "minutes")],
)
def test_curves_are_drawn_over_what_is_asked_for(seeds, tmp_path, drawn, x, label):
    plot(seeds[:1], tmp_path / "a.png", x=x)
    scale = {"wall_time_s": 60, "env_steps": 1e6}.get(x, 1)
    for axis in drawn[0].axes:
        assert axis.get_xlabel() == label
    np.testing.assert_allclose(
        drawn[0].axes[1].lines[0].get_xdata() * scale, read_csv(seeds[0] / "progress.csv")[x], rtol=1e-12
    )


def test_wrong_arguments_are_refused(seeds, tmp_path):
    with pytest.raises(ConfigError, match="plot needs at least one run folder: shes plot RUN"):
        plot([])
    with pytest.raises(UnknownNameError, match=r"unknown x 'generatio'\. Did you mean 'generation'\?.*Set --x"):
        plot(seeds, x="generatio")
    with pytest.raises(ConfigError, match=r"out must end in \.png, \.pdf or \.svg, got '.*a\.foo'\. Set --out"):
        plot(seeds, tmp_path / "a.foo")
    with pytest.raises(StorageError, match="there is no such folder: create it first"):
        plot(seeds, tmp_path / "none" / "a.png")
    with pytest.raises(RunFolderError, match="is not a run folder"):
        plot([tmp_path], tmp_path / "a.png")
    assert plt.get_fignums() == []
    assert list(tmp_path.iterdir()) == []


def test_a_run_without_a_generation_cannot_be_drawn(seeds, tmp_path):
    path = shutil.copytree(seeds[0], tmp_path / "run")
    (path / "progress.csv").write_text("")
    with pytest.raises(RunFolderError, match=r"progress\.csv has no column 'controller_return_mean', or no row"):
        plot([path], tmp_path / "a.png")
    RunFolder(path).evaluation.unlink()
    with pytest.raises(RunFolderError, match=r"has nothing to draw yet: evaluation\.csv is missing\. Train it first"):
        plot([path], tmp_path / "a.png")


@pytest.mark.parametrize("is_missing", [True, False])
def test_a_run_without_an_evaluation_does_not_keep_others_from_being_drawn(seeds, tmp_path, is_missing):
    young = RunFolder(shutil.copytree(seeds[0], tmp_path / "young"))
    young.evaluation.unlink() if is_missing else young.evaluation.write_text("")
    assert plot([seeds[1], young.path], tmp_path / "a.png").is_file()


def test_a_table_without_a_spread_or_an_abscissa_is_no_traceback(seeds, tmp_path):
    path = shutil.copytree(seeds[0], tmp_path / "run")
    table = read_csv(path / "evaluation.csv")

    def write(*names):
        lines = [names, *zip(*(table[name] for name in names), strict=True)]
        (path / "evaluation.csv").write_text("".join(f"{','.join(map(str, line))}\n" for line in lines))

    write("generation", "env_steps", "score_mean")
    assert plot([path], tmp_path / "a.png").is_file()
    write("generation", "score_mean")
    with pytest.raises(RunFolderError, match=r"evaluation\.csv has no column 'env_steps'"):
        plot([path], tmp_path / "b.png")
