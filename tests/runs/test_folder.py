"""The run folder: exactly one run in it, a record of what it is, and its state."""

import errno
import fcntl
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

import shes
from shes.errors import ConfigError, RunFolderError
from shes.runs.folder import RunFolder
from shes.runs.listings import run_state
from tests.e2e import runs


def test_a_run_folder_has_the_files_of_the_design(tiny_run):
    files = {".lock", "checkpoints", "config.json", "evaluation.csv", "log.txt", "progress.csv", "tensorboard"}
    assert {path.name for path in tiny_run.iterdir()} == files
    names = {path.name for path in (tiny_run / "checkpoints").iterdir()}
    assert names == {"best.npz", "last.npz", *(f"generation_{number:06d}.npz" for number in (0, 2, 4))}


def test_the_record_says_what_the_run_is_and_what_made_it(run_copy, monkeypatch):
    before = RunFolder.open(run_copy).read_config()
    monkeypatch.setattr("sys.argv", ["/here/bin/shes", "resume"])
    shes.resume(run_copy, generations=5)
    monkeypatch.setattr("sys.argv", ["/here/experiments/__main__.py", "fig3"])
    shes.resume(run_copy, generations=6, keep_checkpoints=3)
    record = json.loads((run_copy / "config.json").read_text())
    assert record["versions"]["numpy"] == np.__version__
    assert record["machine"]["processor"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", record["started"])
    commands = [entry["command"] for entry in record["resumed"]]  # no path of this machine
    assert commands == [["shes", "resume"], ["python", "-m", "experiments", "fig3"]]
    assert record["git_commit"] is None or re.fullmatch(r"[0-9a-f]{40}", record["git_commit"])
    assert [entry["generation"] for entry in record["resumed"]] == [4, 5]
    assert all("versions" in entry for entry in record["resumed"])
    assert RunFolder.open(run_copy).read_config() == before.having(generations=6, keep_checkpoints=3)


def test_a_new_folder_has_the_runs_name_and_is_never_given_twice(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    paths = [runs.train_tiny(None, minutes=1e-9) for _ in range(3)]
    assert all(re.fullmatch(r"runs/point-gather-smoke-seed5-\d{8}-\d{6}(-\d)?", str(path)) for path in paths)
    assert len(set(paths)) == 3


def test_two_processes_never_run_in_one_folder(tiny_run, run_copy):
    """The lock goes with the process that holds it, so that a killed run leaves none."""
    with RunFolder.open(run_copy).lock():
        with pytest.raises(RunFolderError, match=r"is in use: another process trains in it\. Wait for"):
            shes.resume(run_copy, generations=5)
        assert shes.load(run_copy)  # looking is allowed
    assert runs.differences(tiny_run, run_copy) == []
    shes.resume(run_copy, generations=5)


def test_a_lock_that_is_held_for_a_moment_is_waited_for(run_copy, monkeypatch):
    """A list of runs takes it, too."""
    with (run_copy / ".lock").open() as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        monkeypatch.setattr("shes.runs.folder.sleep", lambda _: fcntl.flock(file, fcntl.LOCK_UN))
        with RunFolder.open(run_copy).lock():
            assert run_state(RunFolder.open(run_copy)).state == "running"


def test_a_file_system_without_locks_does_not_make_a_run_in_use(run_copy, monkeypatch):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", no_locks)
    assert run_state(RunFolder.open(run_copy)).state == "finished"
    assert shes.resume(run_copy, generations=5).generation == 5


# What is a run folder; other mistakes are in tests/e2e/test_bad_input.py.


@pytest.mark.parametrize("name", ["progress.csv", "evaluation.csv", "checkpoints/last.npz"])
def test_parts_of_a_run_without_a_record_are_not_overwritten(tmp_path, name):
    part = tmp_path / "run" / name
    part.parent.mkdir(parents=True)
    part.write_text("mine")
    with pytest.raises(RunFolderError, match=rf"holds {name} but no config\.json: .*Choose another folder with --out"):
        runs.train_tiny(tmp_path / "run")
    assert part.read_text() == "mine"


def test_a_run_may_begin_where_other_files_or_a_stopped_one_are(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with RunFolder.create(tmp_path).lock():
        pass
    (tmp_path / "checkpoints" / "generation_000000.npz").write_bytes(b"PK")
    assert runs.train_tiny(tmp_path, generations=1) == tmp_path


@pytest.mark.parametrize("left", [Path.unlink, lambda path: path.unlink() or path.mkdir()], ids=["none", "a folder"])
def test_a_run_that_lost_its_record_is_no_run_folder(run_copy, left):
    left(run_copy / "config.json")
    assert RunFolder.below(run_copy.parent) == []
    with pytest.raises(RunFolderError, match=r"is not a run folder: no config\.json is in it .*\. Give the folder"):
        shes.resume(run_copy)


@pytest.mark.parametrize("run", [None, "", b"runs/a"])
def test_what_can_be_no_run_is_refused_by_its_value(run):
    with pytest.raises(ConfigError, match=rf"a run must be the path .*, got {re.escape(repr(run))}\."):
        shes.load(run)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "cannot be read"),
        ('{"format": 2, "config": []}', "is damaged: "),
        ('{"format": 2, "config": {"run": 1}}', "is damaged: "),
        ('{"format": 2, "config": {}, "versions": []}', "is damaged: one of resumed, config, versions, "),
        ('{"format": 2, "config": {}, "resumed": [{"command": null}]}', "is damaged: one of resumed, "),
        ('{"format": 2, "config": {}, "resumed": [1]}', "is damaged: one of resumed, config, versions, "),
    ],
    ids=["too deep", "a list", "a number", "versions", "command", "resumed"],
)
def test_a_record_that_no_run_writes_is_one_clear_error(run_copy, text, message):
    path = run_copy / "config.json"
    path.write_text(text)
    for go_on in (shes.resume, shes.load):
        with pytest.raises(RunFolderError, match=rf"config\.json {message}"):
            go_on(run_copy)
    assert run_state(RunFolder(run_copy)).state == "unreadable"
    assert path.read_text() == text
