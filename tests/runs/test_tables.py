"""Tables and TensorBoard events: numbers are bit-identical when read back, and rows whole; nothing is written twice."""

import csv
import errno
import math
import os
import struct
import threading
from time import sleep

import numpy as np
import pytest
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.plugin_hparams_pb2 import HParamsPluginData

from shes.errors import RunFolderError, StorageError
from shes.runs.folder import RunFolder
from shes.runs.session import Session
from shes.runs.tables import CsvTable, Records, check_tables, read_csv, read_process_time, trained_minutes
from tests.e2e import runs

VALUES = [0.1 + 0.2, 1e-310, -0.0, 1.7976931348623157e308, math.inf, math.nan, 2.0**53 + 2]


def test_numbers_read_back_to_the_bit(tmp_path):
    table = CsvTable(tmp_path / "a.csv", 0)
    for generation, value in enumerate(VALUES, 1):
        table.add({"generation": generation, "x": value})
    read = read_csv(tmp_path / "a.csv")["x"]
    assert np.array(read).tobytes() == np.array(VALUES).tobytes()


def fill(path, last):
    table = CsvTable(path, 0)
    for generation in range(1, last + 1):
        table.add({"generation": generation, "x": generation / 3})
    return path.read_text()


def test_a_header_comes_once(tmp_path):
    path = tmp_path / "a.csv"
    whole = fill(path, 4)
    path.unlink()
    fill(path, 2)
    table = CsvTable(path, 2)
    for generation in (3, 4):
        table.add({"generation": generation, "x": generation / 3})
    assert path.read_text() == whole
    assert whole.startswith("generation,x\n1,0.333")


@pytest.mark.parametrize("more", ["", "5", "5,", "5,0.3", "5,0.3\n", "5,0.3\n6,0.1\n7"])
def test_rows_after_the_checkpoint_are_dropped_however_they_end(tmp_path, more):
    path = tmp_path / "a.csv"
    whole = fill(path, 4)
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
    table = CsvTable(path, kept)
    for generation in range(kept + 1, 5):
        table.add({"generation": generation, "x": generation / 3})
    assert path.read_text() == whole


@pytest.mark.parametrize("cut", range(22))
def test_a_row_of_an_evaluation_that_is_pending_may_be_cut_anywhere(folder, cut):
    fill(folder.progress, 4)
    whole = fill(folder.evaluation, 4)
    folder.evaluation.write_text(whole[: len(whole) - cut])
    check_tables(folder, 4, owes_evaluation=True)


def test_a_last_row_without_the_end_of_its_line_is_not_read(tmp_path):
    """A plot may be drawn while the run writes a row."""
    path = tmp_path / "a.csv"
    whole = fill(path, 4)
    rows = read_csv(path)
    fill(path, 5)
    longer = path.read_text()
    for end in range(len(whole), len(longer)):
        path.write_text(longer[:end])
        assert read_csv(path) == rows
    path.write_text(longer)
    assert len(read_csv(path)["x"]) == 5


def test_a_damaged_table_is_refused_and_kept(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("generation,x\none,2\n")
    with pytest.raises(
        RunFolderError, match=r"a\.csv cannot be read as a table of numbers: .*'one'.*Restore it from a copy"
    ):
        CsvTable(path, 4)
    assert path.read_text() == "generation,x\none,2\n"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("generation,x\n1,abc\n", "could not convert string to float: 'abc'"),
        ("generation,x\n1,2\n2\n", "row 2 below the header has 1 values for 2 columns"),
    ],
)
def test_a_table_that_holds_no_numbers_cannot_be_read(tmp_path, text, problem):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(RunFolderError, match=rf"a\.csv cannot be read as a table of numbers: {problem}"):
        read_csv(path)


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


@pytest.fixture
def folder(tmp_path):
    return RunFolder.create(tmp_path / "run")


def test_charts_are_in_named_groups_against_generations_and_learning_curves_against_steps(folder):
    records = Records(folder, 0)
    records.add(
        "progress",
        {
            "generation": 1,
            "env_steps": 160,
            "wall_time_s": 2.0,
            "env_steps_per_s": 80.0,
            "controller_return_mean": 0.5,
            "controller_return_max": 9.0,
            "primitive_update_ratio": 0.25,
            "rollout_s": 0.1,
        },
    )
    records.add("evaluation", {"generation": 1, "env_steps": 160, "score_mean": 1.5, "score_std": 3.0})
    records.close()
    assert scalars(folder.tensorboard) == [
        ("training/controller_return_mean", 1, 0.5),
        ("update/primitive_update_ratio", 1, 0.25),
        ("speed/env_steps_per_s", 1, 80.0),
        ("evaluation/score_mean", 1, 1.5),
    ]
    assert scalars(folder.tensorboard / "env_steps") == [
        ("training_by_env_steps/controller_return_mean", 160, 0.5),
        ("evaluation_by_env_steps/score_mean", 160, 1.5),
    ]
    assert events(folder.tensorboard)[0].file_version == "brain.Event:2"


def test_a_hierarchical_run_has_a_dozen_charts(tiny_run):
    tied = {"update/controller_halves_cosine"}  # this run's controllers are tied: their gradient is 0
    assert tied | {tag for tag, _, _ in scalars(tiny_run / "tensorboard")} == {
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
    curves = [(tag, step) for tag, step, _ in scalars(tiny_run / "tensorboard" / "env_steps")]
    assert {tag.partition("/")[0] for tag, _ in curves} == {"evaluation_by_env_steps", "training_by_env_steps"}
    assert [step for tag, step in curves if tag == "training_by_env_steps/score_mean"] == [160, 320, 480, 640]


def test_hyperparameters_are_written_once_and_a_resumed_run_hides_what_it_does_again(run_copy):
    import shes

    shes.resume(run_copy, generations=5)
    starts = [event.step for event in events(run_copy / "tensorboard" / "env_steps") if event.HasField("session_log")]
    assert starts == [641]
    found = hyperparameters(run_copy / "tensorboard")
    assert len(found) == 1
    assert (found[0]["sigma"].number_value, found[0]["env"].string_value) == (0.07, "point-gather")
    assert found[0]["hidden"].string_value == "[4]"
    assert found[0]["seed"].number_value == 5


def test_a_run_that_goes_on_hides_later_events_and_keeps_earlier_files(folder):
    """Even within a second, which is all that the library's file names hold."""
    for generation in (0, 1):
        records = Records(folder, generation, 100 * generation)
        row = {"generation": generation + 1, "env_steps": 100 * generation + 100, "score_mean": generation + 0.5}
        records.add("progress", row)
        records.close()
    for place, group, unit in (
        (folder.tensorboard, "training", 1),
        (folder.tensorboard / "env_steps", "training_by_env_steps", 100),
    ):
        assert len(list(place.glob("events*"))) == 2
        assert sorted(scalars(place)) == [(f"{group}/score_mean", unit, 0.5), (f"{group}/score_mean", 2 * unit, 1.5)]
        starts = [e for e in events(place) if e.session_log.status == SessionLog.START]
        assert [event.step for event in starts] == [unit + 1]


def test_events_need_no_thread(folder):
    before = threading.active_count()
    records = Records(folder, 0)
    records.add("progress", {"generation": 1, "score_mean": 0.5})
    assert threading.active_count() == before
    records.close()


def test_a_full_disk_is_told_at_once(folder, monkeypatch):
    records = Records(folder, 0)

    def full(*arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("tensorboardX.record_writer.RecordWriter.write", full)
    with pytest.raises(StorageError, match=r"cannot write .*tensorboard: the disk is full"):
        records.add("progress", {"generation": 1, "score_mean": 0.5})
    records.close()


def test_the_tables_of_a_run_have_the_columns_of_the_design(tiny_run):
    with (tiny_run / "progress.csv").open(newline="") as file:
        progress = next(csv.reader(file))
    with (tiny_run / "evaluation.csv").open(newline="") as file:
        evaluation = next(csv.reader(file))
    assert progress[:8] == [
        "generation",
        "env_steps",
        "wall_time_s",
        "env_steps_per_s",
        "controller_return_mean",
        "controller_return_max",
        "primitive_return_mean",
        "primitive_return_max",
    ]
    assert evaluation[:6] == ["generation", "env_steps", "wall_time_s", "episodes", "score_mean", "score_std"]
    assert {"return_mean", "success_rate"} <= set(evaluation)
    assert read_csv(tiny_run / "progress.csv")["generation"] == [1, 2, 3, 4]
    assert read_csv(tiny_run / "evaluation.csv")["generation"] == [1, 2, 4]
    assert read_csv(tiny_run / "progress.csv")["env_steps"] == [160, 320, 480, 640]


@pytest.mark.parametrize("column", ["wall_time_s", "process_time_s"])
def test_time_goes_on_after_a_resume(run_copy, column):
    import shes

    shes.resume(run_copy, generations=6)
    times = read_csv(run_copy / "progress.csv")[column]
    assert len(times) == 6
    assert times == sorted(times)


def test_processor_time_is_that_of_the_run_and_not_of_waiting(tmp_path, monkeypatch):
    """Everything of a run with the serial backend is in its process, whose time does not pass while it waits."""
    finish = Session.add

    def slow(self, *arguments):
        sleep(0.3)
        finish(self, *arguments)

    monkeypatch.setattr(Session, "add", slow)
    path = runs.train_tiny(tmp_path / "run")
    progress, evaluation = (read_csv(path / f"{name}.csv") for name in ("progress", "evaluation"))
    assert progress["wall_time_s"][-1] - progress["process_time_s"][-1] > 1.0  # four generations
    assert progress["process_time_s"][-1] > 0.01
    assert 0 < evaluation["process_time_s"][0] <= progress["process_time_s"][-1]


def test_a_table_without_processor_time_goes_on_without(run_copy):
    import shes

    for name in ("progress.csv", "evaluation.csv"):
        lines = (run_copy / name).read_text().splitlines()
        assert lines[0].endswith(",process_time_s")
        (run_copy / name).write_text("".join(f"{line.rpartition(',')[0]}\n" for line in lines))
    shes.resume(run_copy, generations=6)
    assert read_process_time(run_copy / "progress.csv") == read_csv(run_copy / "progress.csv")["wall_time_s"][-1]


def test_rows_that_are_missing_before_a_checkpoint_are_refused(run_copy):
    import shes

    progress = run_copy / "progress.csv"
    text = progress.read_text()
    progress.write_text("".join(text.splitlines(keepends=True)[:-2]))
    with pytest.raises(RunFolderError, match=r"progress\.csv ends with generation 2, but the run has made 4: rows are"):
        shes.resume(run_copy, generations=5)
    progress.write_text("")  # the way out that the message names
    shes.resume(run_copy, generations=5)
    assert read_csv(progress)["generation"] == [5]


def test_a_column_that_the_run_does_not_write_is_refused(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("generation,x,note\n1,0.5,0\n")
    with pytest.raises(RunFolderError, match=r"a\.csv has columns that this run does not write: note\. Remove them"):
        CsvTable(path, 1).add({"generation": 2, "x": 0.25})
    assert path.read_text() == "generation,x,note\n1,0.5,0\n"


def test_the_time_of_a_run_is_that_of_its_last_whole_row(run_copy):
    progress = run_copy / "progress.csv"
    times = {name: read_csv(progress)[name][-1] for name in ("wall_time_s", "process_time_s")}
    text = progress.read_text()
    row = text.splitlines()[-1]
    for cut in ("", "5,1200", row[: row.rindex(",")], row[: row.rindex(",") + 1]):  # as after a crash
        progress.write_text(text + cut)
        assert read_process_time(progress) == times["process_time_s"]
        assert trained_minutes(RunFolder(run_copy)) == times["wall_time_s"] / 60
    progress.write_text("")
    assert trained_minutes(RunFolder(run_copy)) == 0.0


# Runs.


@pytest.fixture(scope="module")
def in_turns(tmp_path_factory):
    """A run whose levels are perturbed in turns."""
    return runs.train_tiny(tmp_path_factory.mktemp("turns") / "run", "point-maze", perturbation="one_to_many")


def test_a_level_that_was_not_perturbed_has_no_gradient(in_turns):
    table = read_csv(in_turns / "progress.csv")
    for name in ("gradient_norm", "halves_cosine", "update_ratio"):
        assert [math.isnan(value) for value in table[f"controller_{name}"]] == [False, True, False, True]
        assert [math.isnan(value) for value in table[f"primitive_{name}"]] == [True, False, True, False]
    assert not any(math.isnan(value) for name in table if "theta" in name for value in table[name])


def test_tensorboard_gets_no_number_that_is_none(in_turns):
    found = scalars(in_turns / "tensorboard")
    assert all(math.isfinite(value) for _, _, value in found)
    assert {step for tag, step, _ in found if tag == "update/controller_update_ratio"} == {1, 3}
    assert {step for tag, step, _ in found if tag == "update/primitive_update_ratio"} == {2, 4}
    assert {step for tag, step, _ in found if tag == "training/score_mean"} == {1, 2, 3, 4}


def test_the_time_of_an_evaluation_is_in_its_generations_row(tiny_run):
    """It is no part of the roll-out's time, nor of the steps per second."""
    table = read_csv(tiny_run / "progress.csv")
    assert [seconds > 0 for seconds in table["evaluation_s"]] == [True, True, False, True]
    assert table["evaluation_s"][2] == 0
    assert table["wall_time_s"][-1] >= sum(table["rollout_s"]) + sum(table["update_s"]) + sum(
        table["evaluation_s"][:-1]
    )
