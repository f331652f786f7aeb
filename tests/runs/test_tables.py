"""Tables and TensorBoard events: numbers are bit-identical when read back, and rows whole; nothing is written twice."""

import csv
import errno
import math
import os
import struct

import numpy as np
import pytest
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.plugin_hparams_pb2 import HParamsPluginData

import shes
from shes.errors import RunFolderError, StorageError
from shes.runs.folder import RunFolder
from shes.runs.tables import CsvTable, last_value, read_csv, trained_minutes
from shes.runs.tensorboard import Events
from shes.viewing.plot import plot
from tests.e2e import runs

VALUES = [0.1 + 0.2, 1e-310, -0.0, 1.7976931348623157e308, math.inf, math.nan, 2.0**53 + 2]


def fill(path, last, first=1, keep=0):
    table = CsvTable(path, keep)
    for generation in range(first, last + 1):
        table.add({"generation": generation, "x": generation / 3})
    return path.read_text()


def test_numbers_read_back_bit_identically(tmp_path):
    table = CsvTable(tmp_path / "a.csv", 0)
    for generation, value in enumerate(VALUES, 1):
        table.add({"generation": generation, "x": value})
    assert np.array(read_csv(tmp_path / "a.csv")["x"]).tobytes() == np.array(VALUES).tobytes()


@pytest.mark.parametrize("more", ["", "5", "5,", "5,0.3", "5,0.3\n", "5,0.3\n6,0.1\n7"])
def test_rows_after_the_checkpoint_are_dropped_however_they_end(tmp_path, more):
    path = tmp_path / "a.csv"
    whole = fill(path, 4)
    assert whole.startswith("generation,x\n1,0.333")
    with path.open("a") as file:
        file.write(more)
    CsvTable(path, 4)
    assert path.read_text() == whole


@pytest.mark.parametrize("length", range(0, 40, 3))
def test_a_table_cut_anywhere_goes_on_as_if_nothing_had_happened(tmp_path, length):
    """Half a header counts as none; half a row is of a generation that no checkpoint has."""
    path = tmp_path / "a.csv"
    whole = fill(path, 4)
    path.write_text(whole[:length])
    kept = max(0, whole[:length].count("\n") - 1)
    assert fill(path, 4, first=kept + 1, keep=kept) == whole


def test_a_last_row_without_the_end_of_its_line_is_not_read(tmp_path):
    """A plot may be drawn while the run writes a row."""
    path = tmp_path / "a.csv"
    whole, longer = fill(path, 4), fill(path, 5)
    path.write_text(whole)
    rows = read_csv(path)
    for end in range(len(whole), len(longer)):
        path.write_text(longer[:end])
        assert read_csv(path) == rows


TABLES = {
    "binary": b"\xff\xfe\x00" * 50,
    "endless number": b"generation,x\n" + b"9" * 5000 + b",1\n",
    "endless field": b'generation,x\n1,"' + b"a" * 200_000 + b'"\n',
    "words": b"generation,x\n1,abc\n2,0\n",
}


@pytest.mark.parametrize("name", ["progress", "evaluation"])
@pytest.mark.parametrize("case", TABLES)
def test_a_damaged_table_is_one_clear_error_and_kept(run_copy, name, case, tmp_path):
    path = run_copy / f"{name}.csv"
    path.write_bytes(TABLES[case])
    for go_on in (lambda: shes.resume(run_copy, generations=6), lambda: plot([run_copy], tmp_path / "curves.png")):
        with pytest.raises(
            RunFolderError, match=rf"{name}\.csv (cannot be read as a table of numbers|has no (row|column))"
        ):
            go_on()
    assert path.read_bytes() == TABLES[case]


def cut_row(lines):
    return [*lines[:-1], ",".join(lines[-1].split(",")[:3])]


REFUSED = {
    "rows are missing": ("progress", lambda lines: lines[:-2], r"ends with generation 2, but the run has made 4: rows"),
    "a row is cut": ("evaluation", cut_row, r"row 3 below the header has 3 values for \d+ columns\."),
    "the file": ("evaluation", None, r"is missing, but the run has made 4 generations\. Restore it .*or make an empty"),
    "a column": (
        "progress",
        lambda lines: [lines[0] + ",note", *(line + ",0" for line in lines[1:])],
        "not write: note",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_table_that_is_not_whole_is_refused_and_an_empty_one_goes_on(run_copy, case):
    name, damage, message = REFUSED[case]
    path = run_copy / f"{name}.csv"
    lines = path.read_text().splitlines()
    path.unlink()
    if damage is not None:
        path.write_text("\n".join(damage(lines)) + "\n")
    with pytest.raises(RunFolderError, match=rf"{name}\.csv .*{message}"):
        shes.resume(run_copy, generations=5)
    path.write_text("")  # the way out that the message names
    assert shes.resume(run_copy, generations=6).generation == 6
    assert path.read_text().startswith("generation,")


def test_a_table_without_rows_has_no_columns(tmp_path):
    with pytest.raises(RunFolderError, match=r"a\.csv cannot be read"):
        read_csv(tmp_path / "a.csv")
    (tmp_path / "a.csv").write_text("")
    assert read_csv(tmp_path / "a.csv") == {}


# TensorBoard.


def events(folder):
    """Return the events of all files of a folder, file after file, as TensorBoard reads them."""
    found = []
    for path in sorted(folder.glob("events*"), key=lambda path: path.stat().st_mtime_ns):
        data = path.read_bytes()
        while data:
            (length,) = struct.unpack("Q", data[:8])
            found.append(Event.FromString(data[12 : 12 + length]))
            data = data[16 + length :]
    return found


def scalars(folder):
    return [
        (event.summary.value[0].tag, event.step, event.summary.value[0].simple_value)
        for event in events(folder)
        if event.summary.value and not event.summary.value[0].HasField("metadata")
    ]


def hyperparameters(folder):
    """Return the hyperparameters of each session in a folder."""
    contents = [value.metadata.plugin_data.content for event in events(folder) for value in event.summary.value]
    data = [HParamsPluginData.FromString(content) for content in contents if content]
    return [each.session_start_info.hparams for each in data if each.HasField("session_start_info")]


def test_a_hierarchical_run_has_a_dozen_charts_without_values_that_are_not_finite(tmp_path):
    path = runs.train_tiny(tmp_path / "run", "point-maze", perturbation="one_to_many")
    found = scalars(path / "tensorboard")
    assert {tag for tag, _, _ in found} == {
        "episodes/episode_steps_mean",
        "evaluation/return_mean",
        "evaluation/score_mean",
        "evaluation/success_rate",
        "speed/env_steps_per_s",
        "training/controller_return_mean",
        "training/primitive_return_mean",
        "training/score_mean",
        "update/controller_halves_cosine",
        "update/controller_update_ratio",
        "update/primitive_halves_cosine",
        "update/primitive_update_ratio",
    }
    assert all(math.isfinite(value) for _, _, value in found)
    assert {step for tag, step, _ in found if tag == "training/score_mean"} == {1, 2, 3, 4}
    # The levels are perturbed in turns: a level that was not has no gradient.
    assert {step for tag, step, _ in found if tag == "update/controller_update_ratio"} == {1, 3}
    table = read_csv(path / "progress.csv")
    assert [math.isnan(value) for value in table["primitive_gradient_norm"]] == [True, False, True, False]


def test_hyperparameters_are_written_once_and_a_resumed_run_hides_what_it_does_again(run_copy):
    shes.resume(run_copy, generations=5)
    found = events(run_copy / "tensorboard")
    assert [event.step for event in found if event.session_log.status == SessionLog.START] == [5]
    (written,) = hyperparameters(run_copy / "tensorboard")
    assert (written["sigma"].number_value, written["env"].string_value) == (0.07, "point-gather")
    assert (written["hidden"].string_value, written["seed"].number_value) == ("[4]", 5)


def test_parts_of_a_run_that_begin_within_a_second_have_files_of_their_own(tmp_path):
    for generation in (0, 1):
        written = Events(tmp_path / "events", generation, {})
        written.add("progress", {"generation": generation + 1, "score_mean": generation + 0.5})
        written.close()
    assert len(list((tmp_path / "events").iterdir())) == 2
    assert sorted(scalars(tmp_path / "events")) == [("training/score_mean", 1, 0.5), ("training/score_mean", 2, 1.5)]


def test_a_full_disk_is_told_at_once(tmp_path, monkeypatch):
    written = Events(tmp_path / "tensorboard", 0, {})

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tensorboardX.record_writer.RecordWriter.write", full)
    with pytest.raises(StorageError, match=r"cannot write .*tensorboard: the disk is full"):
        written.add("progress", {"generation": 1, "score_mean": 0.5})
    written.close()


# Columns and times of runs.


def test_the_tables_of_a_run_have_the_columns_of_the_design(tiny_run):
    with (tiny_run / "progress.csv").open(newline="") as file:
        progress = next(csv.reader(file))
    with (tiny_run / "evaluation.csv").open(newline="") as file:
        evaluation = next(csv.reader(file))
    levels = [f"{level}_return_{kind}" for level in ("controller", "primitive") for kind in ("mean", "max")]
    assert progress[:8] == ["generation", "env_steps", "wall_time_s", "env_steps_per_s", *levels]
    assert evaluation[:6] == ["generation", "env_steps", "wall_time_s", "episodes", "score_mean", "score_std"]
    assert {"return_mean", "success_rate"} <= set(evaluation)
    assert read_csv(tiny_run / "progress.csv")["env_steps"] == [160, 320, 480, 640]
    assert read_csv(tiny_run / "evaluation.csv")["generation"] == [1, 2, 4]


def test_times_go_on_after_a_resume_and_that_of_an_evaluation_is_in_its_generations_row(run_copy):
    shes.resume(run_copy, generations=6)
    table = read_csv(run_copy / "progress.csv")
    for name in ("wall_time_s", "process_time_s"):
        assert len(table[name]) == 6
        assert table[name] == sorted(table[name])
    assert [seconds > 0 for seconds in table["evaluation_s"]] == [True, True, False, True, False, True]
    evaluations = read_csv(run_copy / "evaluation.csv")
    assert 0 < evaluations["process_time_s"][0] <= table["process_time_s"][-1]


def test_the_time_of_a_run_is_that_of_its_last_whole_row(run_copy):
    progress = run_copy / "progress.csv"
    times = {name: read_csv(progress)[name][-1] for name in ("wall_time_s", "process_time_s")}
    text = progress.read_text()
    for cut in ("", "5,1200", text.splitlines()[-1]):  # as after a crash
        progress.write_text(text + cut)
        assert last_value(progress, "process_time_s") == times["process_time_s"]
        assert trained_minutes(RunFolder(run_copy)) == times["wall_time_s"] / 60
    progress.write_text("")
    assert trained_minutes(RunFolder(run_copy)) == 0.0
