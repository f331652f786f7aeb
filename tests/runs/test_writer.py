"""The thread that writes a run's files: in order, beside the caller's work, of each checkpoint only the newest."""

import errno
import gc
import os
import threading
import weakref
from dataclasses import replace
from pathlib import Path

import pytest

from shes.errors import StorageError
from shes.runs import writer as writers
from shes.runs.checkpoint import load_checkpoint, save_checkpoint
from shes.runs.folder import RunFolder
from shes.runs.tables import Records
from shes.runs.writer import RunWriter
from tests.runs.test_checkpoint import fail, make


class Tables:
    """Stands for the tables of a run; `written` has what is written, in order."""

    def __init__(self, written=()):
        self.written = list(written)

    def add(self, table, row):
        self.written.append((table, row["generation"]))

    def flush(self):
        pass


@pytest.fixture
def slow(monkeypatch):
    """Return tables, and an event without which no checkpoint is written."""
    tables, may_go_on = Tables(), threading.Event()

    def save(path, checkpoint):
        may_go_on.wait(10)
        tables.written.append((path.name, checkpoint.generation))

    monkeypatch.setattr(writers, "save_checkpoint", save)
    return tables, may_go_on


def test_rows_and_checkpoints_are_written_in_order_and_nobody_waits_for_them(slow, tmp_path):
    tables, may_go_on = slow
    writer = RunWriter(tables)
    writer.add_row("evaluation", {"generation": 1})
    writer.save(tmp_path / "best", make(1))
    writer.add_row("progress", {"generation": 2})
    writer.save(tmp_path / "2", make(2))
    assert all(name == "evaluation" for name, _ in tables.written)  # no call has waited for a file
    may_go_on.set()
    writer.close()
    assert tables.written == [("evaluation", 1), ("best", 1), ("progress", 2), ("2", 2)]


def test_the_rows_before_a_checkpoint_are_on_the_disk_before_it(tmp_path, monkeypatch):
    """A machine that goes down loses what is not: a checkpoint whose rows are missing could not go on."""
    synced = []

    def sync(number):
        name = Path(f"/proc/self/fd/{number}").readlink().name.lstrip(".").partition(".")[0]
        if name != "events":
            synced.append(name)

    folder = RunFolder(tmp_path)
    folder.checkpoints.mkdir()
    records = Records(folder, 0)
    monkeypatch.setattr(os, "fsync", sync)
    writer = RunWriter(records)
    for generation in (1, 2):
        writer.add_row("progress", {"generation": generation})
        writer.save(folder.checkpoint_path("last"), make(generation))
        writer.wait()
    writer.close()
    records.close()
    assert synced == ["progress", "last"] * 2


def test_a_checkpoint_that_a_newer_one_replaces_is_not_written(slow, tmp_path):
    tables, may_go_on = slow
    writer = RunWriter(tables)
    writer.save(tmp_path / "best", make(1))  # the thread waits here
    for generation in (1, 2, 3):
        writer.add_row("progress", {"generation": generation})
        writer.save(tmp_path / "last", make(generation))
    may_go_on.set()
    writer.close()
    rows = [("progress", generation) for generation in (1, 2, 3)]
    assert tables.written == [("best", 1), *rows, ("last", 3)]  # `last` after all of its rows


def test_waiting_ends_when_all_is_written(slow, tmp_path):
    tables, may_go_on = slow
    writer = RunWriter(tables)
    writer.save(tmp_path / "last", make(1))
    threading.Timer(0.05, may_go_on.set).start()
    writer.wait()
    assert tables.written == [("last", 1)]
    writer.close()


def test_a_checkpoint_that_is_written_is_not_kept_in_memory(tmp_path):
    writer, kept = RunWriter(Tables()), []
    for generation in (1, 2):
        checkpoint = make(generation)
        kept.append(weakref.ref(checkpoint))
        writer.save(tmp_path / f"{generation}.npz", checkpoint)
    del checkpoint
    writer.wait()
    gc.collect()
    assert [each() for each in kept] == [None, None]
    writer.close()


@pytest.mark.parametrize("then", ["save", "add_row", "wait", "close"])
def test_a_write_that_failed_is_told_at_the_next_call_and_nothing_follows_it(tmp_path, monkeypatch, then):
    tables, done = Tables(), threading.Event()
    writer = RunWriter(tables)
    monkeypatch.setattr("os.fsync", fail(errno.ENOSPC))
    writer.save(tmp_path / "last.npz", make(1))
    writer.add_row("progress", {"generation": 2})
    writer._waiting.put(done.set)  # not reached: after an error nothing is written
    more = {"save": (tmp_path / "last.npz", make(2)), "add_row": ("progress", {"generation": 3})}.get(then, ())
    if then in ("save", "add_row"):
        while writer._error is None:
            done.wait(0.01)
    with pytest.raises(StorageError, match="the disk is full"):
        getattr(writer, then)(*more)
    writer.close()
    assert tables.written == []
    assert list(tmp_path.iterdir()) == []


def test_a_checkpoint_says_whether_it_owes_an_evaluation(tmp_path):
    for owes in (True, False):
        save_checkpoint(tmp_path / "a.npz", replace(make(), owes_evaluation=owes))
        for with_state in (True, False):
            assert load_checkpoint(tmp_path / "a.npz", with_state=with_state).owes_evaluation is owes
