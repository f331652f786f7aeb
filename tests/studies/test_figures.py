"""The figures of studies: they exist, have a sensible size and no text that lies over another."""

import itertools

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

from shes.studies import figures
from shes.studies.comparison import compare
from shes.studies.design import Curves
from shes.studies.figures import draw_figures
from shes.studies.named_studies import STUDIES
from shes.studies.study import choose
from shes.studies.study_tables import CellResults

# The fast tests have three minutes; the first test that needs the figures waits for all of them.
pytestmark = [pytest.mark.extras, pytest.mark.timeout(400)]

MADE = {name: make(seeds=3) for name, make in STUDIES.items()}
STUDY = MADE["ablation"]
COMPARED = [measure.column for study in MADE.values() for measure in study.design.metrics.values()]
PANELS = [p for study in MADE.values() for f in study.design.figures if isinstance(f, Curves) for p in f.panels]
MEASURES = [*(panel.measure for panel in PANELS), *(m for study in MADE.values() for m in study.design.curves.values())]
COURSE = sorted({measure.column for measure in MEASURES if measure is not None})
COURSES = (0.0, 0.2, 0.5, 0.4, 0.9, 0.8)
"""The course of a run's measure, as parts of its score."""
FORMS = ("as published, small", "with the learning changes")
DRAWN = [(name, figure.file.removesuffix(".png")) for name, study in MADE.items() for figure in study.design.figures]


@pytest.fixture(autouse=True, scope="module")
def many_figures():
    """Let all figures be open at once."""
    with plt.rc_context({"figure.max_open_warning": 0}):
        yield


def summaries_of(cells):
    """Return made-up results: good ones, on a course that rises with setbacks."""
    rng = np.random.default_rng(0)
    found = {}
    for cell in cells:
        score = 3.0 + rng.normal()
        before = {} if cell.primitive is None else {"primitive_env_steps": 1_500_000, "primitive_seconds": 5400.0}
        curve = tuple(
            {
                **cell.identity,
                "env_steps": 250_000 * (step + 1) + cell.seed,
                "seconds": 900.0 * (step + 1) + cell.seed,
                **dict.fromkeys(COURSE, score * COURSES[step]),
                "kind": ("measured", "projected", "asleep")[step % 3],
                "cores": 2**step,
                **before,
            }
            for step in range(6)
        )
        whole = {**dict.fromkeys(COMPARED, score), "env_steps": 1_500_000, "seconds": 5400.0}
        found[cell.name] = CellResults(row={**cell.identity, **whole}, curve=curve)
    return found


def draw(cells, out, study=STUDY):
    summaries = summaries_of(cells)
    return draw_figures(study, summaries, compare(study, summaries), out)


@pytest.fixture(scope="module")
def all_drawn(tmp_path_factory):
    """The figures of every whole study, still open, and their files, by the study's name."""
    found, close = {}, plt.close
    for name, study in MADE.items():
        open_figures = []
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(plt, "close", open_figures.append)
            paths = draw(study.cells, tmp_path_factory.mktemp("figures"), study)
        found[name] = dict(zip(dict.fromkeys(path.stem for path in paths), open_figures, strict=True)), paths
    yield found
    for figures_of, _ in found.values():
        for figure in figures_of.values():
            close(figure)


@pytest.fixture
def drawn(all_drawn):
    """The figures of a whole ablation."""
    return all_drawn["ablation"]


@pytest.mark.parametrize("name", STUDIES)
def test_every_figure_is_a_picture_as_wide_as_a_page(all_drawn, name):
    _, paths = all_drawn[name]
    design = MADE[name].design
    assert [path.name for path in paths if path.suffix == ".png"] == [figure.file for figure in design.figures]
    assert len(paths) == len(design.figures) * len(design.formats)
    for path in paths:
        if path.suffix == ".svg":
            assert path.read_text().count("<path") > 20
            continue
        with Image.open(path) as picture:
            width, height = picture.size
            assert (picture.format, width) == ("PNG", 1500)
            assert 0.3 * width < height < 1.5 * width
            assert len(np.unique(np.asarray(picture.convert("L")))) > 20  # something is drawn


def test_the_same_results_are_drawn_as_the_same_bytes(tmp_path):
    study = MADE["fig6"]
    drawn = []
    for folder in (tmp_path / "first", tmp_path / "second"):
        folder.mkdir()
        drawn.append({path.name: path.read_bytes() for path in draw(study.cells, folder, study)})
    assert list(drawn[0]) == ["fig6.svg", "fig6.png"]
    for name, content in drawn[0].items():
        assert drawn[1][name] == content, name


@pytest.mark.parametrize(("study", "name"), DRAWN)
def test_no_text_lies_over_another_or_leaves_the_picture(all_drawn, study, name):
    figure = all_drawn[study][0][name]
    texts = [text for axes in figure.axes for text in texts_of(axes)]
    texts += [text for legend in figure.legends for text in legend.get_texts() if text.get_text()]
    boxes = {text: text.get_window_extent() for text in texts}
    # Slanted labels of neighbours lie side by side, though the boxes around them do not.
    for one, other in itertools.combinations((text for text in boxes if text.get_rotation() != 45), 2):
        assert not boxes[one].overlaps(boxes[other]), (one, other)
    width, height = figure.canvas.get_width_height()
    for text, box in boxes.items():
        assert min(box.x0, box.y0, width - box.x1, height - box.y1) >= 0, text


def texts_of(axes):
    """Return the texts that are to be seen: matplotlib has labels of ticks beyond the limits, too."""
    words = [axes.xaxis.label, axes.yaxis.label, axes.title, axes._left_title, *axes.texts]
    words += axes.get_legend().get_texts() if axes.get_legend() else []
    for axis, side in ((axes.xaxis, "labelbottom"), (axes.yaxis, "labelleft")):
        low, high = sorted(axis.get_view_interval())
        if axis.get_tick_params()[side]:
            labels = zip(axis.get_majorticklocs(), axis.get_ticklabels(), strict=True)
            words += [label for place, label in labels if low <= place <= high]
    return [word for word in words if word.get_text() and word.get_visible()]


def test_the_forest_shows_every_seed_and_the_corrected_p(drawn):
    gather, maze = drawn[0]["choices"].axes
    summaries = summaries_of(STUDY.cells)
    found = {(c.env, c.variant): c for c in compare(STUDY, summaries) if c.group == "choices"}
    for axis, env in ((gather, "point-gather"), (maze, "point-maze")):
        labels = [tick.get_text() for tick in axis.get_yticklabels()]
        assert labels[0] == "base"
        assert len(labels) == len(axis.texts) == 10
        dots = np.concatenate([dot.get_offsets()[:, 0] for dot in axis.collections])
        scores = [
            summaries[c.name].row[STUDY.design.metrics[env].column]
            for c in STUDY.cells
            if (c.env, c.group) == (env, "choices")
        ]
        assert sorted(dots) == pytest.approx(sorted(scores))
        p = found[env, "mirrored-pair"].p_holm
        assert axis.texts[1].get_text() == (f"p = {p:.3f}" if p < 0.1 else f"p = {p:.2f}")


def test_the_sweep_has_the_base_in_the_middle_and_values_as_labels(drawn):
    axes = drawn[0]["sweep"].axes
    assert len(axes) == 10
    base = next(c.settings for c in STUDY.cells if (c.env, c.variant) == ("point-gather", "base"))
    ticks = [tick.get_text() for tick in axes[0].get_xticklabels()]
    assert ticks[2] == f"{base['sigma']:g}"
    assert [float(tick) for tick in ticks] == pytest.approx([base["sigma"] * f for f in (0.25, 0.5, 1, 2, 4)])
    assert axes[0].lines[0].get_xdata().tolist() == [0.25, 0.5, 1, 2, 4]


def legend_of(owner):
    """Return the words of the legend of a figure or of axes, with their handles."""
    legend = owner.legends[0] if hasattr(owner, "legends") else owner.get_legend()
    if legend is None:
        return {}
    words = [text.get_text().replace("\n", " ") for text in legend.get_texts()]
    found = zip(words, legend.legend_handles, strict=True)
    return {text: handle for text, handle in found if text}


def curves_of(axis):
    """Return the named lines of axes: those of means, and references."""
    return {line.get_label(): line for line in axis.lines if not line.get_label().startswith("_")}


BAND = "band: 95 % t interval of the mean over seeds, which may leave the panel"
PAIR = "thin lines: each of two seeds, too few for a band"
APART = "thin lines without a mean: seeds apart, which hardly overlap"
BEST = "dashed: running best, as the authors plot it"
SPAN = "dotted: training of the primitive"


def test_panels_with_other_curves_have_legends_of_their_own(drawn):
    figure = drawn[0]["transfer"]
    gather, maze, horizon = figure.axes
    words = ["no transfer, same view", "transfer, frozen", "transfer, learning on"]
    assert list(curves_of(gather)) == list(curves_of(maze)) == words
    assert list(curves_of(horizon)) == [f"{steps} steps" for steps in (150, 500, 1000)]
    for axis in figure.axes:
        assert list(legend_of(axis)) == [f"{word} (3 seeds)" for word in curves_of(axis)]
        for word, handle in legend_of(axis).items():
            assert handle.get_color() == curves_of(axis)[word.removesuffix(" (3 seeds)")].get_color()
    assert list(legend_of(figure)) == [BAND]
    assert len(horizon.collections) == 3
    own = [found.curve for name, found in summaries_of(STUDY.cells).items() if "/transfer/frozen/" in name]
    ends = [curve[-1][STUDY.design.curves["point-gather"].column] for curve in own if "gather" in curve[0]["env"]]
    frozen = curves_of(gather)["transfer, frozen"].get_ydata()
    assert (len(ends), frozen[-1]) == (3, pytest.approx(np.mean(ends), rel=1e-3))


def test_figure_3_has_published_scores_and_a_running_best_that_never_falls(all_drawn):
    gather = all_drawn["fig3"][0]["fig3-hours"].axes[3]
    lines = curves_of(gather)
    assert lines["HIRO (Nachum 2018)"].get_ydata()[0] == 3.02
    assert lines["SHES (paper)"].get_ydata()[0] == 3.74
    assert lines["FuN, cosine (Nachum 2018)"].get_ydata()[0] == 0.85
    measured, best = gather.lines[0], gather.lines[1]
    assert (measured.get_label(), best.get_linestyle()) == ("SHES as published, small", "--")
    assert np.diff(measured.get_ydata()).min() < 0 <= np.diff(best.get_ydata()).min()
    assert "HIRO, small" in lines
    assert gather.get_xlabel() == "minutes"
    assert measured.get_xdata()[[0, -1]] == pytest.approx([15, 90], rel=0.01)


def look_of(line):
    return line.get_linestyle(), line.get_marker(), line.get_color()


@pytest.mark.parametrize("name", ["fig3-env-steps", "fig3-hours"])
def test_figure_3_has_one_legend_and_no_reference_looks_like_another_line(all_drawn, name):
    figure = all_drawn["fig3"][0][name]
    curves = [f"SHES {form} (3 seeds)" for form in FORMS] + ["HIRO, small (3 seeds)"]
    note = MADE["fig3"].design.figures[0].references_note
    assert list(legend_of(figure)) == [*curves, BAND, BEST, f"grey, with marks: {note}"]
    for axis, panel in zip(figure.axes, MADE["fig3"].design.figures[0].panels, strict=True):
        references = {line.get_label(): look_of(line) for line in axis.lines if line.get_label() in legend_of(axis)}
        assert list(references) == [words for words, _ in panel.references]
        assert references == {words: look_of(handle) for words, handle in legend_of(axis).items()}
        others = {look_of(line) for line in axis.lines if line.get_label() not in references}
        assert len(set(references.values()) | others) == len(references) + len(others)
        assert all(style == "-" and marker for style, marker, _ in references.values())


@pytest.mark.parametrize(("name", "of_primitive"), [("fig5-env-steps", 1.5), ("fig5-hours", 1.5)])
def test_figure_5_marks_the_training_of_a_primitive_before_a_transferred_run(all_drawn, name, of_primitive):
    figure = all_drawn["fig5"][0][name]
    assert list(legend_of(figure))[-2:] == [BAND, SPAN]
    for axis in figure.axes:
        curves = curves_of(axis)
        spans = {line.get_color(): line for line in axis.lines if line.get_linestyle() == ":"}
        assert len(spans) == 2
        for form in FORMS:
            transferred, alone = curves[f"SHES-TL {form}"], curves[f"SHES {form}"]
            start = transferred.get_xdata()[0]
            assert start - alone.get_xdata()[0] == pytest.approx(of_primitive, rel=0.01)
            span = spans[transferred.get_color()]
            assert list(span.get_xdata()) == [0, pytest.approx(of_primitive)]
            assert set(span.get_ydata()) == {transferred.get_ydata()[0]}
    assert SPAN not in legend_of(all_drawn["fig4"][0]["fig4"])
    assert f"{SPAN}, which scores 0 in comparisons" in legend_of(all_drawn["fig5"][0]["fig5-score"])


@pytest.fixture
def opened(monkeypatch):
    """The figures that are drawn, still open and not written, which takes longest."""
    found, close = [], plt.close
    monkeypatch.setattr(figures, "write_atomically", lambda *_: None)
    monkeypatch.setattr(plt, "close", found.append)
    yield found
    for figure in found:
        close(figure)


def changed(study, change):
    """Return made-up results of a study with the rows of curves that `change` returns."""
    return {
        name: CellResults(row=found.row, curve=tuple(change(row) for row in found.curve))
        for name, found in summaries_of(study.cells).items()
    }


def test_seeds_whose_times_do_not_overlap_are_drawn_as_thin_lines(tmp_path, opened):
    """A third seed waited for its primitive for hours, and another one of the other task had a slow machine."""
    study = MADE["fig5"]

    def change(row):
        is_late = (row["env"], row["variant"], row["seed"]) == ("ant-maze", "pieces", 3) and "primitive_seconds" in row
        is_slow = (row["env"], row["seed"]) == ("ant-push", 2)
        return {
            **row,
            **({"primitive_seconds": 5400.0 * 9} if is_late else {}),
            "seconds": row["seconds"] * (1.5 if is_slow else 1),
        }

    draw_figures(study, changed(study, change), [], tmp_path)
    by_steps, by_time, _ = opened
    assert APART not in legend_of(by_steps)
    assert list(legend_of(by_time))[-3:] == [BAND, APART, SPAN]
    maze, push = by_time.axes[4:]
    color = curves_of(maze)["SHES-TL with the learning changes"].get_color()
    singles = [line for line in maze.lines if line.get_color() == color and line.get_linestyle() == "-"]
    assert [len(line.get_xdata()) for line in singles] == [6, 6, 6]
    assert all(line.get_linewidth() < 1 for line in singles)
    assert singles[2].get_xdata() == pytest.approx([(5400 * 9 + 900 * step + 3) / 3600 for step in range(1, 7)])
    assert sorted(
        line.get_xdata()[1] for line in maze.lines if line.get_color() == color and line.get_linestyle() == ":"
    ) == pytest.approx([1.5, 1.5, 13.5])
    assert (maze.get_xlabel(), push.get_xlabel()) == ("hours", "hours")
    for line in curves_of(push).values():  # from where all have begun to where the first one ends
        start = 1.5 if "TL" in line.get_label() else 0
        assert line.get_xdata()[[0, -1]] == pytest.approx([start + 0.375, start + 1.5], rel=0.01)


def test_two_seeds_are_drawn_beside_their_mean_and_the_legend_tells_the_numbers(tmp_path, opened):
    study = MADE["fig5"]
    some = {
        name: found
        for name, found in summaries_of(study.cells).items()
        if not name.startswith("point-maze/methods/published/seed-3") and "pieces/seed-2" not in name
    }
    draw_figures(study, some, [], tmp_path)
    words = list(legend_of(opened[0]))
    assert words[:2] == ["SHES as published, small (2 or 3 seeds)", "SHES with the learning changes (2 seeds)"]
    assert words[4:] == [BAND, PAIR, SPAN]
    gather = opened[0].axes[0]
    pieces = [line for line in gather.lines if line.get_color() == "C1"]
    assert [line.get_linewidth() < 1 for line in pieces] == [True, True, False]
    for axis in opened[0].axes:
        seeds = np.concatenate([line.get_ydata() for line in axis.lines])
        low, high = axis.get_ylim()
        assert low < seeds.min() < seeds.max() < high


def test_a_band_of_few_seeds_does_not_stretch_the_axis(all_drawn):
    study = MADE["fig4"]
    summaries = summaries_of(study.cells)
    for axis, env in zip(all_drawn["fig4"][0]["fig4"].axes, study.design.metrics, strict=True):
        column = study.design.curves[env].column
        seeds = [row[column] for found in summaries.values() for row in found.curve if row["env"] == env]
        bands = np.concatenate([band.get_paths()[0].vertices[:, 1] for band in axis.collections])
        low, high = axis.get_ylim()
        assert bands.max() > high > max(seeds)
        assert (low, high) == pytest.approx((min(seeds), max(seeds)), abs=0.1 * np.ptp(seeds))


@pytest.mark.parametrize(
    ("scale", "steps", "time"),
    [
        (0.001, "environment steps", "seconds"),
        (0.016, "thousand environment steps", "seconds"),  # though the slow seed takes more than two minutes
        (0.1, "thousand environment steps", "minutes"),
        (10, "million environment steps", "hours"),
    ],
)
def test_an_axis_has_the_unit_of_its_longest_curve(tmp_path, opened, scale, steps, time):
    study = MADE["fig3"]

    def change(row):
        slower = 1.5 if row["seed"] == 1 else 1
        return {**row, "env_steps": row["env_steps"] * scale, "seconds": row["seconds"] * scale * slower}

    results = changed(study, change)
    draw_figures(study, results, [], tmp_path)
    for figure, label, base in zip(opened[:2], (steps, time), (1.5e6, 5400), strict=True):
        for axis in figure.axes:
            assert axis.get_xlabel() == label
            unit = {"thousand environment steps": 1e3, "million environment steps": 1e6, "minutes": 60, "hours": 3600}
            end = curves_of(axis)["HIRO, small"].get_xdata()[-1]
            assert end == pytest.approx(base * scale / unit.get(label, 1), rel=0.01)


def test_figure_5_leaves_out_a_curve_that_would_begin_too_early(tmp_path, opened):
    study, summaries = MADE["fig5"], summaries_of(MADE["fig5"].cells)
    for name, found in summaries.items():
        if name.startswith("point"):  # as in the tables of an earlier version
            curve = tuple({key: row[key] for key in row if not key.startswith("primitive_")} for row in found.curve)
            summaries[name] = CellResults(row=found.row, curve=curve)
    draw_figures(study, summaries, compare(study, summaries), tmp_path)
    labels = [curves_of(axis) for axis in opened[0].axes]
    assert [any("SHES-TL" in label for label in found) for found in labels] == [False] * 3 + [True] * 3  # points, ants
    assert all(any(label.startswith("SHES as") for label in found) for found in labels)


def test_figure_4_has_a_curve_for_every_number_of_workers_over_time(all_drawn):
    figure = all_drawn["fig4"][0]["fig4"]
    gather, *others = figure.axes
    words = [f"SHES {form}, {n} worker{'s' * (n > 1)}" for form in FORMS for n in (1, 2)]
    assert list(curves_of(gather)) == words
    assert list(legend_of(figure)) == [*(f"{word} (3 seeds)" for word in words), BAND]
    assert len(others) == 5


def test_figure_6_has_both_forms_and_flat_es_as_means_over_seeds(all_drawn):
    (axis,) = all_drawn["fig6"][0]["fig6"].axes
    lines = {line.get_label(): line for line in axis.lines}
    for name in ("SHES as published", "SHES with the learning changes", "S-ES"):
        for kind in ("projected", "measured", "sleeping workers"):
            assert len(lines[f"{name}, {kind}"].get_xdata()) == 2
    study = MADE["fig6"]
    own = [found for name, found in summaries_of(study.cells).items() if "/published/" in name]
    expected = np.mean([found.curve[1]["speedup"] for found in own])
    assert lines["SHES as published, projected"].get_ydata()[0] == pytest.approx(expected)
    assert {"perfect", "SHES, authors' code", "S-ES, authors' code"} <= lines.keys()
    paper = dict(zip(*lines["paper, Figure 6 (slope)"].get_data(), strict=True))
    assert (paper[1], paper[250], paper[600]) == (1, 50, 100)
    assert paper[24] == pytest.approx(1 + 23 * 49 / 249)  # linear in the cores, and curved on logarithmic axes


def test_only_what_is_finished_is_drawn(tmp_path, monkeypatch):
    before = plt.get_fignums()
    monkeypatch.setattr(figures, "write_atomically", lambda *_: None)  # putting it on paper takes the time
    assert draw([], tmp_path) == []
    assert draw(choose(STUDY, ["horizon"]).cells, tmp_path) == [tmp_path / "transfer.png"]
    one = [cell for cell in STUDY.cells if cell.seed == 1 and cell.variant in ("sigma-x2", "mirrored-none")]
    assert [path.name for path in draw(one, tmp_path)] == ["choices.png", "sweep.png"]
    assert plt.get_fignums() == before


def test_curves_have_no_panel_of_an_environment_without_results(tmp_path, opened):
    some = [cell for cell in MADE["fig4"].cells if cell.env in ("point-maze", "ant-maze") and cell.seed == 1]
    draw(some, tmp_path, MADE["fig4"])
    assert [axis.get_title() for axis in opened[0].axes] == ["Point Maze", "Ant Maze"]
    assert all(text.endswith("(1 seed)") for text in legend_of(opened[0]))  # a single one has no band


def test_a_forest_has_the_environments_with_results_alone(tmp_path, opened):
    draw([c for c in STUDY.cells if (c.group, c.env) == ("choices", "point-maze")], tmp_path)
    assert [axis.get_title(loc="left") for axis in opened[0].axes] == ["Point Maze"]
