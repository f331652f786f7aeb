"""What the user can get wrong: a message with value, choices and fix, the exit code of the design, and nothing lost."""

import errno
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import shes
from shes import storage
from shes.cli import main
from shes.errors import ConfigError, ShesError
from shes.runs.checkpoint import load_checkpoint
from tests.e2e import runs

MENDABLE, FAILED = 2, 1
TRAIN = ["train", "point-gather", *runs.flags(**runs.TINY)]
# Lets the permissions of files hold for root, too: prctl(PR_CAPBSET_DROP, CAP_DAC_OVERRIDE).
WITHOUT_ROOT = "assert os.geteuid() or ctypes.CDLL(None).prctl(24, 1, 0, 0, 0) == 0"


@pytest.fixture
def refused(capsys, tmp_path, monkeypatch):
    """Return a function that runs a command line that must fail, and returns its message on one line."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*words, code=MENDABLE):
        found = main([str(word) for word in words])
        out, err = capsys.readouterr()
        assert found == code
        assert "Traceback" not in out + err
        return " ".join(word for word in err.split() if not set(word) <= set("|+-─│╭╮╰╯"))

    return run


# Command lines.

WORDS = {
    # How a command line is written.
    "unknown command": (
        ["trian", "x"],
        r"unknown command 'trian'\. Did you mean 'train'\? Known: train, .*shes --help",
    ),
    "no environment": (
        ["train", "--preset", "smoke"],
        r"Missing from shes train: ENV Environment \(shes envs\) or gymnas",
    ),
    "no value": ([*TRAIN, "--mirrored"], r"Missing value for argument '--mirrored'"),
    "flag as a value": (["train", "point-gather", "--sigma", "--seed", "1"], r"Missing value for argument '--sigma'"),
    "unknown flag": (
        [*TRAIN, "--population", "8"],
        r"Unrecognized options: --population, 8.* Perhaps you meant: .*--population-size INT",
    ),
    "one word too many": ([*TRAIN, "extra"], r"Unrecognized options: extra"),
    "wrong type": ([*TRAIN, "--sigma", "abc"], r"Error parsing --sigma: could not convert string to float: 'abc'"),
    "wrong type in a list": (
        ["train", "point-gather", "--hidden", "8", "x"],
        r"Error parsing --hidden: .*\['8', 'x'\]",
    ),
    "wrong optional number": ([*TRAIN, "--minutes", "soon"], r"Error parsing --minutes: .*'soon'"),
    "switch with a value": ([*TRAIN, "--minimum-goal-distance=no"], r"Unrecognized options: no"),
    "short flag": ([*TRAIN, "-s", "1"], r"Unrecognized options: -s, 1"),
    "flag before the command": (
        ["--sigma", "1", "train"],
        r"unknown flag --sigma before the command\. See `shes --help`",
    ),
    "flag that is gone": ([*TRAIN, "--sigma-schedule", "linear"], r"Unrecognized options: --sigma-schedule, linear"),
    "no module": (["train", "--import"], r"--import needs a value: --import MODULE"),
    "unknown module": (
        ["envs", "--import", "there_is_none"],
        r"--import there_is_none: there is no module 'there_is_none'\. Is it installed or on PYTHONPATH\?",
    ),
    "file as a module": (["envs", "--import", "mine.py"], r"no module 'mine'.*not a file: --import mine\."),
    "choice of a command": (["bench", "rolout"], r"[Ii]nvalid choice 'rolout' .*rollout"),
    # Names.
    "environment": (
        ["train", "pint-gather"],
        r"unknown environment 'pint-gather'\. Did you mean 'point-gather'\? Known: point-gather, ant-.*`shes envs`",
    ),
    "preset": ([*TRAIN, "--preset", "lapto"], r"unknown preset 'lapto'\. Did you mean 'laptop'\? .*Set --preset"),
    "backend": ([*TRAIN, "--backend", "sereal"], r"unknown backend 'sereal'\. Did you mean 'serial'"),
    "mirroring": (
        [*TRAIN, "--mirrored", "trio"],
        r"unknown mirroring 'trio'\. Known: none, pair, quad\. Set --mirrored",
    ),
    "reward that is not imported": (
        [*TRAIN, "--exponent", "2", "--primitive-reward", "pow"],
        r"Error: unknown primitive reward 'pow'\. Known: cosine, .* Set --primitive-reward\. .* or --import MODULE\.",
    ),
    # Values.
    "sigma": ([*TRAIN, "--sigma", "nan"], r"sigma must be a positive number, got nan\. Set --sigma"),
    "workers": (
        [*TRAIN, "--workers", "-1"],
        r"num_workers must be a whole number of at least 0, got -1\. Set --workers",
    ),
    "population": (
        [*TRAIN, "--population-size", "18"],
        r"population_size must be a positive multiple of 4, .*got 18\. Set --population-size 16 or 20",
    ),
    "population of halves": (
        [*TRAIN, "--perturbation", "one_to_many_halves", "--population-size", "10"],
        r"population_size must be a positive multiple of 4, a group of 2 .*got 10\. .*size 8 or 12",
    ),
    "noise table": (
        [*TRAIN, "--noise-table-size", "100"],
        r"noise_table_size is 100, but a level has [\d,]+ parameters and needs at least [\d,]+\. Raise --noise-table-s",
    ),
    "flags too near": (
        ["train", "point-flagrun", *TRAIN[2:], "--goal-distance", "0.5"],
        r"goal_distance must be between 1 and 1000, got 0\.5\. Set --goal-distance",
    ),
    "hidden layer of nothing": (
        [*TRAIN, "--primitive-hidden", "0"],
        r"primitive_hidden must be positive whole numbers, e\.g\. --primitive-hidden 64 64, got \(0,\)",
    ),
    "seconds": (
        ["bench", "rollout", "point-gather", "--preset", "smoke", "--seconds", "-1"],
        r"seconds must be zero or a positive number, got -1\.0\. Set --seconds",
    ),
    # Settings of what is not there.
    "goals of a flat run": (
        [*TRAIN, "--algorithm", "es", "--goal-encoding", "angle"],
        r"goal_encoding is not a setting of a run of point-gather with algorithm 'es', got 'angle'\. Omit --goal",
    ),
    "checkpoint of no primitive": (
        [*TRAIN, "--primitive-checkpoint", "last"],
        r"primitive_checkpoint has no effect with primitive None.*omit --primitive-checkpoint",
    ),
    # Runs.
    "missing primitive": (
        [*TRAIN, "--primitive", "gone"],
        r"gone does not exist\. Give the folder that `shes train` pr",
    ),
    "nameless primitive": (
        [*TRAIN, "--primitive="],
        r"primitive must be a name, e\.g\. --primitive ant-walker, got ''\. Set --primitive",
    ),
    "no run to resume": (["resume"], r"Missing from shes resume: RUN The run folder"),
    "no run to plot": (["plot"], r"plot needs at least one run folder: shes plot RUN"),
    "no run to report": (["report"], r"report needs at least one run folder: shes report RUN"),
    "no run to render": (["render"], r"render needs at least one run and one checkpoint: shes render RUN"),
    **{
        f"missing run to {command}": ([command, "gone"], r"gone does not exist\. Give the folder")
        for command in ("resume", "plot", "report")
    },
}


@pytest.mark.parametrize("case", WORDS)
def test_a_wrong_command_line_is_refused_with_its_fix(case, refused, tmp_path):
    words, message = WORDS[case]
    assert re.search(message, refused(*words))
    assert list(tmp_path.iterdir()) == []  # nothing was begun


def test_debug_shows_the_traceback():
    with pytest.raises(ShesError, match="unknown environment"):
        main(["train", "pint-gather", "--debug"])


def test_a_process_prints_one_line(tmp_path):
    code, out, err = runs.run("train", "point-gather", "--preset", "lapto")
    assert (code, out) == (MENDABLE, "")
    assert err.startswith("Error: unknown preset 'lapto'")
    assert err.count("\n") == 1


# Run folders.


def test_a_folder_that_holds_a_run_is_refused_and_untouched(refused, run_copy, tiny_run):
    message = refused(*TRAIN, "--out", run_copy)
    assert re.search(
        rf"{run_copy} already holds a run\. Go on with it by `shes resume .*another folder with --out", message
    )
    assert runs.differences(tiny_run, run_copy) == []


def test_a_file_as_run_folder_is_refused_and_untouched(refused, tmp_path):
    file = tmp_path / "file"
    file.write_text("mine")
    assert re.search(r"file is a file, not a folder\. Choose another path with --out", refused(*TRAIN, "--out", file))
    assert file.read_text() == "mine"
    assert re.search(r"a part of the path is a file.*--out", refused(*TRAIN, "--out", file / "run"))


@pytest.mark.parametrize("command", ["resume", "evaluate", "plot"])
def test_a_folder_that_is_no_run_is_refused(refused, tmp_path, command):
    assert re.search(r"is not a run folder: it has no config\.json\. Give the folder", refused(command, tmp_path))


def test_a_finished_run_is_not_resumed_but_says_how(refused, run_copy):
    message = refused("resume", run_copy)
    assert re.search(rf"has made 4 generations, .*To go on: shes resume {run_copy} --generations 8", message)
    message = refused("resume", run_copy, "--generations", "2")
    assert re.search(r"has made 4 generations, .*--generations 8", message)


def test_resume_refuses_what_would_change_the_numbers(refused, run_copy):
    message = refused("resume", run_copy, "--sigma", "1")
    assert re.search(r"--sigma would change the numbers of the run; resume takes --backend, .*--workers\.", message)
    with pytest.raises(ConfigError, match=r"--sigma would change the numbers.*takes .*--workers"):
        shes.resume(run_copy, sigma=1.0, generations=8)
    with pytest.raises(ConfigError, match=r"unknown setting 'sigm'\. resume takes"):
        shes.resume(run_copy, sigm=1.0)


CONFIGS = {
    "not_json": (lambda text: text[: len(text) // 2], r"config\.json cannot be read: .*Restore it from a copy"),
    "empty": (lambda text: text[:0], r"config\.json cannot be read: "),
    "other_json": (lambda text: f"[{text}]", r"config\.json is not the record of a SHES run"),
    "other_format": (
        lambda text: text.replace('"format": 2', '"format": 9'),
        r"not the record of a SHES run of format 2",
    ),
    "no_settings": (
        lambda text: text.replace('"config": {', '"konfig": {'),
        r"config\.json is damaged: KeyError\('config'\)",
    ),
    "unknown_key": (
        lambda text: text.replace('"sigma"', '"sigmma"'),
        r"config\.json: unknown setting 'sigmma'\. Did you mean 'sigma'\?",
    ),
    "wrong_type": (
        lambda text: re.sub(r'"sigma": [\d.]+', '"sigma": "big"', text),
        r"sigma must be a positive number, got 'big'",
    ),
    "unknown_environment": (
        lambda text: text.replace('"env": "point-gather"', '"env": "pont-gather"'),
        r"config\.json: unknown environment 'pont-gather'\. Did you mean 'point-gather'\?",
    ),
}


@pytest.mark.parametrize("case", CONFIGS)
@pytest.mark.parametrize("command", ["resume", "evaluate", "plot"])
def test_a_damaged_record_is_refused(refused, run_copy, case, command):
    damage, message = CONFIGS[case]
    config = run_copy / "config.json"
    config.write_text(damage(config.read_text()))
    assert re.search(message, refused(command, run_copy))


@pytest.mark.parametrize("command", ["resume", "evaluate"])
def test_a_setting_that_was_lost_is_told_by_the_checkpoint(refused, run_copy, command):
    config = run_copy / "config.json"
    config.write_text(re.sub(r'"population_size": \d+,', "", config.read_text()))
    message = refused(command, run_copy)
    assert re.search(r"\.npz is of another run: population_size is 8, not \d+\. Put back", message)


# Checkpoints.


def cut_in_half(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def write_npy(path):
    with path.open("wb") as file:
        np.save(file, np.zeros(3))


CHECKPOINTS = {
    "truncated": cut_in_half,
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("hello"),
    "foreign_npz": lambda path: np.savez(path, weights=np.zeros(3)),
    "foreign_npy": write_npy,
}


@pytest.mark.parametrize("case", CHECKPOINTS)
@pytest.mark.parametrize(("command", "name"), [("resume", "last"), ("evaluate", "best")])
def test_a_damaged_checkpoint_is_refused_and_nothing_else_is_touched(refused, run_copy, case, command, name):
    CHECKPOINTS[case](run_copy / "checkpoints" / f"{name}.npz")
    before = {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()}
    more = ["--generations", "6"] if command == "resume" else []
    message = refused(command, run_copy, *more)
    assert re.search(rf"{name}\.npz is not a whole SHES checkpoint .*--checkpoint last, best or a generation", message)
    assert "copy it over last.npz" in message
    assert {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()} == before


def test_the_fix_for_a_damaged_last_checkpoint_works(run_copy, tiny_run):
    checkpoints = run_copy / "checkpoints"
    cut_in_half(checkpoints / "last.npz")
    shutil.copy(checkpoints / "generation_000002.npz", checkpoints / "last.npz")
    shes.resume(run_copy)
    assert runs.differences(tiny_run, run_copy) == []


def test_a_checkpoint_of_another_run_is_refused(refused, run_copy, tmp_path):
    other = runs.train_tiny(tmp_path / "other", sigma=0.5, seed=6)
    for name in ("last", "best"):
        shutil.copy(other / "checkpoints" / f"{name}.npz", run_copy / "checkpoints" / f"{name}.npz")
    message = refused("resume", run_copy, "--generations", "6")
    assert re.search(
        r"last\.npz is of another run: seed is 6, not 5, sigma is 0\.5, not .*Put back the checkpoint", message
    )
    assert re.search(r"best\.npz is of another run", refused("evaluate", run_copy))


def test_a_checkpoint_that_does_not_exist_is_refused_by_naming_those_that_do(refused, run_copy):
    message = refused("evaluate", run_copy, "--checkpoint", "77")
    there = (
        r"There are: best, generation_000000, generation_000002, generation_000004, last\. Choose one with --checkpoint"
    )
    assert re.search(rf"there is no checkpoint .*generation_000077\.npz\. {there}", message)
    (run_copy / "checkpoints" / "last.npz").unlink()
    assert re.search(r"there is no checkpoint .*last\.npz\. .*copy it to last\.npz", refused("resume", run_copy))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--episodes", "0"], r"episodes must be a whole number of at least 1, got 0\. Set --episodes"),
        (["--seed", "-1"], r"seed must be a whole number of at least 0, got -1\. Set --seed"),
        (["--workers", "-1"], r"num_workers must be .*got -1\. Set --workers"),
        (["--checkpoint", "../x"], r"there is no checkpoint"),
    ],
)
def test_evaluate_refuses_wrong_values_by_its_own_flags(refused, run_copy, words, message):
    assert re.search(message, refused("evaluate", run_copy, *words))


# Policies that are NaN, or return it.


def spoil(path, level):
    """Put a NaN into the parameters of a checkpoint."""
    with np.load(path) as file:
        arrays = dict(file)
    arrays[f"{level}/theta"][-1] = np.nan
    np.savez(path, **arrays)


@pytest.fixture
def unchecked(monkeypatch):
    """Let a checkpoint be read whatever it holds, as if the NaN came from elsewhere."""
    monkeypatch.setattr("shes.evolution.strategies.check_arrays", lambda *_: None)


@pytest.mark.parametrize(
    ("command", "name", "more"), [("resume", "last", ["--generations", 6]), ("evaluate", "best", [])]
)
def test_a_checkpoint_with_a_policy_that_is_nan_is_refused_and_the_folder_is_as_it_was(
    refused, run_copy, command, name, more
):
    spoil(run_copy / "checkpoints" / f"{name}.npz", "primitive")
    before = {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()}
    message = refused(command, run_copy, *more)
    assert re.search(rf"{name}\.npz holds NaN or infinity in primitive/theta\. Take an earlier checkpoint\.", message)
    assert {path: path.read_bytes() for path in run_copy.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("level", "backend"),
    [
        ("controller", "serial"),
        ("primitive", "processes"),
        pytest.param("controller", "processes", marks=pytest.mark.extras),
        pytest.param("primitive", "serial", marks=pytest.mark.extras),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_a_policy_that_returns_nan_ends_the_run_and_leaves_the_folder_intact(refused, run_copy, level, backend):
    spoil(run_copy / "checkpoints" / "last.npz", level)
    before = runs.numbers(run_copy)
    message = refused("resume", run_copy, "--generations", "6", "--backend", backend, "--workers", "2", code=FAILED)
    assert re.search(r"policy of member \d+ returned NaN or infinity at step 0", message)
    if level == "primitive":
        assert "parameters of its primitive are not finite" in message
    after = runs.numbers(run_copy)
    assert {name: value.tobytes() for name, value in before.items()} == {
        name: value.tobytes() for name, value in after.items()
    }
    assert not list(run_copy.rglob("*.part"))


@pytest.mark.usefixtures("unchecked")
def test_evaluating_a_policy_that_returns_nan_fails(refused, run_copy):
    spoil(run_copy / "checkpoints" / "best.npz", "primitive")
    assert re.search(r"returned NaN or infinity", refused("evaluate", run_copy, "--workers", "1", code=FAILED))


# Disks.


def full(*arguments, **keywords):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def fill_disk(monkeypatch):
    """Return a function that makes the next writes to files named `name` fail, half way through; undo ends it."""

    def fill(name):
        original = storage.write_atomically

        def write_atomically(path, write):
            if not re.fullmatch(name, path.name):
                return original(path, write)

            def half(file):
                write(file)
                file.truncate(file.tell() // 2)
                full()

            return original(path, half)

        monkeypatch.setattr("shes.runs.checkpoint.write_atomically", write_atomically)
        monkeypatch.setattr("shes.runs.folder.write_atomically", write_atomically)

    return fill


class FromGeneration:
    """A listener that calls `action` after generation `number`; 0 is the start."""

    def __init__(self, number, action):
        self.number, self.action = number, action

    def on_start(self, *arguments):
        self.on_generation({"generation": 0})

    def on_generation(self, row):
        if row["generation"] == self.number:
            self.action()

    def on_evaluation(self, row):
        pass

    def on_event(self, event):
        pass


def intact(path):
    """Fail if a checkpoint is not whole or a half-written file is left; return the last one's generation."""
    assert not list(path.rglob("*.part"))
    for file in (path / "checkpoints").iterdir():
        load_checkpoint(file)
    return load_checkpoint(path / "checkpoints" / "last.npz").generation


@pytest.mark.parametrize(
    ("name", "generation", "latest"),
    [
        (r"last\.npz", 2, 3),
        pytest.param(r"best\.npz", 0, 1, marks=pytest.mark.extras),
        pytest.param(r"generation_000004\.npz", 2, 4, marks=pytest.mark.extras),  # last.npz may be written before it
    ],
)
def test_a_full_disk_while_writing_a_checkpoint_loses_nothing(
    tmp_path, tiny_run, fill_disk, monkeypatch, name, generation, latest
):
    path = tmp_path / "run"
    with pytest.raises(ShesError, match=r"cannot write .*\.npz: the disk is full: make room.*`shes resume`") as error:
        runs.train_tiny(path, listener=FromGeneration(generation, lambda: fill_disk(name)))
    assert error.value.exit_code == MENDABLE
    # The files of that generation and of those before it may not have been begun when the disk got full.
    assert intact(path) <= latest
    monkeypatch.undo()
    shes.resume(path)
    assert runs.differences(tiny_run, path) == []


@pytest.mark.parametrize("name", [r"generation_000000\.npz", r"last\.npz", r"config\.json"])
def test_a_full_disk_at_the_start_leaves_a_folder_that_can_be_used_again(
    tmp_path, tiny_run, fill_disk, monkeypatch, name
):
    path = tmp_path / "run"
    fill_disk(name)
    with pytest.raises(ShesError, match="the disk is full"):
        runs.train_tiny(path)
    assert not list(path.rglob("*.part"))
    monkeypatch.undo()
    runs.train_tiny(path)
    assert runs.differences(tiny_run, path) == []


@pytest.mark.parametrize("table", ["progress.csv", "evaluation.csv"])
@pytest.mark.parametrize("generation", [0, 1, 2])
def test_a_full_disk_while_writing_a_table_loses_nothing(tmp_path, tiny_run, monkeypatch, table, generation):
    """Half a row, even half a header, is on the disk when it is full."""
    path = tmp_path / "run"
    original = Path.open

    class Half:
        def __init__(self, file):
            self.file = file

        def __enter__(self):
            return self

        def __exit__(self, *exception):
            self.file.close()

        def write(self, text):
            self.file.write(text[:20])
            full()

    def open_full(self, mode="r", **keywords):
        file = original(self, mode, **keywords)
        return Half(file) if self.name == table and mode == "a" else file

    with pytest.raises(
        ShesError, match=rf"cannot write .*{table}: the disk is full: make room.*`shes resume`"
    ) as error:
        runs.train_tiny(path, listener=FromGeneration(generation, lambda: monkeypatch.setattr(Path, "open", open_full)))
    assert error.value.exit_code == MENDABLE
    monkeypatch.undo()
    assert intact(path) <= generation + 1
    shes.resume(path)
    assert runs.differences(tiny_run, path) == []


def test_a_full_disk_while_writing_tensorboard_events_ends_the_run_and_loses_nothing(tmp_path, tiny_run, monkeypatch):
    path = tmp_path / "run"

    def fill():
        monkeypatch.setattr("tensorboardX.record_writer.RecordWriter.write", full)

    with pytest.raises(ShesError, match=r"cannot write .*tensorboard.*: the disk is full"):
        runs.train_tiny(path, listener=FromGeneration(2, fill))
    monkeypatch.undo()
    intact(path)
    shes.resume(path)
    assert runs.differences(tiny_run, path) == []


def test_a_log_that_cannot_be_written_stops_nothing(tmp_path, tiny_run, monkeypatch, capsys):
    monkeypatch.setattr("logging.StreamHandler.flush", full)
    assert runs.differences(tiny_run, runs.train_tiny(tmp_path / "run")) == []
    assert "Traceback" not in capsys.readouterr().err


def in_a_process(prepare, *words, command=runs.COMMAND):
    """Run the command in a process that runs the code `prepare` first."""
    code = f"import ctypes, os, resource, sys\n{prepare}\nos.execv(sys.argv[1], sys.argv[1:])"
    return subprocess.run(
        [sys.executable, "-c", code, *command, *(str(word) for word in words)],
        capture_output=True,
        text=True,
        timeout=runs.PATIENCE_S,
        check=False,
    )


def test_a_file_that_the_system_cuts_off_is_an_error_and_loses_nothing(tmp_path):
    """A real limit of the kernel: no file may grow beyond the size of half a checkpoint."""
    path = runs.train_tiny(tmp_path / "run", generations=2)
    size = (path / "checkpoints" / "last.npz").stat().st_size // 2
    limit = f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size}, {size}))"
    done = in_a_process(limit, "resume", path, "--generations", "4")
    assert done.returncode == MENDABLE
    assert re.search(r"Error: cannot write .*\.npz: the file is larger than allowed here", done.stderr)
    assert "Traceback" not in done.stderr
    assert intact(path) == 2


IN_TURN = """
import json, sys
from shes.cli import main
for words in json.loads(sys.argv[1]):
    code = main(words)
    print("exit code", code, file=sys.stderr)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="capabilities are Linux's")
def test_a_read_only_folder_is_an_error_that_names_the_fix_and_its_run_can_be_evaluated(tmp_path, run_copy, tiny_run):
    locked = tmp_path / "locked"
    locked.mkdir()
    for folder in (locked, run_copy, run_copy / "checkpoints"):
        folder.chmod(0o555)
    lines = [
        [*TRAIN, "--out", str(locked / "run")],
        ["resume", str(run_copy), "--generations", "6"],
        ["evaluate", str(run_copy), "--episodes", "2", "--workers", "1", "--json"],
    ]
    done = in_a_process(WITHOUT_ROOT, json.dumps(lines), command=(sys.executable, "-c", IN_TURN))
    assert re.search(
        rf"Error: cannot write .*locked/run: permission denied: .*--out(?s:.*)exit code {MENDABLE}\n"
        rf"Error: cannot write .*(\.lock|config\.json|progress\.csv): permission denied(?s:.*)exit code {MENDABLE}\n"
        r"exit code 0\n$",
        done.stderr,
    ), done.stderr
    assert "Traceback" not in done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["episodes"] == 2
    assert list(locked.iterdir()) == []
    assert runs.differences(tiny_run, run_copy) == []


def test_a_file_system_that_is_read_only_is_an_error_that_names_the_fix(refused, monkeypatch):
    def read_only(*arguments, **keywords):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "mkdir", read_only)
    assert re.search(r"cannot write run: the file system is read-only: .*--out", refused(*TRAIN, "--out", "run"))


def test_a_picture_in_a_missing_folder_is_refused(refused, run_copy):
    message = refused("plot", run_copy, "--out", "none/curves.png")
    assert re.search(r"cannot write none/curves\.png: there is no such folder: create it first.*--out", message)


def test_a_reader_that_goes_away_is_no_error():
    command = f"{sys.executable} -m shes train --help | head -1"
    done = subprocess.run(["bash", "-c", f"set -o pipefail; {command}"], capture_output=True, text=True, check=False)
    assert (done.returncode in (0, 141), done.stderr) == (True, "")
    assert done.stdout.startswith("usage: shes train")
