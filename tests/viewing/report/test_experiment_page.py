"""A report of an experiment's folder: figures and comparisons beside the runs, or alone."""

import shutil
import sys

import pytest

from shes.errors import RunFolderError
from shes.viewing.report.experiment_page import experiment_section
from shes.viewing.report.report import report
from tests.viewing.report.experiment_tables import write_curves

HEADER = (
    "group,variant,env,seeds,score_mean,score_error,score_iqm,score_iqm_low,score_iqm_high,against,difference,p_holm,"
    "mann_whitney_p,superiority,success_mean,success_error,hours,hardware,versions,commit,primitive_hours"
)
ROWS = (
    'methods,published,ant-gather,3,1.5,0.25,1.4,1,2,,,,,,0.5,0.125,2.5,"Zen, 24 cores","python 3.12, numpy 2",abc,',
    'methods,<b>pieces</b>,ant-gather,1,3,,3,3,3,published,1.5,0.02,0.008,0.9,,,1,"Zen, 24 cores",,def; abc,0.25',
)
PNG = b"\x89PNG of figure 3"


@pytest.fixture
def tables(tmp_path):
    """Folder of the tables and the figure of an experiment, without runs."""
    folder = tmp_path / "paper"
    folder.mkdir()
    (folder / "fig3.csv").write_text("\n".join([HEADER, *ROWS]), encoding="utf-8")
    (folder / "runs.csv").write_text("group,variant,env,seed\nmethods,published,ant-gather,1\n", encoding="utf-8")
    (folder / "fig3-hours.png").write_bytes(PNG)
    return folder


@pytest.fixture
def stand_in(monkeypatch):
    """Stand in for plotly, so that a page can be written without it."""
    module = type(sys)("plotly")
    module.offline = type(sys)("plotly.offline")
    module.offline.get_plotlyjs = lambda: ""
    monkeypatch.setitem(sys.modules, "plotly", module)
    monkeypatch.setitem(sys.modules, "plotly.offline", module.offline)


def test_the_section_has_each_figure_and_each_comparison(tables):
    text, _ = experiment_section(tables)
    assert text.count("<img ") == 1
    assert 'alt="fig3-hours" src="data:image/png;base64,iVBORyBvZiBmaWd1cmUgMw=="' in text
    assert text.count("<table") == 2  # results and comparisons
    for cell in (
        "1.50 ± 0.25",
        "1.40 [1.00, 2.00]",
        "0.50 ± 0.12",
        "2.500",
        "0.250 + 1.000",
        "0.020",
        "0.008",
        "+1.50",
        "0.90",
        "3.00",
    ):
        assert f"<td>{cell}</td>" in text
    assert "hardware: Zen, 24 cores · versions: python 3.12, numpy 2 · commit: abc; def</p>" in text
    assert "<b>" not in text


def test_a_variant_has_one_result_and_a_row_for_each_comparison(tables):
    rows = [f"{ROWS[0]},", f"{ROWS[1]},methods", f"{ROWS[1].replace('published', 'other')},transfer"]
    (tables / "fig3.csv").write_text("\n".join([f"{HEADER},against_group", *rows]), encoding="utf-8")
    text = experiment_section(tables)[0]
    results, comparisons = text.split("fig3: comparisons")
    assert [each.count("<tr>") for each in (results, comparisons)] == [3, 3]  # with that of the headings
    for other in ("methods, published", "transfer, other"):
        assert f"<td>methods, &lt;b&gt;pieces&lt;/b&gt;</td><td>{other}</td>" in comparisons


def test_equal_budgets_and_ratios_are_shown_where_there_are_any(tables):
    assert "equal steps" not in experiment_section(tables)[0].partition("comparisons")[2].partition("</table>")[0]
    columns = {
        "steps_score": 1.25,
        "steps_score_against": 0.5,
        "steps_p_holm": 0.0286,
        "hours_score": 2,
        "hours_p_holm": 0.0004,
    }
    columns |= {
        "steps_span": 2_500_000,
        "hours_span": 0.025,
        "hours_score_against": 1,
        "ratio": 0.5,
        "ratio_low": 0.49,
        "ratio_high": 0.52,
    }
    rows = [ROWS[0] + "," * len(columns), ",".join([ROWS[1], *map(str, columns.values())])]
    (tables / "fig3.csv").write_text("\n".join([",".join([HEADER, *columns]), *rows]), encoding="utf-8")
    text = experiment_section(tables)[0]
    for cell in (
        "1.25 against 0.50 in 2.50 M, p 0.029",
        "2.00 against 1.00 in 1.5 min, p &lt;0.001",
        "0.50 [0.49, 0.52]",
    ):
        assert f"<td>{cell}</td>" in text
    for heading in ("equal steps", "equal time", "ratio"):
        assert f'<th scope="col">{heading}</th>' in text


def test_the_comparisons_of_a_study_are_in_its_one_table(tables):
    (tables / "fig3.csv").rename(tables / "comparison.csv")
    assert "<h3>comparison: results</h3>" in experiment_section(tables)[0]


def test_the_settings_of_table_1_are_shown(tables):
    (tables / "table1-settings.csv").write_text("Table_I,scale paper\npopulation size,1000\n", encoding="utf-8")
    text, _ = experiment_section(tables)
    assert '<th scope="col">Table I</th>' in text
    assert "<td>1000</td>" in text


def named(figure):
    return {trace["name"]: trace for trace in figure["data"] if "name" in trace}


def test_curves_are_drawn_from_the_table_alone(tables):
    columns = ("group", "variant", "env", "seed", "env_steps", "score_mean", "training_return_mean", "seconds")
    rows = [
        ("methods", "published", env, seed, steps, seed * steps, "" if variant == "published" else 1.0, 60 * seed)
        for env in ("ant-gather", "ant-maze")
        for variant in ("published",)
        for seed in (1, 2)
        for steps in (100, 200)
    ]
    rows += [("transfer", "<b>pieces</b>", "ant-maze", 1, steps, 5.0, 1.0, steps) for steps in (100, 200)]
    write_curves(tables, columns, rows)
    text, figures = experiment_section(tables)
    titles = [name.removeprefix(f"{tables} ") for name in figures]
    assert titles == ["ant-gather: test score", "ant-maze: test score", "ant-maze: training reward"]
    assert text.count("data-figure=") == 3
    assert "<b>" not in text
    by_x = figures[f"{tables} ant-maze: test score"]
    curves = named(by_x["env_steps"])
    assert list(curves) == ["methods, published (2 seeds)", "transfer, &lt;b&gt;pieces&lt;/b&gt; (1 seed)"]
    mean, one = curves.values()
    assert (mean["x"], mean["y"]) == ([100, 200], [150, 300])
    assert one["line"]["color"] != mean["line"]["color"]
    assert len(by_x["env_steps"]["data"]) == 3  # both runs are beside their mean
    assert named(by_x["wall_time_s"])["transfer, &lt;b&gt;pieces&lt;/b&gt; (1 seed)"]["x"] == [1.66667, 3.33333]
    assert by_x["generation"]["layout"]["xaxis"]["title"]["text"] == "environment steps"
    assert list(named(figures[f"{tables} ant-maze: training reward"]["env_steps"])) == list(curves)[1:]


@pytest.mark.parametrize(("x", "begins"), [("env_steps", [100, 1100]), ("wall_time_s", [1, 6])])
def test_a_curve_with_a_transferred_primitive_begins_where_its_training_ended(tables, x, begins):
    columns = ("group", "variant", "env", "seed", "env_steps", "score_mean", "seconds")
    columns += ("primitive_env_steps", "primitive_seconds")
    rows = [("methods", "v", "e", 1, 100, 1.0, 60, "", ""), ("transfer", "v", "e", 1, 100, 1.0, 60, 1000, 300)]
    write_curves(tables, columns, rows)
    figure = experiment_section(tables)[1][f"{tables} e: test score"][x]
    assert [trace["x"][0] for trace in named(figure).values()] == begins


def test_each_group_of_many_variants_has_a_figure_and_time_is_shown_where_it_is_known(tables):
    columns = ("group", "variant", "env", "seed", "env_steps", "score_mean")
    places = [("choices", f"c{number}") for number in range(8)] + [("sweep", f"s{number}") for number in range(11)]
    write_curves(tables, columns, [(*place, "point-maze", seed, 9, 0.5) for place in places for seed in (1, 2, 3)])
    _, figures = experiment_section(tables)
    assert [name.removeprefix(f"{tables} ") for name in figures] == [
        "point-maze, choices: test score",
        "point-maze, sweep: test score",
    ]
    choices, sweep = figures.values()
    assert choices["wall_time_s"] == choices["env_steps"]
    assert list(named(choices["env_steps"])) == [f"c{number} (3 seeds)" for number in range(8)]
    bands = [sum("fill" in trace for trace in each["env_steps"]["data"]) for each in (choices, sweep)]
    assert bands == [8, 0]  # eleven could not be told apart


OF_RUNS = ("group", "variant", "env", "seed", "env_steps", "score_mean", "settings")


def scores(tables, runs):
    """Return title and curves of the figure of runs, each a variant, a seed, a digest and its score at both ends."""
    rows = [
        ("g", variant, "e", seed, steps, score, digest) for variant, seed, digest, score in runs for steps in (1, 2)
    ]
    write_curves(tables, OF_RUNS, rows)
    _, figures = experiment_section(tables)
    figure = figures[f"{tables} e: test score"]["env_steps"]
    return figure["layout"]["title"]["text"], {name: trace["y"] for name, trace in named(figure).items()}


def test_only_runs_of_the_first_settings_are_drawn_and_the_others_are_counted(tables):
    current = [("v", 1, "new", 2.0), ("v", 2, "new", 4.0), ("w", 1, "other", 7.0)]
    assert scores(tables, current) == ("e: test score", {"v (2 seeds)": [3, 3], "w (1 seed)": [7, 7]})
    title, curves = scores(tables, [*current, ("v", 1, "old", 90.0)])
    assert curves == {"v (2 seeds)": [3, 3], "w (1 seed)": [7, 7]}
    assert title == "e: test score<br><sub>1 run of other settings is left out</sub>"
    old = [("v", seed, "old", 90.0) for seed in (1, 2, 3)]
    title, curves = scores(tables, [*current, *old, ("v", 3, "new", 9.0)])
    assert curves == {"v (3 seeds)": [5, 5], "w (1 seed)": [7, 7]}
    assert title == "e: test score<br><sub>3 runs of other settings are left out</sub>"
    for others in (old, old[1:]):
        assert scores(tables, [("v", 1, "new", 2.0), *others])[1] == {"v (1 seed)": [2, 2]}


def test_runs_without_the_drawn_measure_do_not_hide_the_time(tables):
    columns = ("group", "variant", "env", "seed", "env_steps", "seconds", "score_mean", "training_return_mean", "cores")
    rows = [("methods", "v", "e", 1, steps, 60 * steps, 0.5, "", "") for steps in (1, 2)]
    rows += [("speedup", "v", "e", 1, "", "", "", "", cores) for cores in (1, 2)]  # of figure 6
    rows += [("methods", "old", "e", 1, steps, "", "", 3.0, "") for steps in (1, 2)]
    write_curves(tables, columns, rows)
    _, figures = experiment_section(tables)
    timed = figures[f"{tables} e: test score"]["wall_time_s"]
    assert named(timed)["methods, v (1 seed)"]["x"] == [1, 2]
    assert timed["layout"]["xaxis"]["title"]["text"] == "minutes"
    untimed = figures[f"{tables} e: training reward"]["wall_time_s"]
    assert named(untimed)["methods, old (1 seed)"]["x"] == [1, 2]
    assert untimed["layout"]["xaxis"]["title"]["text"] == "environment steps"


@pytest.mark.parametrize("bad", ["much", "\0"])
def test_curves_that_cannot_be_read_are_named(tables, bad):
    write_curves(tables, ("group", "variant", "env", "seed", "env_steps", "score_mean"), [("g", "v", "e", 1, 1, bad)])
    with pytest.raises(RunFolderError, match=r"the experiment in .*paper cannot be read"):
        experiment_section(tables)


def test_a_folder_of_runs_alone_has_no_section(tmp_path):
    assert experiment_section(tmp_path) == ("", {})


@pytest.mark.parametrize("bad", [ROWS[0].replace("1.5", "much"), "\0\udcff"])
def test_a_table_that_cannot_be_read_is_named(tables, bad):
    (tables / "fig3.csv").write_bytes(f"{HEADER}\n{bad}\n".encode(errors="surrogateescape"))
    with pytest.raises(RunFolderError, match=r"the experiment in .*paper cannot be read"):
        experiment_section(tables)


def test_an_experiment_without_a_run_and_without_a_result_is_refused(tables):
    table = tables / "runs.csv"
    table.write_text(table.read_text(encoding="utf-8").splitlines()[0] + "\n", encoding="utf-8")
    with pytest.raises(RunFolderError, match=r"neither a run nor a row in runs\.csv.* shes experiment NAME --out"):
        report(tables, tables / "report.html")


def test_an_experiment_is_reported_with_its_runs_and_without(tables, tiny_run, tmp_path, stand_in):
    out = tmp_path / "report.html"
    arguments = {"episodes": 1, "num_workers": 1, "video": False}
    report(tables, out, **arguments)
    assert "No folder of a run is here, so that " in out.read_text(encoding="utf-8")
    assert "1.50 ± 0.25" in out.read_text(encoding="utf-8")
    run = tables / "point-gather" / "methods" / "published" / "seed-5"
    shutil.copytree(tiny_run, run)
    record = (run / "config.json").read_text(encoding="utf-8")
    (run / "config.json").write_text("{", encoding="utf-8")  # the only run cannot be read
    report(tables, out, **arguments)
    assert "seed-5 is left out: " in out.read_text(encoding="utf-8")
    assert "1.50 ± 0.25" in out.read_text(encoding="utf-8")
    (run / "config.json").write_text(record, encoding="utf-8")
    report(tables, out, **arguments)
    text = out.read_text(encoding="utf-8")
    assert "No folder of a run" not in text
    titles = ["<h2>Experiment ", "1.50 ± 0.25", "<h2>Runs</h2>", "<summary>1 run</summary>", "<h2>Fresh episodes</h2>"]
    assert sorted(titles, key=text.index) == titles
    (tables / "fig3.csv").write_text(f"{HEADER}\n{ROWS[0].replace('1.5', 'much')}\n", encoding="utf-8")
    report(tables, out, **arguments)
    text = out.read_text(encoding="utf-8")
    assert "An experiment is left out: the experiment in" in text
    assert "<h2>Experiment " not in text
