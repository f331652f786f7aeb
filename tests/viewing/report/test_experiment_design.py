"""Charts and names of an experiment in a report: those of its design, which `shes experiment` writes."""

import json
import shutil
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from shes.errors import RunFolderError
from shes.studies.named_studies import STUDIES
from shes.studies.paper_scales import REFERENCES
from shes.studies.report_design import write_report_design
from shes.studies.speedup_figure import PAPER_SECONDS
from shes.viewing.report import page_sections
from shes.viewing.report.experiment_page import experiment_section
from shes.viewing.report.experiment_runs import group_places
from shes.viewing.report.maps import play_episodes
from shes.viewing.report.page_sections import Sections
from shes.viewing.report.reading import read_runs
from tests.viewing.report.experiment_tables import write_curves

COLUMNS = ("group", "variant", "env", "seed", "env_steps", "seconds", "score_mean", "training_return_mean")
COLUMNS += ("primitive_env_steps", "primitive_seconds", "kind", "cores", "speedup")


@pytest.fixture
def experiment(tmp_path):
    """Folder of an experiment with the designs of figures 3 to 6, and no row."""
    folder = tmp_path / "paper"
    folder.mkdir()
    for name in ("fig3", "fig4", "fig5", "fig6"):
        write_report_design(name, STUDIES[name]("laptop"), name, folder)
    (folder / "runs.csv").write_text("group,variant,env,seed\nmethods,published,ant-gather,1\n", encoding="utf-8")
    return folder


def rows_of(group, variant, env="ant-gather", scores=((1, 3, 2), (3, 1, 4), (2, 2, 3)), start=("", "")):
    return [
        (group, variant, env, seed, 100 * step, 60 * step, score, -score, *start)
        for seed, values in enumerate(scores, start=1)
        for step, score in enumerate(values, start=1)
    ]


def measured(variant, cores, speedup, kind="measured", seed=1):
    return ("speedup", variant, "ant-maze", seed, *[""] * 6, kind, cores, speedup)


def charts(experiment, rows):
    """Return the figures of an experiment by title, and its section."""
    write_curves(experiment, COLUMNS, [row + ("",) * (len(COLUMNS) - len(row)) for row in rows])
    text, figures = experiment_section(experiment)
    return {name.removeprefix(f"{experiment} "): figure for name, figure in figures.items()}, text


def legend(figure):
    return [trace["name"] for trace in figure["data"] if trace.get("showlegend", True)]


def test_a_chart_shows_what_figure_3_shows(experiment):
    rows = [row for variant in ("published", "pieces", "hiro") for row in rows_of("methods", variant)]
    found, text = charts(experiment, rows)
    assert "methods: controller and primitive together from scratch" in text
    assert "transfer: " not in text  # which has no run
    assert "<h3>Figure 3</h3>" in text
    figure = found["fig3 Ant Gather: test score"]["env_steps"]
    references = [f"{words}: {value:g}" for words, value in REFERENCES["ant-gather"]]
    names = ["SHES as published, small", "SHES with the learning changes", "HIRO, small"]
    assert legend(figure) == [
        *(f"{name} (3 seeds)" for name in names),
        "running best, as the authors plot it",
        *references,
    ]
    lines = {trace.get("name"): trace for trace in figure["data"]}
    best = lines["HIRO, small (3 seeds), running best"]
    assert (lines["HIRO, small (3 seeds)"]["y"], best["y"]) == ([2, 2, 3], [2, 2.66667, 3.33333])
    assert best["line"]["dash"] == "dash"
    assert best["legendgroup"] == lines["HIRO, small (3 seeds)"]["legendgroup"]
    assert best["line"]["color"] == lines["HIRO, small (3 seeds)"]["line"]["color"]
    assert sum("fill" in trace for trace in figure["data"]) == 3
    assert [lines[name]["y"] for name in references] == [[value] * 2 for _, value in REFERENCES["ant-gather"]]
    assert lines[references[0]]["x"] == [100, 300]
    by_curve = {trace["legendgroup"] for trace in figure["data"] if "legendgroup" in trace}
    assert len(by_curve) == 3  # mean, band and running best of a curve are shown and hidden together
    assert "fig3 Point Gather: test score" not in found


def test_a_chart_over_hours_alone_has_no_other_axis(experiment):
    rows = [row for number in (1, 2) for row in rows_of("workers", f"pieces-{number}")]
    figures = charts(experiment, rows)[0]["fig4 Ant Gather: training reward, perturbed policies"]
    assert figures["env_steps"] == figures["wall_time_s"]
    assert figures["env_steps"]["layout"]["xaxis"]["title"]["text"] == "minutes"
    assert legend(figures["env_steps"]) == [
        "SHES with the learning changes, 1 worker (3 seeds)",
        "SHES with the learning changes, 2 workers (3 seeds)",
    ]


def test_a_transferred_run_without_the_time_of_its_primitive_is_in_no_chart_of_figure_5(experiment):
    rows = [*rows_of("methods", "pieces"), *rows_of("transfer", "published")]
    rows += rows_of("transfer", "pieces", scores=((1, 2),), start=(1000, 600))
    figure = charts(experiment, rows)[0]["fig5 Ant Gather: training reward, perturbed policies"]["wall_time_s"]
    assert legend(figure) == ["SHES with the learning changes (3 seeds)", "SHES-TL with the learning changes (1 seed)"]
    assert figure["data"][-1]["x"] == [11, 12]


def test_the_training_of_primitives_is_one_line_before_a_mean_and_one_for_each_of_curves_that_are_apart(experiment):
    rows = [
        row
        for seed in (1, 2, 3)
        for row in rows_of("transfer", "pieces", scores=((1, 2),), start=(1000, 600 * seed**5))
    ]
    rows = [(*row[:3], 1 + number // 2, *row[4:]) for number, row in enumerate(rows)]
    figures = charts(experiment, rows)[0]["fig5 Ant Gather: training reward, perturbed policies"]
    mean, apart = (figures[x]["data"] for x in ("env_steps", "wall_time_s"))
    ends = [0, 10, None, 0, 320, None, 0, 2430, None]  # of seeds 1 to 3, in minutes
    for data, x in ((mean, [0, 1000, None]), (apart, ends)):
        (before,) = (trace for trace in data if trace["line"].get("dash") == "dot")
        (curve,) = (trace for trace in data if trace.get("name"))
        assert (before["x"], before["y"]) == (x, [-1 if end is not None else None for end in x])
        assert before["legendgroup"] == curve["legendgroup"]
        assert before["line"]["color"] == curve["line"]["color"]


def test_the_speed_up_is_a_chart_beside_that_of_the_authors(experiment):
    rows = [
        measured("published", cores, cores * part, seed=seed) for cores in (1, 2) for seed, part in ((1, 1), (2, 0.5))
    ]
    rows += [("speedup", "published", "point-maze", 1, *[""] * 6, "measured", 1, 9)]  # of scale smoke
    rows += [measured("es", 600, 99, "projected"), measured("es", 4, "", "asleep"), measured("es", 8, 3, "asleep")]
    found, _ = charts(experiment, rows)
    figure = found["fig6 Ant Maze: speed-up"]
    lines = {unescape(trace["name"]): (trace["x"], trace["y"]) for trace in figure["data"]}
    assert lines["SHES as published, measured"] == ([1, 2], [0.75, 1.5])
    assert lines["S-ES, projected"] == ([600], [99])
    assert lines["S-ES, sleeping workers"] == ([8], [3])
    assert lines["perfect"] == ([1, 600], [1, 600])
    assert lines["S-ES, authors' code"][1][1] == pytest.approx(6345 / 523)
    assert lines["SHES, authors' code"][0] == list(PAPER_SECONDS["shes"])
    slope = dict(zip(*lines["paper, Figure 6 (slope)"], strict=True))
    assert (slope[50], slope[600]) == (pytest.approx(1 + 49 * 49 / 249, abs=1e-3), 100)  # linear in the cores
    assert figure["layout"]["xaxis"]["type"] == figure["layout"]["yaxis"]["type"] == "log"
    assert list(found) == ["fig6 Ant Maze: speed-up"]  # and no learning curve


def test_curves_that_are_in_no_figure_follow_and_speed_ups_do_not_count_among_them(experiment):
    rows = [row for number in range(9) for row in rows_of(f"g{number % 2}", f"v{number}", "ant-maze")]
    rows += [measured(variant, 1, 1) for variant in ("published", "pieces", "es")]
    found, text = charts(experiment, [*rows, *rows_of("transfer", "pieces", "ant-maze", start=(1000, 600))])
    assert list(found) == [
        "fig5 Ant Maze: training reward, perturbed policies",
        "fig5 Ant Maze: test score",
        "fig6 Ant Maze: speed-up",
        "ant-maze: test score",
        "ant-maze: training reward",
    ]
    assert "<h3>Further curves</h3>" in text
    score = found["ant-maze: test score"]["env_steps"]
    assert legend(score)[-1] == "g0, v8 (3 seeds)"
    assert sum("fill" in trace for trace in score["data"]) == 9
    assert len(legend(found["ant-maze: training reward"]["env_steps"])) == 9


def test_a_design_that_cannot_be_read_is_named_and_runs_keep_their_names(experiment, tiny_run):
    shutil.copytree(tiny_run, experiment / "point-gather" / "methods" / "pieces" / "seed-5")
    assert [run.name for run in read_runs([experiment]).runs] == [
        "point-gather: methods, with the learning changes, seed 5"
    ]
    (experiment / "fig3-design.json").write_text("{}", encoding="utf-8")
    assert [run.name for run in read_runs([experiment]).runs] == ["point-gather: methods, pieces, seed 5"]
    with pytest.raises(RunFolderError, match=r"fig3-design\.json is no design of an experiment"):
        experiment_section(experiment)
    design = json.loads((experiment / "fig5-design.json").read_text())
    (experiment / "fig3-design.json").write_text(json.dumps({**design, "variants": []}))
    assert [run.name for run in read_runs([experiment]).runs] == ["point-gather: methods, pieces, seed 5"]
    with pytest.raises(RunFolderError, match=r"one of fig3-design\.json, .* is damaged.*shes experiment NAME --no-run"):
        experiment_section(experiment)
    design["charts"][0].pop("curves")
    (experiment / "fig3-design.json").write_text(json.dumps(design))
    with pytest.raises(RunFolderError, match=r"the experiment in .*paper cannot be read: 'curves'"):
        experiment_section(experiment)


@pytest.fixture
def with_runs(experiment, kinds):
    """The experiment with seven runs, one of them in a folder of another form."""
    for place in (
        "methods/pieces/seed-10",
        "methods/pieces/seed-9",
        "methods/published/seed-1",
        "transfer/pieces/seed-1",
    ):
        shutil.copytree(kinds["first"], experiment / "point-gather" / place)
    for variant in ("pieces", "published"):
        shutil.copytree(kinds["flag"], experiment / "point-flagrun" / "transfer" / variant / "seed-1")
    shutil.copytree(kinds["flat"], experiment / "other")
    return experiment


def test_the_runs_of_an_experiment_are_named_and_grouped_by_its_design(with_runs):
    read = read_runs([with_runs])
    assert [group.title for group in read.groups] == [
        "point-gather: methods, as published, small, seed 1",
        "point-gather: methods, with the learning changes (2 runs)",
        "point-gather: transfer, with the learning changes, seed 1",
        "point-flagrun: transfer, as published, small, seed 1",
        "point-flagrun: transfer, with the learning changes, seed 1",
        str(with_runs / "other"),
    ]
    assert [run.place.seed for run in read.groups[1].runs] == [9, 10]
    look = {(group.label, group.group.color) for group in read.groups}
    assert len(look) == len({label for label, _ in look}) == len({color for _, color in look}) == 5
    both = [with_runs, shutil.copytree(with_runs, with_runs.parent / "again")]
    names = [run.name for run in read_runs(both).runs]
    assert len(set(names)) == len(names) == 14
    labelled = read_runs(both, ["one", "two"])
    assert [group.label for group in labelled.groups] == ["one (7 runs)", "two (7 runs)"]
    assert {run.place for run in labelled.runs} == {None}


def test_other_runs_whose_label_is_that_of_a_method_or_of_each_other_are_groups_of_their_own(with_runs):
    read = read_runs([with_runs])
    method, alone = read.groups[0].label, read.groups[-1]
    folders = [run.folder for run in read.runs if run.place is not None]
    others = [replace(alone.group, label=label) for label in (method, method)]
    places = {run.folder.path.resolve(): run.place for run in read.runs if run.place is not None}
    found = group_places(folders, places, others)
    assert [group.label for group in found[-2:]] == [method, method]
    assert len({(group.color, group.style) for group in (*found[:1], *found[-2:])}) == 3


def test_maps_begin_with_each_variant_on_each_environment(with_runs, monkeypatch):
    shown = []

    def play(path, *arguments):
        shown.append(path.relative_to(with_runs).as_posix())
        return play_episodes(path, *arguments)

    monkeypatch.setattr(page_sections, "play_episodes", play)
    read = read_runs([with_runs])
    assert page_sections.num_parts(read, has_videos=False) == 7 + 6
    assert "groups: " not in Sections(read, lambda: None).pictures(1, None, has_videos=False)
    assert shown == [
        "point-gather/methods/published/seed-1",
        "point-flagrun/transfer/published/seed-1",
        "point-gather/methods/pieces/seed-9",
        "point-flagrun/transfer/pieces/seed-1",
        "point-gather/transfer/pieces/seed-1",
        "other",
    ]
    monkeypatch.setattr(page_sections, "_MOST_SHOWN_OF_EXPERIMENTS", 4)
    assert "Shown are 4 of 6 groups: " in Sections(read, lambda: None).pictures(1, None, has_videos=False)
    assert shown[6:] == shown[:4]


def test_the_budget_that_ends_a_run_is_shown(kinds, run_copy):
    record = json.loads((run_copy / "config.json").read_text())
    steps = int(np.loadtxt(run_copy / "progress.csv", delimiter=",", skiprows=1)[-1, 1])
    record["config"]["run"] |= {"generations": 100_000, "env_steps": 2 * steps}
    (run_copy / "config.json").write_text(json.dumps(record))
    text = Sections(read_runs([run_copy]), lambda: None).runs()
    assert f"<td>{steps:,} of {2 * steps:,}</td>" in text
    assert "of 100000" not in text
    assert "<td>4 of 4</td>" in Sections(read_runs([kinds["first"]]), lambda: None).runs()
