"""The command line: what it prints, aliases, JSON, modules of the user. Wrong input is in e2e/test_bad_input.py."""

import io
import json
import math
import re
import shlex
import shutil
import subprocess
import sys
import zipfile
from functools import wraps
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from experiments.ship import ship
from shes.cli import main
from shes.cli.command_table import find_command
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.named_environments import ENVIRONMENTS
from shes.errors import ConfigError
from shes.runs import shipped
from shes.runs.folder import RunFolder
from shes.runs.shipped import read_agent
from tests.e2e import runs

TINY = runs.flags(**runs.TINY)


@pytest.fixture(scope="module")
def tiny_run(tmp_path_factory):
    """Folder of a finished tiny run. Not to be changed."""
    return runs.train_tiny(tmp_path_factory.mktemp("tiny") / "run")


@pytest.fixture
def shes(capsys):
    """Return a function that runs a command line that succeeds, and returns what it printed."""

    def run(*words):
        code = main([str(word) for word in words])
        out, err = capsys.readouterr()
        assert (code, err) == (0, "")
        return out

    return run


def test_version(shes):
    assert shes("--version") == f"shes {version('shes')}\n"


def test_envs_lists_the_registry(shes):
    text = shes("envs")
    assert all(name in text for name in ENVIRONMENTS)
    rows = json.loads(shes("envs", "--json"))
    assert [row["name"] for row in rows] == [*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS]
    assert [(row["observation"]["shes"], row["action"]) for row in rows[:3]] == [(50, 8), (32, 8), (36, 8)]
    assert rows[2]["observation"] == {"shes": 36, "hiro": 32}
    assert rows[2]["gymnasium"] == ["shes/AntPush-v0", "shes/AntPushHiro-v0"]
    for row in rows:
        assert all(row[word] for word in ("about", "reward", "ends", "score"))
    for words in ("minus the distance to the target", "highest running return", "1 if the last distance is below 5 m"):
        assert words.split()[0] in text


@pytest.fixture
def agent(tiny_run, tmp_path, monkeypatch):
    """The name of a shipped agent, the only one."""
    told = {"description": "Collects food.", "commands": ["shes train point-gather"]}
    ship(tiny_run, "point-food", **told, episodes=2, num_workers=1, into=tmp_path / "agents")
    monkeypatch.setattr(shipped, "AGENTS", tmp_path / "agents")
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return "point-food"


def test_list_shows_runs_and_shipped_agents(shes, agent, tiny_run, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    text = shes("list", tiny_run.parent)
    assert re.search(r"│ \S+run +│ point-gather +│ 4 / 4 +│ -?[\d.]+ +│ finished", text)
    fresh = read_agent(agent).evaluation
    scores = " +│ ".join(
        f"{each.score_mean:.2f} ± {each.score_std / math.sqrt(each.episodes):.2f}"
        for each in (fresh, fresh.constant, fresh.random)
    )
    assert re.search(rf"point-food +│ point-gather +│ {scores} +│ 640 +│", text)
    assert f"{agent} Collects food.\n" in text
    (line,) = shes("list", tiny_run.parent, "--json").splitlines()
    found = json.loads(line)
    assert found["agents"] == {agent: read_agent(agent).to_dict()}
    assert [(run["env"], run["generation"], run["state"]) for run in found["runs"]] == [("point-gather", 4, "finished")]
    assert "There is no run below runs." in shes("list")


def test_list_shows_names_whole_on_a_narrow_terminal(shes, agent, tiny_run, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    copy = shutil.copytree(shipped.AGENTS / agent, shipped.AGENTS / "point-gather-coevolved") / "agent.json"
    copy.write_text(copy.read_text().replace("Collects food.", "Collects food of every kind. " * 3))
    shutil.copytree(tiny_run, tmp_path / "runs" / ("long-" * 12))
    text = shes("list", tmp_path / "runs")
    assert "│ point-gather-coevolved │" in text
    assert "…" not in text


def test_list_tells_of_runs_that_are_stopped_running_or_damaged(shes, tiny_run, tmp_path):
    stopped = shutil.copytree(tiny_run, tmp_path / "runs" / "a")
    record = json.loads((stopped / "config.json").read_text())
    record["config"]["run"]["generations"] = 9
    (stopped / "config.json").write_text(json.dumps(record))
    for name in "bcd":
        shutil.copytree(stopped, tmp_path / "runs" / name)
    (tmp_path / "runs" / "c" / "checkpoints" / "last.npz").write_bytes(b"")
    (tmp_path / "runs" / "d" / "config.json").write_text("{")
    with RunFolder(tmp_path / "runs" / "b").lock():
        found = json.loads(shes("list", tmp_path / "runs", "--json"))["runs"]
    assert [(Path(run["run"]).name, run["state"]) for run in found] == [
        ("a", "stopped"), ("b", "running"), ("c", "unreadable"), ("d", "unreadable"),
    ]  # fmt: skip
    assert "cannot be read" in found[-1]["problem"]


def test_list_shows_the_runs_that_cannot_be_read_with_the_reason(shes, tiny_run, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    for name in ("huge", "theirs", "whole"):
        shutil.copytree(tiny_run, tmp_path / name)
    with zipfile.ZipFile(tmp_path / "huge" / "checkpoints" / "last.npz", "w") as archive:
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**15,)})
        archive.writestr("theta.npy", header.getvalue())
    record = json.loads((tmp_path / "theirs" / "config.json").read_text())
    record["config"]["run"]["algorithm"] = "their-own"
    (tmp_path / "theirs" / "config.json").write_text(json.dumps(record))
    record["config"]["run"]["env"] = 7
    (tmp_path / "whole" / "config.json").rename(tmp_path / "kept")
    (tmp_path / "whole" / "config.json").write_text(json.dumps(record))
    assert "unreadable" in shes("list", tmp_path)
    (tmp_path / "kept").replace(tmp_path / "whole" / "config.json")
    (tmp_path / "another").mkdir()
    (tmp_path / "another" / "config.json").write_text("{}")

    found = {Path(run["run"]).name: run for run in json.loads(shes("list", tmp_path, "--json"))["runs"]}
    states = {"huge": "unreadable", "theirs": "unreadable", "whole": "finished"}
    assert {name: run["state"] for name, run in found.items()} == states
    theirs = found["theirs"]
    assert (theirs["env"], theirs["algorithm"]) == ("point-gather", "their-own")
    reached = ("generation", "generations", "env_steps", "best_score")
    assert [theirs[name] for name in reached] == [found["whole"][name] for name in reached]
    assert "unknown algorithm 'their-own'" in theirs["problem"]
    text = shes("list", tmp_path)
    assert re.search(r"theirs +│ point-gather +│ 4 / 4 +│ \d+\.\d\d +│ unreadable", text)
    assert "theirs is unreadable: " in text
    assert "--import MODULE" in text


def test_memory_that_runs_out_is_one_line(capsys, monkeypatch):
    def envs():
        raise MemoryError

    monkeypatch.setattr("shes.envs.catalogue.list_environments", envs)
    assert main(["envs"]) == 2
    assert re.fullmatch(r"Error: not enough memory \(no more is free\)\. .*\n", capsys.readouterr().err)


def test_info_shows_what_a_run_is(shes, tiny_run):
    text = shes("info", tiny_run)
    assert re.search(r"env +│ point-gather", text)
    assert re.search(r"state +│ finished", text)
    assert "problem" not in text
    assert re.search(r"sigma +│ 0\.070", shes("info", tiny_run, "--full"))
    assert json.loads(shes("info", tiny_run, "--json"))["config"]["evolution"]["sigma"] == 0.07


def test_info_shows_how_a_shipped_agent_was_trained(shes, agent):
    told = read_agent(agent)
    text = shes("info", agent)
    assert f"{told.evaluation.score} over {told.evaluation.episodes} fresh episodes" in text
    for other in (told.evaluation.constant, told.evaluation.random):
        assert re.search(rf"score, {other.controller} +│ {other.score} ", text)
    assert f"Trained by:\n{told.commands[0]}\n" in text
    found = json.loads(shes("info", agent, "--json"))
    assert {**found, **told.to_dict()} == found


def test_a_shipped_agent_is_named_where_a_run_is_read(shes, agent, tiny_run):
    one, other = (
        json.loads(shes("evaluate", run, "--episodes", 2, "--workers", 1, "--json")) for run in (agent, tiny_run)
    )
    assert one == {**other, "run": agent}
    assert shes("plot", agent) == "Learning curves: curves.png\n"
    shes("train", "point-gather", *TINY, "--primitive-hidden", 4, "--primitive", agent, "--out", "run")
    assert RunFolder.open("run").read_config().transfer.primitive == agent
    assert {path.name for path in Path().iterdir()} == {"curves.png", "run"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["resume", "point-food"],
            r"Error: point-food is a shipped agent, part of the package.*--primitive point-food",
        ),
        (["evaluate", "./point-food"], r"Error: point-food does not exist\. Give the folder .*\(its --out\)\.$"),
        (
            ["evaluate", "point-fod"],
            r"Error: point-fod does not exist\. .*shipped agent: point-food\. Did you mean 'po",
        ),
    ],
)
def test_a_shipped_agent_is_not_resumed_and_a_path_is_no_name(capsys, agent, words, message):
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert re.search(message, err)


def test_train_says_where_the_run_is_and_what_to_do_next(shes, tmp_path, tiny_run):
    path = tmp_path / "run"
    text = shes("train", "point-gather", *TINY, "--out", path)
    assert f"Training point-gather (smoke) on this process. Run folder: {path}\n" in text
    assert re.search(r"Done: 4 generations, best evaluation score -?[\d.]+ \(generation \d\)\.\n", text)
    assert f"Next: shes evaluate {path} · shes render {path} · shes plot {path}\n" in text
    assert runs.differences(tiny_run, path) == []  # the same as by `shes.train`


def test_train_makes_a_folder_below_runs_if_none_is_named(shes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shes("train", "point-gather", *TINY, "--generations", 1)
    (path,) = (tmp_path / "runs").iterdir()
    assert path.name.startswith("point-gather-smoke-seed5-")


def test_values_are_written_in_several_ways(shes, tmp_path):
    path = tmp_path / "run"
    words = ["--preset=smoke", "--population_size", "4", "point-gather", "--hidden", "4", "3", "--sigma=0.5"]
    none = ["--evaluation-horizon", "none", "--no-minimum-goal-distance", "--weight-decay=0", "--backend", "serial"]
    shes("train", *words, *none, "--workers=2", "--horizon", 5, "--generations=1", f"--out={path}")
    values = RunFolder.open(path).read_config().values
    assert values.items() >= {
        "env": "point-gather", "preset": "smoke", "population_size": 4, "hidden": (4, 3), "sigma": 0.5,
        "evaluation_horizon": None, "minimum_goal_distance": False, "weight_decay": 0, "num_workers": 2,
    }.items()  # fmt: skip
    shes("resume", path, "--workers", "3", "--generations", "2")
    assert RunFolder.open(path).read_config().workers.num_workers == 3


def test_minutes_end_a_call_and_resume_goes_on(shes, tmp_path, tiny_run):
    path = tmp_path / "run"
    text = shes("train", "point-gather", *TINY, "--minutes", "1e-6", "--out", path)
    assert "Done: 0 generations" in text
    shes("resume", path)
    assert runs.differences(tiny_run, path) == []


def test_resume_goes_on_to_a_new_last_generation(shes, tmp_path, tiny_run):
    path = tmp_path / "run"
    shes("train", "point-gather", *TINY, "--generations", 2, "--out", path)
    text = shes("resume", path, "--generations", 4)
    assert "after generation 2. Run folder" in text
    assert "Done: 4 generations" in text
    assert runs.differences(tiny_run, path) == []


def test_a_folder_with_brackets_is_printed_as_it_is(shes, tmp_path):
    path = tmp_path / "[b] [/b]"
    text = shes("train", "point-gather", *TINY, "--generations", 1, "--out", path)
    assert f"Run folder: {path}\n" in text
    quoted = shlex.quote(str(path))  # to be copied into a shell
    assert f"Next: shes evaluate {quoted} · shes render {quoted} · shes plot {quoted}\n" in text


def test_evaluate_prints_a_table_or_json(shes, tiny_run):
    text = shes("evaluate", tiny_run, "--episodes", 3, "--workers", 1)
    assert re.search(r"score_mean +│ +-?[\d.]+ ", text)
    (line,) = shes("evaluate", tiny_run, "--episodes", 3, "--workers", 1, "--checkpoint", "last", "--json").splitlines()
    found = json.loads(line)
    assert (found["run"], found["checkpoint"], found["episodes"]) == (str(tiny_run), "last", 3)
    assert {"score_mean", "score_std", "return_mean", "success_rate"} <= set(found)


def test_plot_says_where_the_picture_is(shes, tiny_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert shes("plot", tiny_run) == "Learning curves: curves.png\n"
    assert shes("plot", tiny_run, tiny_run, "--out", "b.pdf", "--x", "generation") == "Learning curves: b.pdf\n"
    assert {path.name for path in tmp_path.iterdir()} == {"curves.png", "b.pdf"}


# Ctrl-C.


@pytest.mark.parametrize(
    ("command", "where"), [("train", "_go_on"), ("resume", "_go_on"), ("train", "build_algorithm")]
)
def test_ctrl_c_says_how_to_go_on_if_there_is_a_run(capsys, tmp_path, tiny_run, monkeypatch, command, where):
    def interrupted(*arguments, **keywords):
        raise KeyboardInterrupt

    monkeypatch.setattr(f"shes.runs.train.{where}", interrupted)
    path, more = tmp_path / "a run", ["--out", str(tmp_path / "a run")]
    words = ["point-gather", *TINY, *more] if command == "train" else [str(tiny_run), "--generations", "9"]
    assert main([command, *words]) == 130
    out, err = capsys.readouterr()
    found = shlex.quote(str(path)) if command == "train" else tiny_run
    assert out.endswith(f"Go on: shes resume {found}\n") if where == "_go_on" else out == ""
    assert err == "Interrupted.\n"


def test_ctrl_c_before_there_is_a_run_promises_nothing(capsys, tmp_path, monkeypatch):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("shes.runs.train.build_algorithm", interrupted)
    assert main(["train", "point-gather", *TINY, "--out", str(tmp_path / "run")]) == 130
    assert capsys.readouterr() == ("", "Interrupted.\n")


# Videos and windows: what is behind them has its own tests.


HANDED_ON = {
    "render": (
        ["--checkpoint", "0", "last", "--out=x.mp4", "a run", "b", "--camera", "top", "--episode", 3, "--seed", 7,
         "--size", 240, "--steps", 50, "--out", "b.mp4", "--speed", 2, "--sensors"],
        {"runs": ("a run", "b"), "checkpoints": ("0", "last"), "camera": "top", "episode": 3,
         "seed": 7, "size": 240, "steps": 50, "speed": 2.0, "sensors": True, "out": "b.mp4"},
    ),
    "watch": (
        ["a run", "--checkpoint", "12", "--seed", 3],
        {"run": "a run", "checkpoint": "12", "seed": 3},
    ),
    "report": (
        ["a run", "b", "--out", "a.html", "--episodes", 7, "--seed", 3, "--workers", 2,
         "--no-video"],
        {"runs": ("a run", "b"), "episodes": 7, "seed": 3, "num_workers": 2, "video": False,
         "out": "a.html"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("command", HANDED_ON)
def test_a_command_hands_on_its_flags(monkeypatch, command):
    words, expected = HANDED_ON[command]
    function, given = find_command(command), []

    @wraps(function)
    def fake(**values):
        values.pop("on_step", None)
        given.append(values)

    monkeypatch.setattr(sys.modules[function.__module__], command, fake)
    assert main([command, *map(str, words)]) == 0
    assert given == [expected]


# Modules of the user.


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


def test_an_environment_of_an_imported_module_can_be_used_like_any_other(shes, tmp_path, own_module):
    name = own_module(OWN)
    rows = json.loads(shes("envs", "--json", "--import", name, "--import=json"))
    assert "point-own" in [row["name"] for row in rows]
    assert "for point-own" in " ".join(shes(f"--import={name}", "train", "point-own", "--help").split())
    path = tmp_path / "run"
    shes("train", "--import", name, "point-own", *TINY, "--generations", 1, "--out", path)
    shes("resume", path, "--generations", 2, "--import", name)
    assert json.loads(shes("evaluate", path, "--episodes", 2, "--workers", 1, "--json", "--import", name))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("raise ValueError('not today')", r"--import NAME: the module failed: ValueError: not today\."),
        ("import there_is_none", r"the module failed: ModuleNotFoundError: No module named 'there_is_none'"),
        ("import sys; sys.exit('bye')", r"the module failed: SystemExit: bye\."),
        (OWN.replace("point-own", "Point Own"), r"the module failed: ConfigError: .*'Point Own'"),
    ],
)
def test_a_module_that_fails_is_an_error_that_names_it(capsys, own_module, content, message):
    name = own_module(content)
    assert main(["envs", "--import", name]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert re.search(message.replace("NAME", name), err)
    with pytest.raises(ConfigError) as error:
        main(["envs", "--import", name, "--debug"])
    assert error.value.__cause__ is not None


def test_the_installed_command_and_the_module_are_the_same_program():
    shes = Path(sys.executable).with_name("shes")
    found = {
        subprocess.run([*command, "--version"], capture_output=True, text=True, check=True).stdout
        for command in ([str(shes)], runs.COMMAND)
    }
    assert found == {f"shes {version('shes')}\n"}
