"""The command line: what it prints, aliases, help, JSON. Wrong input is in e2e/test_bad_input.py."""

import json
import re
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from shes import cli
from shes.cli import main
from shes.envs.registry import ENVIRONMENTS
from shes.experiments.config import TrainConfig
from shes.experiments.presets import PRESETS
from shes.experiments.run_folder import RunFolder
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
        try:
            code = main([str(word) for word in words])
        except SystemExit as left:  # tyro leaves by itself after its help
            code = left.code
        out, err = capsys.readouterr()
        assert (code, err) == (0, "")
        return out

    return run


@pytest.mark.parametrize("words", [[], ["--help"], ["-h"], ["help"]])
def test_help_names_every_command(shes, words):
    text = shes(*words)
    for command in ("envs", "train", "resume", "evaluate", "plot", "bench"):
        assert re.search(rf"^  {command} +\w", text, re.MULTILINE)
    assert "First steps: shes train point-gather" in text


def test_the_commands_are_those_of_the_help():
    assert set(cli._COMMANDS) == {"envs", "train", "resume", "evaluate", "plot", "bench"}


def test_version(shes):
    assert shes("--version") == f"shes {version('shes')}\n"


@pytest.mark.parametrize("command", ["resume", "evaluate", "plot", "envs"])
def test_every_command_explains_itself(shes, command):
    text = shes(command, "--help")
    assert text.startswith(f"usage: shes {command}")


def test_train_explains_every_setting_with_the_values_of_the_preset(shes):
    text = shes("train", "point-gather", "--preset", "paper", "--help")
    for setting in TrainConfig.__dataclass_fields__:
        assert "--" + setting.replace("_", "-") in text
    assert "preset 'paper'" in text
    assert re.search(r"--sigma FLOAT.*?\(default: 0\.02\)", text, re.DOTALL)
    assert re.search(r"--hidden .*?\(default: 256 256 256\)", text, re.DOTALL)
    assert all(name in text for name in (*ENVIRONMENTS, *PRESETS))
    assert "preset 'laptop'" in shes("train", "--help")


def test_bench_explains_itself(shes):
    assert "usage: shes bench {rollout,update}" in shes("bench")
    assert "usage: shes bench {rollout,update}" in shes("bench", "--help")


def test_envs_lists_the_registry(shes):
    text = shes("envs")
    assert all(name in text for name in ENVIRONMENTS)
    rows = json.loads(shes("envs", "--json"))
    assert [row["name"] for row in rows] == list(ENVIRONMENTS)
    assert [(row["observation"], row["action"]) for row in rows] == [(50, 8), (25, 2)]
    assert all(row["task"] for row in rows)


def test_train_says_where_the_run_is_and_what_to_do_next(shes, tmp_path, tiny_run):
    path = tmp_path / "run"
    text = shes("train", "point-gather", *TINY, "--out", path)
    assert f"Training point-gather (smoke) on this process. Run folder: {path}\n" in text
    assert re.search(r"Done: 4 generations, best evaluation score -?[\d.]+ \(generation \d\)\.\n", text)
    assert f"Next: shes evaluate {path} · shes plot {path}\n" in text
    assert runs.differences(tiny_run, path) == []  # the same as by `shes.train`


def test_train_makes_a_folder_below_runs_if_none_is_named(shes, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shes("train", "point-gather", *TINY, "--generations", 1)
    (path,) = (tmp_path / "runs").iterdir()
    assert path.name.startswith("point-gather-smoke-seed5-")


def test_aliases_and_both_ways_to_write_a_value(shes, tmp_path):
    path = tmp_path / "run"
    words = ["--preset=smoke", "--workers=2", f"--out={path}", "--hidden", "4", "3", "--sigma=0.5", "--generations=1"]
    shes("train", "point-gather", *words, "--population-size=4", "--horizon=5", "--backend=serial")
    config = RunFolder.open(path).read_config()
    assert (config.preset, config.num_workers, config.hidden, config.sigma) == ("smoke", 2, (4, 3), 0.5)
    shes("resume", path, "--workers", "3", "--generations", "2")
    assert RunFolder.open(path).read_config().num_workers == 3


def test_switches_can_be_turned_off(shes, tmp_path):
    path = tmp_path / "run"
    shes("train", "point-gather", *TINY, "--generations", 1, "--no-common-random-numbers", "--out", path)
    assert RunFolder.open(path).read_config().common_random_numbers is False


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
    assert f"Next: shes evaluate {quoted} · shes plot {quoted}\n" in text


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


def test_bench_prints_a_table_or_json(shes):
    small = ["point-gather", *TINY, "--population-size", 4, "--horizon", 5]
    found = json.loads(shes("bench", "update", *small, "--json"))
    assert found["total_ms"] > 0
    assert re.search(r"ratio +│ +[\d.]+ ", shes("bench", "rollout", *small))


def test_the_installed_command_and_the_module_are_the_same_program():
    shes = Path(sys.executable).with_name("shes")
    by_name, by_module = (
        subprocess.run(command, capture_output=True, text=True, check=True).stdout
        for command in ([str(shes), "--version"], [*runs.COMMAND, "--version"])
    )
    assert by_name == by_module == f"shes {version('shes')}\n"
