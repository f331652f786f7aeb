"""What a report reads of runs: their groups, and a note for what cannot be read."""

import shutil

import pytest

from shes.errors import ConfigError, RunFolderError
from shes.runs.tables import read_csv
from shes.viewing.report.reading import read_runs
from tests.e2e import runs


def test_runs_are_grouped_as_they_are_plotted(kinds):
    read = read_runs([kinds["first"].parent, kinds["other"], kinds["other"]])
    assert [group.label for group in read.groups] == ["sigma 0.07 (2 runs)", "sigma 0.5"]
    assert [run.name for run in read.runs] == [str(kinds[name]) for name in ("first", "second", "other")]
    assert read.left_out == []


def test_a_label_makes_a_group(kinds):
    read = read_runs([kinds["first"].parent, kinds["other"], kinds["flat"]], ["two levels", "two levels", "flat"])
    assert [(group.label, len(group.runs)) for group in read.groups] == [("two levels (3 runs)", 3), ("flat", 1)]
    assert read.groups_over("wall_time_s") == read.groups_over("generation")
    with pytest.raises(ConfigError, match=r"one label for each of the 2 runs, got 1: a\. Set --labels"):
        read_runs([kinds["first"], kinds["flat"]], ["a"])


def test_the_tables_are_read_as_they_are(kinds):
    (run,) = read_runs([kinds["first"]]).runs
    assert (
        run.tables["progress"]["primitive_return_mean"].tolist()
        == (read_csv(kinds["first"] / "progress.csv")["primitive_return_mean"])
    )
    assert run.notes == []
    assert run.state.generation == 4


def test_a_shipped_agent_has_its_name():
    (run,) = read_runs(["ant-gather"]).runs
    assert run.name == "ant-gather"
    assert len(run.tables["evaluation"]["score_mean"]) > 2


@pytest.mark.parametrize(
    ("table", "content", "note"),
    [
        ("progress.csv", None, "There is no progress.csv yet"),
        ("evaluation.csv", "", "evaluation.csv has no row yet"),
        ("evaluation.csv", "generation,env_steps\n1,x\n", "cannot be read as a table of numbers"),
        ("progress.csv", "generation,env_steps\n1\n", "cannot be read as a table of numbers"),
        ("checkpoints/last.npz", "no checkpoint", "The last checkpoint is damaged"),
    ],
)
def test_a_file_that_is_missing_or_damaged_is_a_note(run_copy, table, content, note):
    if content is None:
        (run_copy / table).unlink()
    else:
        (run_copy / table).write_text(content)
    (run,) = read_runs([run_copy]).runs
    assert [each for each in run.notes if note in each]


def test_a_run_without_a_generation_is_read(tmp_path):
    path = runs.train_tiny(tmp_path / "run", minutes=1e-9)
    (run,) = read_runs([path]).runs
    assert run.state.generation == 0
    assert len(run.notes) == 2


def test_a_run_whose_record_is_damaged_is_left_out(kinds, tmp_path):
    broken = shutil.copytree(kinds["first"], tmp_path / "broken")
    (broken / "config.json").write_text("{")
    read = read_runs([broken, kinds["first"]])
    assert [run.name for run in read.runs] == [str(kinds["first"])]
    (note,) = read.left_out
    assert note.startswith(f"{broken} is left out: ")
    with pytest.raises(RunFolderError, match=r"config\.json cannot be read"):
        read_runs([broken])


def test_what_is_no_run_is_refused(kinds, tmp_path):
    with pytest.raises(RunFolderError, match="gone does not exist"):
        read_runs([kinds["first"], tmp_path / "gone"])
    with pytest.raises(ConfigError, match="report needs at least one run folder: shes report RUN"):
        read_runs([])
