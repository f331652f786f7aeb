"""The page of a report: whole, self-contained, and telling what could not be read or done."""

import base64
import json
import shutil
import sys
from html import escape
from html.parser import HTMLParser

import numpy as np
import pytest
from scipy import stats

import shes
from shes.runs.evaluate import evaluate
from shes.runs.tables import read_csv
from shes.viewing.report import estimate, report
from tests.e2e import runs

BAD = "<img src=x onerror=fail()>"
QUICK = {"num_workers": 1, "video": False}


class Page(HTMLParser):
    """Tags and texts of a page, and its figures by name."""

    def __init__(self, path):
        super().__init__()
        self.tags, self.texts, self.figures, self._figure = [], [], {}, None
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        self._figure = dict(attributes).get("data-plot")

    def handle_data(self, data):
        if self._figure:
            assert "<" not in data  # which could end the script
            self.figures[self._figure], self._figure = json.loads(data), None
        else:
            self.texts.append(data)


@pytest.fixture(autouse=True, scope="module")
def stand_in():
    """Stand in for plotly, so that a page can be written without it."""
    module = type(sys)("plotly")
    module.offline = type(sys)("plotly.offline")
    module.offline.get_plotlyjs = lambda: "const text = '</script>'"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "plotly", module)
        patch.setitem(sys.modules, "plotly.offline", module.offline)
        yield


@pytest.fixture(scope="module")
def whole(kinds, tmp_path_factory):
    """The page of three repetitions, a run of another sigma and a flat one, and the parts of work that were begun."""
    heard = []
    given, out = [kinds["first"].parent, kinds["other"], kinds["flat"]], tmp_path_factory.mktemp("whole") / "a.html"
    report(given, out, episodes=4, on_step=lambda *part: heard.append(part), **QUICK)
    return Page(out), heard


def test_the_page_is_in_the_run_folder_or_where_one_works(run_copy, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert report(run_copy, episodes=1, **QUICK) == run_copy / "report.html"
    several = [run_copy, shutil.copytree(run_copy, tmp_path / "other")]
    assert shes.report(several, episodes=1, **QUICK).resolve() == tmp_path / "report.html"


def test_the_page_has_every_section_and_every_figure_its_place(whole):
    page, heard = whole
    for title in ("Runs", "Fresh episodes", "Returns and scores", "Maps and videos", "Diagnostics", "Time in seconds"):
        assert title in page.texts
    places = [values["id"] for tag, values in page.tags if tag == "div" and "id" in values]
    assert sorted(places) == sorted(page.figures)
    assert len([name for name in places if name.startswith("map")]) == 3
    labels = {trace["legendgroup"] for trace in page.figures["Returns and scores point-gather"]["data"]}
    assert labels == {"algorithm shes, sigma 0.07 (3 runs)", "algorithm shes, sigma 0.5", "algorithm es, sigma 0.07"}
    assert heard == [(part, 8) for part in range(1, 9)]  # five runs and three groups


def test_a_table_has_the_results_that_evaluate_finds(whole, kinds):
    texts = set(whole[0].texts)
    found = [evaluate(kinds[name], episodes=4, num_workers=1) for name in ("first", "second", "third")]
    for each in found:
        assert {estimate(each.scores), estimate(each.returns)} <= texts
    assert estimate(np.array([each.returns.mean() for each in found])) in texts
    assert {f"{sum(read_csv(kinds[name] / 'progress.csv')['rollout_s']):,.0f}" for name in ("first", "flat")} <= texts


def test_settings_differ_from_each_other_and_from_the_preset(whole):
    text = "\n".join(whole[0].texts).replace("\n\n", "\n")
    assert "sigma\n0.07\n0.07\n0.07\n0.5\n0.07\n0.07\n0.07" in text  # five runs, then the presets of shes and of es
    assert "controller_interval\n25\n25\n25\n25\n-\n25\n-" in text
    assert "noise_table_size" not in text  # the same everywhere


def test_an_estimate_is_mean_standard_error_and_interval():
    values = np.random.default_rng(0).normal(3.0, 1.0, 60)
    text = estimate(values)
    assert text.startswith(f"{values.mean():.2f} ± {stats.sem(values):.2f} [")
    ends = [float(word.strip("[],")) for word in text.split()[-2:]]
    assert ends == pytest.approx(stats.norm.interval(0.95, values.mean(), stats.sem(values)), abs=0.06)
    assert estimate(np.array([2.0])) == "2.00"


def test_nothing_in_the_files_of_a_run_becomes_part_of_the_page(kinds, tmp_path):
    bad = shutil.copytree(kinds["first"], tmp_path / BAD)
    changes = {"command": ["shes", BAD], "git_commit": BAD, "machine": {BAD: "</script>"}}
    runs.change_json(bad / "config.json", lambda record: record.update(changes))
    for table in ("progress.csv", "evaluation.csv"):
        text = (bad / table).read_text().splitlines()
        (bad / table).write_text("\n".join([f"{text[0]},{BAD}", *(f"{row},{n}" for n, row in enumerate(text[1:])), ""]))
    (bad / "checkpoints" / "best.npz").write_text(BAD)
    given = [bad, kinds["first"]]  # called by their paths: they have the same seed
    page = Page(report(given, tmp_path / "report.html", episodes=1, **QUICK))
    assert "img" not in {tag for tag, _ in page.tags}
    assert [tag for tag, _ in page.tags].count("script") == 2 + len(page.figures)
    assert sum(BAD in text for text in page.texts) > 5
    figure = page.figures["Diagnostics point-gather"]
    assert escape(BAD) in {note["text"] for note in figure["layout"]["annotations"]}
    assert escape(str(bad)) in {trace.get("name") for trace in figure["data"]}


def test_a_run_that_can_do_nothing_leaves_the_others_alone(kinds, run_copy, tmp_path, caplog):
    shutil.rmtree(run_copy / "checkpoints")
    (run_copy / "progress.csv").write_text("what is this\n1,2\n3\n")
    (run_copy / "evaluation.csv").unlink()
    broken = shutil.copytree(kinds["first"], tmp_path / "broken")
    (broken / "config.json").write_text("{")
    given = [run_copy, broken, kinds["flag"]]
    page = Page(report(given, tmp_path / "report.html", episodes=1, num_workers=1))
    notes = [text for text in page.texts if text.startswith(f"{run_copy}: ")]
    assert "unreadable" in page.texts  # the state of a run without checkpoints
    for what in ("evaluation.csv is missing", "no evaluation:", "no map", "no video"):
        assert sum(what in note for note in notes) == 1, (what, notes)
    assert any(text.startswith(f"{broken} is left out: ") for text in page.texts)
    assert set(notes) <= set(caplog.messages)
    (source,) = (values["src"] for tag, values in page.tags if tag == "video")
    assert b"ftyp" in base64.b64decode(source.removeprefix("data:video/mp4;base64,"))[:12]
    assert {"Returns and scores point-gather", "Returns and scores point-flagrun"} & page.figures.keys()
