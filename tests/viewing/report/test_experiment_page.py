"""A report of an experiment's folder: figures and comparisons beside the runs, or alone."""

import shutil
import sys

import pytest

from shes.errors import RunFolderError
from shes.viewing.report.experiment_page import experiment_section
from shes.viewing.report.report import report

HEADER = (
    "group,variant,env,seeds,score_mean,score_error,score_iqm,score_iqm_low,score_iqm_high,against,p_holm,"
    "mann_whitney_p,superiority,success_mean,success_error,hours,hardware,versions,commit"
)
ROWS = (
    'methods,published,ant-gather,3,1.5,0.25,1.4,1,2,,,,,0.5,0.125,2.5,"Zen, 24 cores","python 3.12, numpy 2",abc',
    'methods,<b>pieces</b>,ant-gather,1,3,,3,3,3,published,0.02,0.008,0.9,,,1,"Zen, 24 cores",,abc',
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
    text = experiment_section(tables)
    assert text.count("<img ") == 1
    assert 'alt="fig3-hours" src="data:image/png;base64,iVBORyBvZiBmaWd1cmUgMw=="' in text
    assert text.count("<table") == 1
    for cell in ("1.50 ± 0.25", "1.40 [1.00, 2.00]", "0.50 ± 0.12", "2.500", "0.0200", "0.0080", "0.90", "3.00"):
        assert f"<td>{cell}</td>" in text
    assert "hardware: Zen, 24 cores · versions: python 3.12, numpy 2 · commit: abc" in text
    assert "<b>" not in text


def test_the_comparisons_of_a_study_are_in_its_one_table(tables):
    (tables / "fig3.csv").rename(tables / "comparison.csv")
    assert "<h3>comparison</h3>" in experiment_section(tables)


def test_a_folder_of_runs_alone_has_no_section(tmp_path):
    assert experiment_section(tmp_path) == ""


@pytest.mark.parametrize("bad", [ROWS[0].replace("1.5", "much"), "\0\udcff"])
def test_a_table_that_cannot_be_read_is_named(tables, bad):
    (tables / "fig3.csv").write_bytes(f"{HEADER}\n{bad}\n".encode(errors="surrogateescape"))
    with pytest.raises(RunFolderError, match=r"the experiment in .*paper cannot be read"):
        experiment_section(tables)


def test_an_experiment_is_reported_with_its_runs_and_without(tables, tiny_run, tmp_path, stand_in):
    out = tmp_path / "report.html"
    arguments = {"episodes": 1, "num_workers": 1, "video": False}
    report(tables, out, **arguments)
    assert "<h2>Runs</h2>" not in out.read_text(encoding="utf-8")
    assert "1.50 ± 0.25" in out.read_text(encoding="utf-8")
    shutil.copytree(tiny_run, tables / "point-gather" / "methods" / "published" / "seed-5")
    report(tables, out, **arguments)
    text = out.read_text(encoding="utf-8")
    for words in ("<h2>Runs</h2>", "<h2>Fresh episodes</h2>", "<h2>Experiment ", "1.50 ± 0.25"):
        assert words in text
    (tables / "fig3.csv").write_text(f"{HEADER}\n{ROWS[0].replace('1.5', 'much')}\n", encoding="utf-8")
    report(tables, out, **arguments)
    text = out.read_text(encoding="utf-8")
    assert "An experiment is left out: the experiment in" in text
    assert "<h2>Experiment " not in text
