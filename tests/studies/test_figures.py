"""The figures of studies: they exist, have a sensible size and no text that lies over another."""

import itertools

import matplotlib.pyplot as plt
import numpy as np
import pytest
from PIL import Image

from shes.studies import figures
from shes.studies.comparison import compare
from shes.studies.figures import draw_figures
from shes.studies.named_studies import STUDIES
from shes.studies.study import choose
from shes.studies.study_tables import CellResults

# The fast tests have three minutes; the first test that needs the figures waits for all of them.
pytestmark = [pytest.mark.extras, pytest.mark.timeout(400)]

MADE = {name: make(seeds=3) for name, make in STUDIES.items()}
STUDY = MADE["ablation"]
COMPARED = [measure.column for study in MADE.values() for measure in study.design.metrics.values()]
COURSE = ["score_mean", "training_return_mean", "primitive_return_mean", "return_mean", "success_rate"]
COURSES = (0.0, 0.2, 0.5, 0.4, 0.9, 0.8)
"""The course of a run's measure, as parts of its score."""
FORMS = ("as published", "with the learning changes")
DRAWN = [(name, figure.file.removesuffix(".png")) for name, study in MADE.items() for figure in study.design.figures]


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
    boxes = {text: text.get_window_extent() for axes in figure.axes for text in texts_of(axes)}
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


def test_curves_are_means_over_seeds_of_transfer_and_horizon(drawn):
    gather, maze, horizon = drawn[0]["transfer"].axes
    words = ["no transfer, same view (3 seeds)", "transfer, frozen (3 seeds)", "transfer, learning on (3 seeds)"]
    assert [line.get_label() for line in gather.lines] == [line.get_label() for line in maze.lines] == words
    assert [line.get_label() for line in horizon.lines] == [f"{steps} steps (3 seeds)" for steps in (150, 500, 1000)]
    assert len(horizon.collections) == 3


def test_figure_3_has_published_scores_and_a_running_best_that_never_falls(all_drawn):
    gather = all_drawn["fig3"][0]["fig3-hours"].axes[3]
    lines = {line.get_label(): line for line in gather.lines}
    assert lines["HIRO (Nachum 2018)"].get_ydata()[0] == 3.02
    assert lines["SHES (paper)"].get_ydata()[0] == 3.74
    assert lines["FuN, cosine (Nachum 2018)"].get_ydata()[0] == 0.85
    measured, best = gather.lines[0], gather.lines[1]
    assert (measured.get_label(), best.get_linestyle()) == ("SHES as published (3 seeds)", "--")
    assert np.diff(measured.get_ydata()).min() < 0 <= np.diff(best.get_ydata()).min()
    assert "HIRO (3 seeds)" in lines
    assert measured.get_xdata()[[0, -1]] == pytest.approx([0.25, 1.5], rel=0.01)


def dashes_of(line):
    return line._unscaled_dash_pattern  # `get_linestyle` is "--" for every pattern


def test_the_legend_of_figure_3_says_what_dashed_curves_are(all_drawn):
    words = "dashed: running best, as the authors plot it"
    for name in ("fig3-env-steps", "fig3-hours"):
        for axis in all_drawn["fig3"][0][name].axes:
            legend = axis.get_legend()
            dashes = dict(
                zip([text.get_text() for text in legend.texts], map(dashes_of, legend.get_lines()), strict=True)
            )
            alike = [text for text, found in dashes.items() if found == dashes_of(axis.lines[1])]
            assert alike == [words]  # no reference has the dashes of the running best
    (other, *_) = all_drawn["fig5"][0]["fig5-hours"].axes
    assert words not in [text.get_text() for text in other.get_legend().texts]


@pytest.mark.parametrize(("name", "of_primitive"), [("fig5-env-steps", 1500), ("fig5-hours", 1.5)])
def test_figure_5_begins_a_transferred_run_where_its_primitive_ended(all_drawn, name, of_primitive):
    for axis in all_drawn["fig5"][0][name].axes:
        starts = {line.get_label().split(" (")[0]: line.get_xdata()[0] for line in axis.lines}
        for form in FORMS:
            assert starts[f"SHES-TL {form}"] - starts[f"SHES {form}"] == pytest.approx(of_primitive, rel=0.01)


def test_figure_5_leaves_out_a_curve_that_would_begin_too_early(tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(plt, "close", figures.append)
    study, summaries = MADE["fig5"], summaries_of(MADE["fig5"].cells)
    for name, found in summaries.items():
        if name.startswith("point"):  # as in the tables of an earlier version
            curve = tuple({key: row[key] for key in row if not key.startswith("primitive_")} for row in found.curve)
            summaries[name] = CellResults(row=found.row, curve=curve)
    draw_figures(study, summaries, compare(study, summaries), tmp_path)
    labels = [{line.get_label() for line in axis.lines} for axis in figures[0].axes]
    assert [any("SHES-TL" in label for label in found) for found in labels] == [False] * 3 + [True] * 3  # points, ants
    assert all(any(label.startswith("SHES as") for label in found) for found in labels)


def test_figure_4_has_a_curve_for_every_number_of_workers_over_hours(all_drawn):
    (gather, *others) = all_drawn["fig4"][0]["fig4"].axes
    words = [f"SHES {form}, {n} worker{'s' * (n > 1)} (3 seeds)" for form in FORMS for n in (1, 2)]
    assert [line.get_label() for line in gather.lines] == words
    assert len(others) == 5
    assert gather.get_xlabel() == "hours"


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
    assert {"perfect", "paper, Figure 6 (slope)", "SHES, authors' code", "S-ES, authors' code"} <= lines.keys()


def test_only_what_is_finished_is_drawn(tmp_path, monkeypatch):
    before = plt.get_fignums()
    monkeypatch.setattr(figures, "write_atomically", lambda *_: None)  # putting it on paper takes the time
    assert draw([], tmp_path) == []
    assert draw(choose(STUDY, ["horizon"]).cells, tmp_path) == [tmp_path / "transfer.png"]
    one = [cell for cell in STUDY.cells if cell.seed == 1 and cell.variant in ("sigma-x2", "mirrored-none")]
    assert [path.name for path in draw(one, tmp_path)] == ["choices.png", "sweep.png"]
    assert plt.get_fignums() == before


def test_curves_have_no_panel_of_an_environment_without_results(tmp_path, monkeypatch):
    opened = []
    monkeypatch.setattr(figures, "write_atomically", lambda *_: None)
    monkeypatch.setattr(plt, "close", opened.append)
    some = [cell for cell in MADE["fig4"].cells if cell.env in ("point-maze", "ant-maze")]
    draw(some, tmp_path, MADE["fig4"])
    assert [axis.get_title() for axis in opened[0].axes] == ["Point Maze", "Ant Maze"]
    monkeypatch.undo()
    plt.close(opened[0])
