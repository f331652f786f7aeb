"""What the user can get wrong: a message with value, choices and fix, the exit code of the design, and nothing lost.

Values of settings are in runs/test_config.py, those of other arguments in cli/test_commands.py.
"""

import ctypes
import errno
import gc
import json
import os
import resource
import shutil
import sys
from contextlib import contextmanager

import numpy as np
import pytest

import shes
from shes.cli import main
from shes.errors import ShesError, StorageError
from shes.evolution.state import from_arrays
from shes.runs.checkpoint import load_checkpoint
from tests.e2e import runs
from tests.messages import check_message, raises

MENDABLE, FAILED = 2, 1
TRAIN = ["train", "point-gather", *runs.flags(**runs.TINY)]


@pytest.fixture
def refused(capsys, tmp_path, monkeypatch):
    """Return a function that runs a command line that must fail with a message."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words, message, code=MENDABLE):
        found = main([str(word) for word in words])
        out, err = capsys.readouterr()
        assert found == code
        assert "Traceback" not in out + err
        check_message(" ".join(word for word in err.split() if not set(word) <= set("|+-─│╭╮╰╯")), message)

    return run


def contents(folder):
    """Return the bytes of every file of a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# Command lines.

LINES = {
    "trian x": "unknown command 'trian'. Did you mean 'train'? Known: train, ... shes --help",
    "train --preset smoke": "a run needs an environment: shes train ENV, or shes train --like RUN for that of a run",
    "train ant-gather --mirrored": "Missing value for argument '--mirrored'",
    "train ant-gather --population 8": "Unrecognized options: --population, 8 ... meant: ... --population-size INT",
    "train ant-gather --sigma abc": "Error parsing --sigma: could not convert string to float: 'abc'",
    "train ant-gather --hidden 8 x": "Error parsing --hidden: ... ['8', 'x']",
    "train ant-gather --minimum-goal-distance=no": "Unrecognized options: no",
    "--sigma 1 train": "unknown flag --sigma before the command. See `shes --help`",
    "train --import": "--import needs a value: --import MODULE",
    "envs --import there_is_none": "there is no module 'there_is_none'. Is it installed or on PYTHONPATH?",
    "envs --import mine.py": "no module 'mine' ... not a file: --import mine.",
    "bench rolout": "nvalid choice 'rolout' ... rollout",
    "train pint-gather": "environment ... Did you mean 'point-gather'? Known: point-gather, ant- ... `shes envs`",
    "train ant-gather --sigma nan": "Error: sigma must be a number greater than 0, got nan. Set --sigma",
    "train ant-gather --primitive gone": "gone does not exist. Give the folder that `shes train` pr",
    "bench rollout ant-gather --seconds -1": "seconds must be a number of at least 0, got -1.0. Set --seconds",
    "resume": "Missing from shes resume: RUN The run folder",
    **{f"{each}": f"{each} needs at least one run folder: shes {each} RUN" for each in ("plot", "report")},
    "render": "render needs at least one run and one checkpoint: shes render RUN",
    **{f"{each} gone": "gone does not exist. Give the folder" for each in ("resume", "plot", "report")},
    "list gone": "Error: gone is not a folder. Give one with runs below it, or none for those below runs/.",
    **{f"{each} .": "no config.json is in it or up to 4 levels bel" for each in ("resume", "evaluate", "plot")},
}


@pytest.mark.parametrize("line", LINES)
def test_a_wrong_command_line_is_refused_with_its_fix(line, refused, tmp_path):
    refused(*line.split(), message=LINES[line])
    assert list(tmp_path.iterdir()) == []  # nothing was begun


# Run folders: `copy` is of a finished run, and `file` is a file.

THERE = "best, generation_000000, generation_000002, generation_000004, last. Choose another; to resume from one"
IN_FOLDERS = {
    "train point-gather --preset smoke --out copy": "copy already holds a run. ... `shes resume ... --out",
    "train point-gather --preset smoke --out file": "file is a file, not a folder. Choose another path with --out",
    "train point-gather --preset smoke --out file/run": "a part of the path is a file ... --out",
    "resume copy": "has made 4 generations, ... To go on: shes resume copy --generations 8",
    "resume copy --sigma 1": "--sigma would change the numbers of the run; resume takes --backend, ... --workers.",
    "evaluate copy --checkpoint 77": f"there is no checkpoint ... generation_000077.npz. There are: {THERE}",
    "evaluate copy --checkpoint ../x": "there is no checkpoint",
    "evaluate copy --workers -1": "num_workers must be ... got -1. Set --workers",
}


@pytest.mark.parametrize("line", IN_FOLDERS)
def test_what_does_not_fit_a_folder_is_refused_and_harms_nothing(line, refused, run_copy, tmp_path):
    (tmp_path / "file").write_text("mine")
    before = contents(tmp_path)
    refused(*line.split(), message=IN_FOLDERS[line])
    assert contents(tmp_path) == before


# Checkpoints.


def test_a_damaged_checkpoint_is_refused_and_can_be_replaced(refused, run_copy, tiny_run):
    checkpoints = run_copy / "checkpoints"
    last = checkpoints / "last.npz"
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2])
    before = contents(run_copy)
    message = "last.npz is not a whole SHES checkpoint ... --checkpoint last, best or a gener ... copy it over last.npz"
    refused("resume", run_copy, "--generations", "6", message=message)
    assert contents(run_copy) == before
    last.unlink()
    refused("resume", run_copy, message="there is no checkpoint ... last.npz. ... copy it to last.npz")
    shutil.copy(checkpoints / "generation_000002.npz", last)
    shes.resume(run_copy)
    assert runs.differences(tiny_run, run_copy) == []


def test_a_checkpoint_with_nan_is_refused(refused, run_copy):
    with np.load(path := run_copy / "checkpoints" / "best.npz") as file:
        arrays = dict(file)
    arrays["primitive/theta"][-1] = np.nan
    np.savez(path, **arrays)
    message = "best.npz holds NaN or infinity in primitive/theta. Take an earlier checkpoint."
    refused("evaluate", run_copy, message=message)


def test_a_checkpoint_of_another_run_is_refused(refused, run_copy, tmp_path):
    other = runs.train_tiny(tmp_path / "other", sigma=0.5, seed=6)
    for name in ("last", "best"):
        shutil.copy(other / "checkpoints" / f"{name}.npz", run_copy / "checkpoints" / f"{name}.npz")
    message = ".npz is of another run: seed is 6, not 5, sigma is 0.5, not ... Put back the checkpoint"
    refused("resume", run_copy, "--generations", "6", message=f"last{message}")
    refused("evaluate", run_copy, message=f"best{message}")


@pytest.mark.parametrize("level", ["controller", "primitive"])
def test_a_policy_that_returns_nan_ends_a_run_that_stays_intact(refused, run_copy, monkeypatch, level):
    def damaged(arrays):
        state = from_arrays(arrays)
        next(own for own in state.levels if own.name == level).theta[-1] = np.nan
        return state

    monkeypatch.setattr("shes.evolution.strategies.from_arrays", damaged)  # a checkpoint with it would be refused
    before = shutil.copytree(run_copy, run_copy.with_name("before"))
    message = "policy of member ... returned NaN or infinity at step 0"
    message += " ... parameters of its primitive are not finite" if level == "primitive" else ""
    refused("resume", run_copy, "--generations", "6", message=message, code=FAILED)
    assert runs.differences(before, run_copy) == []
    assert not list(run_copy.rglob("*.part"))


# Disks.


@contextmanager
def limited():
    """Give a function that limits the size of every file that is written, as a full disk does."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.parametrize(
    ("name", "generation", "latest"),
    [
        # What cannot be written from which generation on, and the generation of the last checkpoint.
        ("checkpoints/last.npz", 2, 2),
        ("checkpoints/best.npz", 0, 0),
        pytest.param("tensorboard", 2, 2, marks=pytest.mark.filterwarnings("ignore::ResourceWarning")),
    ],
)
def test_a_file_that_is_cut_off_ends_a_run_and_loses_nothing(tmp_path, tiny_run, name, generation, latest):
    """Half a checkpoint or half an event fits."""
    path = tmp_path / "run"

    def limit():
        sizes = [file.stat().st_size for file in path.rglob("*") if name in str(file) and file.is_file()]
        set_limit(sizes[0] // 2 if name.endswith("npz") else sum(sizes) + 20)

    message = f"cannot write ... {name} ... : the file is larger than allowed here: raise the limit ... `shes resume`"
    with limited() as set_limit, raises(ShesError, message) as error:
        runs.train_tiny(path, listener=runs.AfterGeneration(generation, limit))
    assert error.value.exit_code == MENDABLE
    del error
    gc.collect()  # an event file that could not be closed
    assert not list(path.rglob("*.part"))
    for file in (path / "checkpoints").iterdir():
        load_checkpoint(file)
    assert load_checkpoint(path / "checkpoints" / "last.npz").generation == latest
    shes.resume(path)
    assert runs.differences(tiny_run, path) == []


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/full is Linux's")
@pytest.mark.parametrize(
    ("is_full", "message"),
    [
        (True, "cannot write ... progress.csv: the disk is full: make room ... `shes resume`"),
        (False, "progress.csv was removed while the run went on. Restore it, then `shes resume`"),
    ],
)
def test_a_full_disk_or_a_lost_table_loses_no_row(tmp_path, tiny_run, is_full, message):
    table, kept = tmp_path / "run" / "progress.csv", tmp_path / "kept.csv"

    def fill():
        table.rename(kept)
        if is_full:
            table.symlink_to("/dev/full")

    with raises(ShesError, message):
        runs.train_tiny(tmp_path / "run", listener=runs.AfterGeneration(1, fill))
    kept.replace(table)
    shes.resume(tmp_path / "run")
    assert runs.differences(tiny_run, tmp_path / "run") == []


def test_a_disk_full_at_the_start_leaves_a_folder_to_use_again(tmp_path, tiny_run):
    path = tmp_path / "run"
    with limited() as set_limit:
        set_limit(5000)
        with pytest.raises(StorageError):
            runs.train_tiny(path)
    assert not list(path.rglob("*.part"))
    runs.train_tiny(path)
    assert runs.differences(tiny_run, path) == []


def test_a_log_that_cannot_be_written_stops_nothing(tmp_path, tiny_run, monkeypatch, capsys):
    def fail(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("logging.StreamHandler.flush", fail)
    assert runs.differences(tiny_run, runs.train_tiny(tmp_path / "run")) == []
    assert "Traceback" not in capsys.readouterr().err


@contextmanager
def bound_by_permissions():
    """Let the permissions of files hold for root, too: take CAP_DAC_OVERRIDE away for a while."""
    libc, header, kept = ctypes.CDLL(None), (ctypes.c_uint32 * 2)(0x20080522), (ctypes.c_uint32 * 6)()
    assert libc.capget(header, kept) == 0
    fewer = (ctypes.c_uint32 * 6)(kept[0] & ~2, *kept[1:])
    assert libc.capset(header, fewer) == 0
    try:
        yield
    finally:
        assert libc.capset(header, kept) == 0


@pytest.mark.skipif(sys.platform != "linux", reason="capabilities are Linux's")
def test_a_run_in_a_read_only_folder_can_be_evaluated_only(refused, tmp_path, run_copy, tiny_run, capsys):
    locked = tmp_path / "locked"
    locked.mkdir()
    for folder in (locked, run_copy, run_copy / "checkpoints"):
        folder.chmod(0o555)
    with bound_by_permissions():
        refused(*TRAIN, "--out", locked / "run", message="cannot write ... locked/run: permission denied: ... --out")
        message = "cannot write ... : permission denied"
        refused("resume", run_copy, "--generations", "6", message=message)
        assert main(["evaluate", str(run_copy), "--episodes", "2", "--workers", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["episodes"] == 2
    assert list(locked.iterdir()) == []
    assert runs.differences(tiny_run, run_copy) == []
