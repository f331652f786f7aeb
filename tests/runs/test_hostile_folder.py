"""Run folders that no run has left behind: each fault is one clear error, and nothing is written outside."""

import json
import os
import shutil

import pytest

import shes
from shes.errors import RunFolderError
from shes.viewing.plot import plot
from tests.e2e import runs


def files(folder):
    """Return the bytes of every file of `folder`."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(run, message, go_on=lambda run: shes.resume(run, generations=6)):
    before = files(run)
    with pytest.raises(RunFolderError, match=message) as error:
        go_on(run)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 700
    before.pop(run / ".lock", None)
    after = files(run)
    after.pop(run / ".lock", None)
    assert after == before


# Tables.

TABLES = {
    "binary": b"\xff\xfe\x00" * 50,
    "zeros": bytes(200),
    "endless_number": b"generation,x\n" + b"9" * 5000 + b",1\n",
    "endless_field": b'generation,x\n1,"' + b"a" * 200_000,
    "words": b"generation,x\n1,abc\n2,0\n",
}


@pytest.mark.parametrize("name", ["progress", "evaluation"])
@pytest.mark.parametrize("case", TABLES)
def test_a_damaged_table_is_one_clear_error(run_copy, name, case, tmp_path):
    (run_copy / f"{name}.csv").write_bytes(TABLES[case])
    if case != "zeros":  # in CSV, that is a header without rows
        refused(run_copy, rf"{name}\.csv cannot be read as a table of numbers: .*Restore it from a copy")
    refused(
        run_copy,
        rf"{name}\.csv (cannot be read as a table of numbers|has no (row|column))",
        lambda run: plot([run], tmp_path / "curves.png"),
    )


@pytest.mark.parametrize("name", ["progress", "evaluation"])
@pytest.mark.parametrize(("row", "values", "end"), [(1, 3, ""), (1, 1, ""), (-1, 3, ""), (-1, 3, "-"), (-1, 3, "1e-")])
def test_a_row_before_the_checkpoint_that_is_cut_off_is_named(run_copy, name, row, values, end):
    path = run_copy / f"{name}.csv"
    lines = path.read_text().splitlines()
    columns, number = len(lines[0].split(",")), lines[row].partition(",")[0]
    lines[row] = ",".join(lines[row].split(",")[:values])
    if end:
        lines[row] = lines[row].rpartition(",")[0] + "," + end
    path.write_text("\n".join(lines))
    refused(
        run_copy, rf"{name}\.csv is damaged: the row of generation {number} has {values} values for {columns} columns\."
    )


@pytest.mark.parametrize("name", ["progress", "evaluation"])
def test_a_deleted_table_is_told_of_and_an_empty_one_goes_on(run_copy, name):
    path = run_copy / f"{name}.csv"
    path.unlink()
    refused(run_copy, rf"{name}\.csv is missing, but the run has made 4 generations\. Restore it .*or make an empty")
    path.touch()
    assert shes.resume(run_copy, generations=6).generation == 6
    assert path.read_text().startswith("generation,")


def test_a_run_without_a_generation_needs_no_table(tmp_path, run_copy):
    for name in ("progress", "evaluation"):
        (run_copy / f"{name}.csv").unlink()
    checkpoints = run_copy / "checkpoints"
    shutil.copy(checkpoints / "generation_000000.npz", checkpoints / "last.npz")
    assert shes.resume(run_copy, generations=1).generation == 1


# The record.


@pytest.mark.parametrize(
    "change",
    [
        {"versions": [1]},
        {"resumed": 3},
        {"resumed": [3]},
        {"resumed": [{"device": []}]},
        {"device": 4},
        {"machine": "here"},
        {"config": []},
        {"primitive": 5},
        {"command": 5},
        {"command": [5]},
    ],
)
def test_a_record_of_wrong_types_is_one_clear_error(run_copy, change):
    path = run_copy / "config.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    refused(run_copy, r"config\.json is damaged: config, versions, .* must be objects, .*Restore it from a copy")


@pytest.mark.parametrize("text", ["[" * 100_000, '{"format": 2, "config": ' + '{"a":' * 100_000, "1" * 5000])
@pytest.mark.parametrize("go_on", [shes.resume, shes.evaluate, shes.load])
def test_a_record_that_python_cannot_read_is_one_clear_error(run_copy, text, go_on):
    (run_copy / "config.json").write_text(text)
    refused(run_copy, r"config\.json cannot be read: .*Restore it from a copy", go_on)


# Symbolic links.

PLACES = ("config.json", "progress.csv", "evaluation.csv", "log.txt", ".lock", "checkpoints", "tensorboard")


@pytest.mark.parametrize("name", PLACES)
def test_nothing_is_written_through_a_link_that_leads_out(run_copy, tmp_path, name):
    outside = tmp_path / "outside"
    (run_copy / name).rename(outside)
    (run_copy / name).symlink_to(outside)
    before = files(tmp_path)
    refused(run_copy, rf"{name} is a symbolic link that leads out of the run folder, to .*outside: nothing is written")
    assert files(tmp_path) == before


@pytest.mark.parametrize("name", ["log.txt", ".lock", "tensorboard"])
def test_nothing_is_written_through_a_link_in_a_folder_for_a_new_run(tmp_path, name):
    path, outside = tmp_path / "run", tmp_path / "outside"
    path.mkdir()
    (path / name).symlink_to(outside)
    with pytest.raises(RunFolderError, match=rf"{name} is a symbolic link that leads out of the run folder"):
        runs.train_tiny(path)
    assert not outside.exists()


def test_nothing_is_written_through_a_link_below_the_folder_of_events(run_copy, tmp_path):
    outside = tmp_path / "outside"
    (run_copy / "tensorboard" / "env_steps").rename(outside)
    (run_copy / "tensorboard" / "env_steps").symlink_to(outside)
    before = files(outside)
    refused(run_copy, r"env_steps is a symbolic link that leads out of the run folder")
    assert files(outside) == before


@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", ["progress.csv", "evaluation.csv", "log.txt", ".lock"])
def test_no_pipe_is_waited_for(run_copy, tmp_path, name):
    (run_copy / name).unlink()
    os.mkfifo(run_copy / name)
    with pytest.raises(RunFolderError, match=rf"{name} is not a regular file"):
        shes.resume(run_copy, generations=6)
    if name.endswith(".csv"):
        with pytest.raises(RunFolderError, match=rf"{name} cannot be read .*: it is not a regular file"):
            plot([run_copy], tmp_path / "curves.png")


@pytest.mark.timeout(60)
def test_a_pipe_as_record_is_not_waited_for(run_copy, tmp_path):
    (run_copy / "config.json").unlink()
    os.mkfifo(run_copy / "config.json")
    with pytest.raises(RunFolderError, match=r"config\.json cannot be read: there is no such file"):
        plot([run_copy], tmp_path / "curves.png")


def test_a_link_to_the_run_folder_itself_or_inside_it_is_followed(tmp_path, run_copy):
    (run_copy / "tensorboard").rename(run_copy / "events")
    (run_copy / "tensorboard").symlink_to("events")
    (tmp_path / "link").symlink_to(run_copy)
    assert shes.resume(tmp_path / "link", generations=5).generation == 5
