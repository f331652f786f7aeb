"""Tables and TensorBoard events: numbers are bit-identical when read back, and rows whole; nothing is written twice."""

import math
import struct

import numpy as np
import pytest
from tensorboardX.proto.event_pb2 import Event, SessionLog
from tensorboardX.proto.plugin_hparams_pb2 import HParamsPluginData

import shes
from shes.errors import RunFolderError
from shes.runs.tables import CsvTable, read_csv
from tests.e2e import runs
from tests.messages import raises

VALUES = [0.1 + 0.2, 1e-310, -0.0, 1.7976931348623157e308, math.inf, math.nan, 2.0**53 + 2]


def fill(path, last, first=9, keep=0):
    table = CsvTable(path, keep)
    for generation in range(first, last + 1):
        table.add({"generation": generation, "x": generation / 3})
    return path.read_text()


def test_numbers_read_back_bit_identically(tmp_path):
    table = CsvTable(tmp_path / "a.csv", 0)
    for generation, value in enumerate(VALUES, 1):
        table.add({"generation": generation, "x": value})
    assert read_csv(tmp_path / "a.csv")["x"].tobytes() == np.array(VALUES).tobytes()
    assert read_csv(tmp_path / "b.csv") == {}


def test_a_table_cut_anywhere_goes_on_as_if_nothing_had_happened(tmp_path):
    """Half a header counts as none, half a row is not read, and rows after the checkpoint are dropped."""
    path = tmp_path / "a.csv"
    longer, whole = fill(path, 12), fill(path, 10)
    assert whole.startswith("generation,x\n9,3.0\n10,3.333")
    for length in range(len(longer) + 1):
        path.write_text(longer[:length])
        rows = range(9, 9 + max(0, longer[:length].count("\n") - 1))
        found = {name: values.tolist() for name, values in read_csv(path).items()}
        assert found == ({"generation": [*rows], "x": [row / 3 for row in rows]} if rows else {})
        reached = min(10, 8 + len(rows))
        assert fill(path, 10, first=reached + 1, keep=reached) == whole


@pytest.mark.parametrize(
    "content",
    [b"\xff\xfe\x00" * 50, b"generation,x\n" + b"9" * 5000 + b",1\n", b'generation,x\n1,"' + b"a" * 200_000 + b'"\n',
     b"generation,x\n1,abc\n2,0\n"],
    ids=["binary", "endless number", "endless field", "words"],
)  # fmt: skip
def test_a_damaged_table_is_one_clear_error_and_kept(tmp_path, content):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with raises(RunFolderError, "a.csv cannot be read as a table of numbers: ... . Restore it") as error:
        CsvTable(path, 4)
    assert len(str(error.value)) < 400
    assert path.read_bytes() == content


REFUSED = {
    "rows are missing": ("progress", lambda lines: lines[:-2], "ends with generation 2, but the run has made 4: rows"),
    "a row is cut": (
        "evaluation",
        lambda lines: [*lines[:-1], ",".join(lines[-1].split(",")[:3])],
        "row 3 below the header has 3 values for ... columns.",
    ),
    "the file": ("evaluation", None, "cannot be read ... No such file ... Restore it ... let it be an empty file"),
    "a column": ("progress", lambda lines: [line + ",1" for line in lines], "not write: 1"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_broken_table_is_refused_and_an_empty_one_goes_on(run_copy, case):
    name, damage, message = REFUSED[case]
    path = run_copy / f"{name}.csv"
    lines = path.read_text().splitlines()
    path.unlink()
    if damage is not None:
        path.write_text("\n".join(damage(lines)) + "\n")
    with raises(RunFolderError, f"{name}.csv ... {message}"):
        shes.resume(run_copy, generations=5)
    path.write_text("")  # the way out that the message names
    assert shes.resume(run_copy, generations=6).generation == 6
    assert path.read_text().startswith("generation,")


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


def test_a_hierarchical_run_has_a_dozen_finite_charts(tmp_path):
    path = runs.train_tiny(tmp_path / "run", "point-maze", perturbation="one_to_many")
    found = {}
    for event in events(path / "tensorboard"):
        for value in event.summary.value:
            if not value.HasField("metadata"):
                found.setdefault(value.tag, {})[event.step] = value.simple_value
    levels = [f"{level}_{name}" for level in ("controller", "primitive") for name in ("halves_cosine", "update_ratio")]
    assert found.keys() == {
        *(f"evaluation/{name}" for name in ("return_mean", "score_mean", "success_rate")),
        *(f"training/{name}" for name in ("controller_return_mean", "primitive_return_mean", "score_mean")),
        *(f"update/{name}" for name in levels),
        "episodes/episode_steps_mean",
        "speed/env_steps_per_s",
    }
    assert all(math.isfinite(value) for chart in found.values() for value in chart.values())
    table = read_csv(path / "progress.csv")
    expected = dict(zip(table["generation"], table["controller_return_mean"], strict=True))
    assert found["training/controller_return_mean"] == pytest.approx(expected)
    # The levels are perturbed in turns: a level that was not has no gradient.
    assert found["update/controller_update_ratio"].keys() == {1, 3}
    assert [math.isnan(value) for value in table["primitive_gradient_norm"]] == [True, False, True, False]


def test_a_resume_hides_charts_that_it_repeats(run_copy, monkeypatch):
    monkeypatch.setattr("time.time", lambda: 2e9)  # two parts may begin within a second
    for generation in (5, 6):
        shes.resume(run_copy, generations=generation)
    assert len(list((run_copy / "tensorboard").iterdir())) == 3
    found = events(run_copy / "tensorboard")
    assert [event.step for event in found if event.session_log.status == SessionLog.START] == [5, 6]
    contents = [value.metadata.plugin_data.content for event in found for value in event.summary.value]
    sessions = [HParamsPluginData.FromString(content) for content in contents if content]
    (written,) = (each.session_start_info.hparams for each in sessions if each.HasField("session_start_info"))
    assert (written["sigma"].number_value, written["env"].string_value) == (0.07, "point-gather")
    assert (written["hidden"].string_value, written["seed"].number_value) == ("[4]", 5)


def test_times_go_on_from_the_last_whole_row_with_evaluations(run_copy):
    progress = run_copy / "progress.csv"
    *rows, last = progress.read_text().splitlines()
    cells = dict(zip(rows[0].split(","), last.split(","), strict=True))
    cells |= {"wall_time_s": "7200", "process_time_s": "3600"}
    progress.write_text("\n".join([*rows, ",".join(cells.values()), "5,12"]))  # the last row is cut off
    shes.resume(run_copy, generations=6)
    table, evaluations = read_csv(progress), read_csv(run_copy / "evaluation.csv")
    assert table["generation"].tolist() == [1, 2, 3, 4, 5, 6]
    for name in ("wall_time_s", "process_time_s"):
        assert (np.diff(table[name]) >= 0).all()
    assert table["wall_time_s"][4] > 7200
    assert [seconds > 0 for seconds in table["evaluation_s"]] == [True, True, False, True, False, True]
    assert evaluations["process_time_s"][0] > 0
    assert 3600 < evaluations["process_time_s"][-1] <= table["process_time_s"][-1] < 7200
