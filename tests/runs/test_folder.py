"""The run folder: exactly one run in it, and a record of what it is."""

import errno
import fcntl
import json
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import shes
from shes.errors import CheckpointError, ConfigError, RunFolderError
from shes.runs.checkpoint import save_checkpoint
from shes.runs.folder import RunFolder, new_folder
from shes.runs.state import run_state
from shes.training.make_config import make_config
from tests.e2e import runs

CONFIG = make_config("point-gather", "smoke")


def test_a_run_folder_has_the_files_of_the_design(tiny_run):
    assert {path.name for path in tiny_run.iterdir()} == {
        ".lock",
        "checkpoints",
        "config.json",
        "evaluation.csv",
        "log.txt",
        "progress.csv",
        "tensorboard",
    }
    names = {path.name for path in (tiny_run / "checkpoints").iterdir()}
    assert names == {"best.npz", "last.npz", *(f"generation_{number:06d}.npz" for number in (0, 2, 4))}


def test_the_record_says_what_the_run_is_and_what_made_it(tiny_run):
    record = json.loads((tiny_run / "config.json").read_text())
    assert record["config"]["run"]["env"] == "point-gather"
    assert record["config"]["networks"]["hidden"] == [4]
    assert record["versions"]["numpy"] == np.__version__
    assert set(record["versions"]) == {"python", "shes", "mujoco", "numpy"}
    assert record["machine"]["processor"]
    assert record["machine"]["cores"] >= 1
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\+00:00", record["started"])
    assert record["command"] == [Path(sys.argv[0]).name, *sys.argv[1:]]  # no path of this machine
    assert record["git_commit"] is None or re.fullmatch(r"[0-9a-f]{40}", record["git_commit"])
    assert record["resumed"] == []


def test_the_record_gives_back_the_settings(tiny_run):
    expected = make_config("point-gather", "smoke", {name: runs.TINY[name] for name in runs.TINY if name != "preset"})
    assert RunFolder.open(tiny_run).read_config() == expected


def test_every_resume_is_recorded(run_copy):
    shes.resume(run_copy, generations=5)
    shes.resume(run_copy, generations=6, keep_checkpoints=3)
    record = json.loads((run_copy / "config.json").read_text())
    assert [entry["generation"] for entry in record["resumed"]] == [4, 5]
    assert all("versions" in entry for entry in record["resumed"])
    assert (record["config"]["run"]["generations"], record["config"]["evaluation"]["keep_checkpoints"]) == (6, 3)


def test_a_new_folder_is_named_after_run_and_time_and_is_never_given_twice(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    paths = [new_folder(CONFIG) for _ in range(3)]
    assert all(re.fullmatch(r"runs/point-gather-smoke-seed1-\d{8}-\d{6}(-\d)?", str(path)) for path in paths)
    assert len(set(paths)) == 3
    assert all(path.is_dir() for path in paths)


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


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_does_not_make_a_run_in_use(run_copy, monkeypatch, number):
    def no_locks(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", no_locks)
    assert run_state(RunFolder.open(run_copy)).state == "finished"
    shes.resume(run_copy, generations=5)
    assert run_state(RunFolder.open(run_copy)).generation == 5


@pytest.mark.parametrize("name", ["progress.csv", "evaluation.csv", "checkpoints/last.npz"])
def test_parts_of_a_run_without_a_record_are_not_overwritten(run_copy, name):
    (run_copy / "config.json").unlink()
    (run_copy / ".lock").unlink()
    for part in ("progress.csv", "evaluation.csv", *run_copy.glob("checkpoints/*")):
        if part != name and str(part) != str(run_copy / name):
            (run_copy / part).unlink()
    before = (run_copy / name).read_bytes()
    with pytest.raises(RunFolderError, match=rf"holds {name} but no config\.json: .*Choose another folder with --out"):
        runs.train_tiny(run_copy)
    assert (run_copy / name).read_bytes() == before


def test_a_folder_with_other_things_may_become_a_run_folder(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    folder = RunFolder.create(tmp_path)
    assert folder.checkpoints.is_dir()
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_a_folder_is_a_run_only_with_its_record(tmp_path):
    RunFolder.create(tmp_path)
    with pytest.raises(RunFolderError, match=r"is not a run folder: it has no config\.json"):
        RunFolder.open(tmp_path)
    with RunFolder(tmp_path).lock():
        pass
    with pytest.raises(RunFolderError, match=r"was stopped before it began\. Begin it again by the same command"):
        RunFolder.open(tmp_path)
    RunFolder.create(tmp_path).record_start(CONFIG, {})
    assert RunFolder.open(tmp_path).read_config() == CONFIG
    with pytest.raises(RunFolderError, match=r"already holds a run\. Go on with it by `shes resume .*--out"):
        RunFolder.create(tmp_path)


@pytest.mark.parametrize("name", ["last", "best", "0", "4"])
def test_a_checkpoint_is_found_by_name_or_generation(tiny_run, name):
    checkpoint = RunFolder.open(tiny_run).load(name)
    if name.isdecimal():
        assert checkpoint.generation == int(name)


def test_a_checkpoint_of_other_settings_is_refused_by_naming_them(run_copy):
    folder = RunFolder.open(run_copy)
    checkpoint = folder.load("last")
    checkpoint.numbers["sigma"] = 9.0
    save_checkpoint(folder.checkpoint_path("last"), checkpoint)
    with pytest.raises(
        CheckpointError, match=r"last\.npz is of another run: sigma is 9\.0, not .*Put back the checkpoint"
    ):
        folder.load("last")


def test_a_setting_out_of_range_is_refused_by_naming_the_file(run_copy):
    config = run_copy / "config.json"
    record = json.loads(config.read_text())
    record["config"]["episodes"]["horizon"] = -1
    config.write_text(json.dumps(record))
    with pytest.raises(ConfigError, match=r"config\.json: horizon must be a whole number of at least 1, got -1"):
        RunFolder.open(run_copy).read_config()


@pytest.mark.parametrize("wrong", [{"hidden": "x"}, {"env": 5}, {"env": ["x"]}, {"hidden": ["x"]}])
def test_settings_of_a_wrong_type_are_refused(run_copy, wrong):
    config = run_copy / "config.json"
    record = json.loads(config.read_text())
    record["config"]["run" if "env" in wrong else "networks"] |= wrong
    config.write_text(json.dumps(record))
    with pytest.raises((RunFolderError, ConfigError), match=r"config\.json"):
        RunFolder.open(run_copy).read_config()
