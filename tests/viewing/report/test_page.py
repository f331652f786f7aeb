"""The page of a report: whole and self-contained."""

import base64
import json
import shutil
import sys

import pytest

import shes
from shes.drawing import opengl
from shes.errors import ConfigError, MissingExtraError
from shes.viewing.report import page
from shes.viewing.report.report import report
from tests.e2e import runs
from tests.viewing.report.elements import Elements

BAD = "<img src=x onerror=fail()>"


@pytest.fixture
def stand_in(monkeypatch):
    """Stand in for plotly, so that a page can be written without it."""
    module = type(sys)("plotly")
    module.offline = type(sys)("plotly.offline")
    module.offline.get_plotlyjs = lambda: "const text = '</script>'"
    monkeypatch.setitem(sys.modules, "plotly", module)
    monkeypatch.setitem(sys.modules, "plotly.offline", module.offline)


def written(given, tmp_path, **arguments):
    return report(given, tmp_path / "report.html", **{"episodes": 2, "num_workers": 1, "video": False, **arguments})


def test_without_plotly_the_error_names_the_extra(tiny_run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly", None)
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'shes\[report\]'"):
        written(tiny_run, tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"out": "report.pdf"}, ConfigError, r"out must end in \.html, got 'report\.pdf'\. Set --out"),
        ({"out": "none/report.html"}, ConfigError, "there is no folder none"),
        ({"out": "folder.html"}, ConfigError, "is a folder"),
        ({"episodes": 0}, ConfigError, r"episodes must be .* at least 1, got 0\. Set --episodes"),
        ({"seed": -1}, ConfigError, r"seed must be .* at least 0, got -1\. Set --seed"),
        ({"num_workers": -1}, ConfigError, r"workers must be .* at least 0, got -1\. Set --workers"),
    ],
)
def test_wrong_arguments_are_refused_before_any_work(
    tiny_run, tmp_path, monkeypatch, stand_in, arguments, error, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.html").mkdir()
    with pytest.raises(error, match=message):
        report(tiny_run, **arguments, on_step=pytest.fail)


def test_the_page_is_in_the_run_folder_or_where_one_works(run_copy, tmp_path, monkeypatch, stand_in):
    monkeypatch.chdir(tmp_path)
    assert report(run_copy, episodes=1, num_workers=1, video=False) == run_copy / "report.html"
    study = tmp_path / "study"
    shutil.copytree(run_copy, study / "point-gather" / "group" / "variant" / "seed-1")
    (study / "runs.csv").write_text("group,variant,env,seed\ngroup,variant,point-gather,1\n", encoding="utf-8")
    assert report(study, episodes=1, num_workers=1, video=False).resolve() == tmp_path / "report.html"
    several = [run_copy, shutil.copytree(run_copy, tmp_path / "other")]
    assert shes.report(several, episodes=1, num_workers=1, video=False).resolve() == tmp_path / "report.html"


def test_the_page_has_every_section_and_every_figure_its_place(kinds, tmp_path, stand_in):
    read = Elements(written([kinds["first"].parent, kinds["other"], kinds["flat"]], tmp_path))
    text = "".join(read.texts)
    for title in ("Runs", "Fresh episodes", "Returns and scores", "Goals", "Map", "Diagnostics", "Speed", "Settings"):
        assert title in text
    places = [values["data-figure"] for _, values in read.tags if "data-figure" in values]
    assert sorted(places) == sorted(read.figures["figures"])
    assert len([name for name in places if name.startswith("map")]) == 3
    labels = [look["label"] for look in read.figures["axes"]["env_steps"]]
    assert labels == ["algorithm shes, sigma 0.07 (2 runs)", "algorithm shes, sigma 0.5", "algorithm es, sigma 0.07"]


def test_nothing_in_the_files_of_a_run_becomes_part_of_the_page(kinds, tmp_path, stand_in):
    bad = shutil.copytree(kinds["first"], tmp_path / BAD)
    record = json.loads((bad / "config.json").read_text())
    record["command"], record["git_commit"], record["machine"] = ["shes", BAD], BAD, {BAD: "</script>"}
    (bad / "config.json").write_text(json.dumps(record))
    for table in ("progress.csv", "evaluation.csv"):
        text = (bad / table).read_text().splitlines()
        (bad / table).write_text("\n".join([f"{text[0]},{BAD}", *(f"{row},{n}" for n, row in enumerate(text[1:]))]))
    (bad / "checkpoints" / "best.npz").write_text(BAD)
    read = Elements(written([bad, kinds["other"]], tmp_path, labels=[f"{BAD}</script>", "$title"]))
    assert "img" not in {tag for tag, _ in read.tags}
    assert [tag for tag, _ in read.tags].count("script") == 3
    assert sum(BAD in text for text in read.texts) > 5


def test_a_run_that_can_do_nothing_leaves_the_others_alone(kinds, run_copy, tmp_path, stand_in):
    shutil.rmtree(run_copy / "checkpoints")
    (run_copy / "progress.csv").write_text("what is this")
    (run_copy / "evaluation.csv").unlink()
    read = Elements(written([run_copy, kinds["flat"]], tmp_path, video=True))
    notes = [text for text in read.texts if text.startswith(f"{run_copy}: ")]
    for what in ("last checkpoint is missing", "no evaluation.csv", "not be evaluated", "no map", "no video"):
        assert sum(what in note for note in notes) == 1, (what, notes)
    assert [tag for tag, _ in read.tags].count("video") == 1


def test_a_run_of_a_class_that_is_not_registered_here_is_left_out(kinds, run_copy, tmp_path, stand_in, caplog):
    record = json.loads((run_copy / "config.json").read_text())
    record["config"]["run"]["algorithm"] = "random-search"
    (run_copy / "config.json").write_text(json.dumps(record))
    read = Elements(written([run_copy, kinds["flat"]], tmp_path))
    (note,) = (text for text in read.texts if text.startswith(f"{run_copy} is left out: ") and "random-search" in text)
    assert note in caplog.messages


def test_a_video_is_inside_the_page(tiny_run, tmp_path, monkeypatch, stand_in):
    monkeypatch.setenv("MUJOCO_GL", "off")
    opengl.find_opengl.cache_clear()
    read = Elements(written(tiny_run, tmp_path, video=True))
    opengl.find_opengl.cache_clear()
    (source,) = (values["src"] for tag, values in read.tags if tag == "video")
    assert b"ftyp" in base64.b64decode(source.removeprefix("data:video/mp4;base64,"))[:12]
    assert "there is no OpenGL here" in "".join(read.texts)


def test_without_an_encoder_the_report_says_so(tiny_run, tmp_path, monkeypatch, stand_in):
    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", lambda: "/nowhere/ffmpeg")
    read = Elements(written(tiny_run, tmp_path, video=True))
    assert [text for text in read.texts if "There is no video: there is no ffmpeg" in text]


def test_a_young_run_has_a_page(tmp_path, stand_in):
    young = runs.train_tiny(tmp_path / "run", minutes=1e-9)
    read = Elements(written(young, tmp_path))
    assert [name for name in read.figures["figures"] if not name.startswith("map")] == []


def test_tables_are_escaped_and_empty_without_rows():
    assert page.table(["a<"], [["<b>"]]).count("&lt;") == 2
    assert page.table(["a"], []) == page.plots([]) == page.cards([]) == page.details("a", "") == ""
    assert page.section("title", "", "") == ""
