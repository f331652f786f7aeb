"""Output and arguments of the commands, and modules of the user. Wrong input is in e2e/test_bad_input.py."""

import io
import json
import math
import re
import shlex
import shutil
import subprocess
import sys
import zipfile
from dataclasses import asdict
from functools import wraps
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from shes.cli import main
from shes.cli.program import find_command
from shes.envs.named_environments import ENVIRONMENTS, EXTERNAL_ENVIRONMENTS
from shes.errors import ConfigError, UnknownNameError
from shes.runs.folder import RunFolder
from shes.runs.shipped import read_agent, shipped_names
from tests.e2e import runs
from tests.messages import raises

TINY = runs.flags(**runs.TINY)


def test_envs_lists_the_registry(shes):
    text, rows = shes("envs"), json.loads(shes("envs", "--json"))
    assert all(name in text for name in ENVIRONMENTS)
    assert re.search(r"ant-push +│ push +│ +36 +│ +32 +│ +8 ", text)
    assert [row["name"] for row in rows] == [*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS]
    push = {"name": "ant-push", "observation": {"shes": 36, "hiro": 32}, "action": 8}
    assert rows[2].items() >= {**push, "gymnasium": ["shes/AntPush-v0", "shes/AntPushHiro-v0"]}.items()
    assert all(row[word] for row in rows for word in ("about", "reward", "ends", "score"))


def test_list_shows_runs_and_shipped_agents(shes, tiny_run, tmp_path, monkeypatch):
    text = shes("list", tiny_run.parent, columns=160)
    assert re.search(r"│ \S+run +│ point-gather +│ 4 / 4 +│ -?[\d.]+ +│ finished", text)
    told = read_agent("ant-gather")
    compared = (told.evaluation, told.evaluation.constant, told.evaluation.random)
    scores = " +│ ".join(f"{one.score_mean:.2f} ± {one.score_std / math.sqrt(one.episodes):.2f}" for one in compared)
    assert re.search(rf"ant-gather +│ ant-gather +│ {scores} +│ ", text)
    assert re.search(rf"^ant-gather +{re.escape(told.description)}\.$", text, re.MULTILINE)
    found = json.loads(shes("list", tiny_run.parent, "--json"))
    assert found["agents"] == {name: asdict(read_agent(name)) for name in shipped_names()}
    assert [(run["env"], run["generation"], run["state"]) for run in found["runs"]] == [("point-gather", 4, "finished")]
    monkeypatch.chdir(tmp_path)
    assert "There is no run below runs." in shes("list")


def change_run(path, **changes):
    """Change settings of the run in the record of a run."""
    runs.change_json(path / "config.json", lambda record: record["config"]["run"].update(changes))


def claim_memory(path):
    """Write a checkpoint that claims to hold more than any memory."""
    with zipfile.ZipFile(path / "checkpoints" / "last.npz", "w") as archive:
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**15,)})
        archive.writestr("theta.npy", header.getvalue())


LISTED = {
    "whole": ("finished", lambda _: None),
    "longer": ("stopped", lambda path: change_run(path, generations=9)),
    "empty": ("unreadable", lambda path: (path / "checkpoints" / "last.npz").write_bytes(b"")),
    "huge": ("unreadable", claim_memory),
    "cut": ("unreadable", lambda path: (path / "config.json").write_text("{")),
    "number": ("unreadable", lambda path: change_run(path, env=7)),
    "theirs": ("unreadable", lambda path: change_run(path, algorithm="their-own")),
}


def test_list_tells_states_and_why_runs_are_unreadable(shes, tiny_run, tmp_path):
    for name, (_, change) in {**LISTED, "locked": LISTED["longer"]}.items():
        change(shutil.copytree(tiny_run, tmp_path / name))
    (tmp_path / "another").mkdir()
    (tmp_path / "another" / "config.json").write_text("{}")  # no run of SHES
    with RunFolder(tmp_path / "locked").lock():
        found = {Path(run["run"]).name: run for run in json.loads(shes("list", tmp_path, "--json"))["runs"]}
    states = {"locked": "running", **{name: state for name, (state, _) in LISTED.items()}}
    assert {name: run["state"] for name, run in found.items()} == states
    assert "cannot be read" in found["cut"]["problem"]
    shown = ("env", "algorithm", "generation", "generations", "env_steps")
    assert [found["whole"][name] for name in shown] == ["point-gather", "shes", 4, 4, 640]
    text = shes("list", tmp_path, columns=200)
    assert re.search(r"whole +│ point-gather +│ 4 / 4 +│ \d+\.\d\d +│ finished", text)
    assert not re.search(r"theirs +│", text)
    assert re.search(r"theirs is unreadable: .*unknown algorithm 'their-own'(?s:.*)--import MODULE", text)


def test_info_shows_what_a_run_is(shes, tiny_run):
    text = shes("info", tiny_run, "--full")
    for row in (r"env +│ point-gather", r"state +│ finished", r"sigma +│ 0\.070"):
        assert re.search(row, text)
    assert "problem" not in text
    assert "sigma" not in shes("info", tiny_run)
    assert json.loads(shes("info", tiny_run, "--json"))["config"]["evolution"]["sigma"] == 0.07


def test_info_shows_how_a_shipped_agent_was_trained(shes):
    told, text = read_agent("ant-gather"), shes("info", "ant-gather")
    assert f"{told.evaluation.score} over {told.evaluation.episodes} fresh episodes" in text
    for other in (told.evaluation.constant, told.evaluation.random):
        assert re.search(rf"score, {other.controller} +│ {other.score} ", text)
    assert f"Trained by:\n{told.commands[0]}\n" in text
    assert json.loads(shes("info", "ant-gather", "--json")).items() >= asdict(told).items()


def test_train_says_where_the_run_is_and_what_to_do_next(shes, tmp_path, tiny_run):
    path = tmp_path / "[b] [/b]"
    text = shes("train", "point-gather", *TINY, "--out", path)
    assert f"Training point-gather (smoke) on this process. Run folder: {path}\n" in text
    assert re.search(r"Done: 4 generations, best evaluation score -?[\d.]+ \(generation \d\)\.\n", text)
    quoted = shlex.quote(str(path))  # to be copied into a shell
    assert f"Next: shes evaluate {quoted} · shes render {quoted} · shes plot {quoted}\n" in text
    assert runs.differences(tiny_run, path) == []  # the same as by `shes.train`


def test_train_makes_a_folder_below_runs_if_none_is_named(shes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["/somewhere/shes/__main__.py", "train", "point-gather"])
    shes("train", "point-gather", *TINY)
    (path,) = (tmp_path / "runs").iterdir()
    assert path.name.startswith("point-gather-smoke-seed5-")
    assert re.search(r"command +│ python -m shes train point-gather ", shes("info", path))


def test_evaluate_prints_a_table_or_json(shes, tiny_run):
    text = shes("evaluate", tiny_run, "--episodes", 3, "--workers", 1)
    assert re.search(r"score_mean +│ +-?[\d.]+ ", text)
    (line,) = shes("evaluate", tiny_run, "--episodes", 3, "--workers", 1, "--checkpoint", "last", "--json").splitlines()
    found = json.loads(line)
    assert (found["run"], found["checkpoint"], found["episodes"]) == (str(tiny_run), "last", 3)
    assert {"score_mean", "score_std", "return_mean", "success_rate"} <= set(found)


HANDED_ON = {
    "render --checkpoint 0 last --out=b.mp4 run b --camera top --episode 3 --seed 7 --size 240 --steps 50 --speed 2 "
    "--sensors": {
        "runs": ("run", "b"), "checkpoints": ("0", "last"), "camera": "top", "episode": 3, "seed": 7, "size": 240,
        "steps": 50, "speed": 2.0, "sensors": True, "out": "b.mp4",
    },
    "watch run --checkpoint 12 --seed 3e2": {"run": "run", "checkpoint": "12", "seed": 300},
    "report run b --out a.html --episodes 7 --seed 3 --workers 2 --no-video": {
        "runs": ("run", "b"), "episodes": 7, "seed": 3, "num_workers": 2, "video": False, "out": "a.html",
    },
}  # fmt: skip


@pytest.mark.parametrize("line", HANDED_ON)
def test_a_command_hands_on_its_flags(monkeypatch, line):
    command = line.split()[0]
    function, given = find_command(command), []

    @wraps(function)
    def fake(**values):
        values.pop("on_step", None)
        given.append(values)

    monkeypatch.setattr(sys.modules[function.__module__], command, fake)
    assert main(line.split()) == 0
    assert given == [HANDED_ON[line]]


# Arguments are checked before any work, with one message for the command line and for Python.

GIVEN = {"compare": ("no-run", "no-other")}
"""Arguments of a command; for the others, the run `no-run`, which does not exist."""


@pytest.mark.parametrize(
    ("command", "name", "values", "allowed"),
    [
        ("compare", "episodes", [1], "a whole number of at least 2"),
        ("evaluate", "episodes", [0], "a whole number of at least 1"),
        ("report", "episodes", [0], "a whole number of at least 1"),
        ("report", "num_workers", [-1], "a whole number of at least 0"),
        ("render", "episode", [-1, 100_000], "a whole number of at least 0 and less than 100000"),
        ("render", "steps", [0, 100_000], "a whole number of at least 1 and less than 100000"),
        ("render", "size", [63, 1081], "a whole number of at least 64 and at most 1080"),
        ("render", "size", [65], "an even number of pixels"),
        ("watch", "seed", [-1], "a whole number of at least 0"),
        *((each, "seed", [-1], "a whole number of at least 0") for each in ("compare", "evaluate", "render", "report")),
    ],
)
def test_a_number_out_of_range_is_refused_alike(capsys, tmp_path, monkeypatch, command, name, values, allowed):
    monkeypatch.chdir(tmp_path)
    given, flag = GIVEN.get(command, ("no-run",)), f"--{name.removeprefix('num_')}"
    for value in values:
        message = f"{name} must be {allowed}, got {value}. Set {flag}."
        with pytest.raises(ConfigError):
            find_command(command)(*given, **{name: value})
        assert main([command, *given, flag, str(value)]) == 2
        assert capsys.readouterr() == ("", f"Error: {message}\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "line", ["compare measure", "evaluate device", "evaluate targets", "export format", "plot x", "render camera"]
)
def test_an_unknown_name_is_refused(tmp_path, monkeypatch, line):
    monkeypatch.chdir(tmp_path)
    command, name = line.split()
    with raises(UnknownNameError, f"unknown {name} 'nonesuch'. ... Set --{name}."):
        find_command(command)(*GIVEN.get(command, ("no-run",)), **{name: "nonesuch"})
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def own_module(tmp_path, monkeypatch):
    """Return a function that writes a module of this content and returns its name; afterwards all is forgotten."""

    def write(content):
        name = f"own_module_{tmp_path.name}"
        (tmp_path / f"{name}.py").write_text(content)
        return name

    monkeypatch.syspath_prepend(tmp_path)
    before = dict(ENVIRONMENTS)
    yield write
    ENVIRONMENTS.clear()
    ENVIRONMENTS.update(before)


OWN = """
from shes.envs.tasks.gather import Gather
from shes.envs.bodies.point import Point
from shes.envs.named_environments import register_environment

register_environment("point-own", Point, Gather)
"""


def test_an_environment_of_an_imported_module_can_be_used(shes, tmp_path, own_module):
    name = own_module(OWN)
    rows = json.loads(shes("envs", "--json", "--import", name, "--import=json"))
    assert "point-own" in [row["name"] for row in rows]
    assert "for point-own" in " ".join(shes(f"--import={name}", "train", "point-own", "--help").split())
    path = tmp_path / "run"
    shes("train", "--import", name, "point-own", *TINY, "--out", path)
    shes("resume", path, "--generations", 5, "--import", name)
    assert json.loads(shes("evaluate", path, "--episodes", 2, "--workers", 1, "--json", "--import", name))


FAILING = {
    "raise ValueError('not today')": r"--import NAME: the module failed: ValueError: not today\.",
    "import there_is_none": r"the module failed: ModuleNotFoundError: No module named 'there_is_none'",
    "import sys; sys.exit('bye')": r"the module failed: SystemExit: bye\.",
    OWN.replace("point-own", "Point Own"): r"the module failed: ConfigError: .*'Point Own'",
}


@pytest.mark.parametrize("content", FAILING)
def test_a_module_that_fails_is_an_error_that_names_it(capsys, own_module, content):
    name = own_module(content)
    assert main(["envs", "--import", name]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert re.search(FAILING[content].replace("NAME", name), err)
    with pytest.raises(ConfigError) as error:
        main(["envs", "--import", name, "--debug"])
    assert error.value.__cause__ is not None


def test_the_installed_command_is_the_module():
    for command in ([Path(sys.executable).with_name("shes")], runs.COMMAND):
        done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True)
        assert done.stdout == f"shes {version('shes')}\n"
