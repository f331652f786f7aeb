"""The help: readable, complete, quick; every setting of a run is a flag in a group."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from shes.cli import commands, main
from shes.cli.commands import SUMMARIES, load_command
from shes.cli.commands.plot import X_AXES
from shes.cli.options import options_in
from shes.cli.parsing import parse
from shes.cli.settings import setting_groups
from shes.envs.registry import ENVIRONMENTS
from shes.runs.config import TrainConfig, execution_settings
from shes.settings import flag as plain_flag
from shes.training.presets import PRESETS, make_config
from shes.viewing import plot, render

CONFIG = TrainConfig.of(env="ant-gather")
SETTINGS = [name for name in CONFIG.settings if name not in ("env", "external")]


def flag(name):
    return CONFIG.setting(name).flag if name in CONFIG.settings else plain_flag(name)


@pytest.fixture
def shes(capsys, monkeypatch):
    """Return a function that runs a command line that succeeds, and returns what it printed."""
    monkeypatch.setenv("COLUMNS", "80")

    def run(*words):
        assert main(list(words)) == 0
        out, err = capsys.readouterr()
        assert err == ""
        return out

    return run


# All commands.


@pytest.mark.parametrize("words", [[], ["--help"], ["-h"], ["help"]])
def test_help_names_every_command(shes, words):
    text = shes(*words)
    for command in SUMMARIES:
        assert re.search(rf"^  {command} +\w", text, re.MULTILINE)
    assert "First steps: shes train point-gather" in text
    assert "--import MODULE" in text


def test_the_commands_are_the_files_in_their_folder():
    files = {path.stem for path in Path(commands.__file__).parent.glob("[!_]*.py")}
    assert files == set(SUMMARIES) == {load_command(name).name for name in SUMMARIES}
    assert {
        "envs",
        "list",
        "train",
        "resume",
        "evaluate",
        "plot",
        "render",
        "watch",
        "bench",
        "experiment",
        "completion",
    } == files


@pytest.mark.parametrize("command", SUMMARIES)
@pytest.mark.parametrize("columns", [60, 80, 200])
def test_every_command_explains_itself_within_the_terminal(shes, monkeypatch, command, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    text = shes(command, "--help")
    assert text.startswith(f"usage: shes {command}")
    texts = [line for line in text.splitlines() if not line.lstrip().startswith(("shes ", "-", "{", "usage"))]
    assert max(len(line) for line in texts) <= min(columns, 100)
    for option in options_in(load_command(command).groups_for([])):
        assert option.text, option.name
        assert all(re.search(rf"^  .*{shown}\b", text, re.MULTILINE) for shown in option.shown_flags)


@pytest.mark.parametrize("words", [["bench"], ["bench", "-h"], ["completion"]])
def test_a_command_that_has_nothing_to_do_explains_itself(shes, words):
    assert shes(*words).startswith(f"usage: shes {words[0]} {{")


def test_the_help_loads_no_slow_package_beyond_what_import_shes_does():
    code = (
        "import sys, shes; before = set(sys.modules); from shes.cli import main; main(['--help']); "
        "print(*(set(sys.modules) - before))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    slow = {"gymnasium", "matplotlib", "mujoco", "numpy", "rich", "tyro"}
    assert slow & set(done.stdout.splitlines()[-1].split()) == set()


@pytest.mark.parametrize(("no_color", "expected"), [("", True), ("1", False)])
def test_headings_are_bold_in_a_terminal(shes, monkeypatch, no_color, expected):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    if no_color:
        monkeypatch.setenv("NO_COLOR", no_color)
    assert ("\x1b[1mworkers:\x1b[0m" in shes("resume", "--help")) is expected


def test_the_choices_are_those_of_the_functions_behind():
    assert set(X_AXES) == set(plot.X_AXES)
    cameras = next(o for o in options_in(load_command("render").groups_for([])) if o.name == "camera")
    assert set(cameras.choices) == set(render.VIEWS)


# The settings of a run.


def test_train_begins_with_usage_a_sentence_and_examples(shes):
    lines = shes("train", "--help").splitlines()
    assert lines[0] == "usage: shes train ENV [--FLAG VALUE ...]"
    assert lines[2].startswith("Train on an environment")
    examples = [line for line in lines[:12] if line.startswith("  shes train ")]
    assert len(examples) == 2


def test_examples_are_command_lines_that_parse():
    for name in SUMMARIES:
        command = load_command(name)
        for example in command.examples:
            program, called, *words = example.partition(" >")[0].split()
            assert (program, called) == ("shes", name)
            assert parse(options_in(command.groups_for(words)), words, name)


def test_train_explains_every_setting_with_the_values_of_the_preset(shes):
    text = shes("train", "point-gather", "--preset", "paper", "--help")
    for setting in SETTINGS:
        assert re.search(rf"^  {flag(setting)}[ ,]", text, re.MULTILINE), setting
    assert "preset 'paper'" in text
    assert re.search(r"--sigma FLOAT.*?\(default: 0\.02\)", text, re.DOTALL)
    assert re.search(r"--hidden \[INT \.\.\.\].*?\(default:\s+256\s+256\s+256\)", text, re.DOTALL)
    assert all(name in text for name in (*ENVIRONMENTS, *PRESETS))
    assert "preset 'laptop'" in shes("train", "--help")


def test_train_shows_choices_and_types_as_people_write_them(shes):
    text = shes("train", "--help")
    assert re.search(r"^  --mirrored \{quad,pair,none\}$", text, re.MULTILINE)
    assert re.search(r"^  --preset \{paper,laptop,smoke\}$", text, re.MULTILINE)
    assert re.search(r"^  --minutes FLOAT\|none  ", text, re.MULTILINE)
    assert re.search(r"^  --workers INT  ", text, re.MULTILINE)
    assert not re.search(r"--env(?!-steps)\b|--num-workers|\{None\}|\bSTR\b|\bNone\b", text)


@pytest.fixture(scope="module")
def setting_options():
    return options_in(setting_groups(CONFIG))


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("setting", SETTINGS)
def test_the_value_of_every_setting_can_be_written_on_the_command_line(setting_options, setting, preset):
    options, value = setting_options, make_config("ant-gather", preset).settings[setting]
    if isinstance(value, bool):
        words = [flag(setting) if value else flag(setting).replace("--", "--no-")]
    else:
        words = [flag(setting), *(str(item) for item in (value if isinstance(value, tuple) else (value,)))]
    assert parse(options, words, "train") == {setting: value}


def test_resume_takes_the_settings_that_change_no_number():
    options = options_in(load_command("resume").groups_for([]))
    assert {option.name for option in options} == {"run", *execution_settings()} - {"preset"}
