"""The help and the parsing of the command line: every setting of a run is a flag in the group of its section."""

import re
import subprocess
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from shes.cli import main, parsing
from shes.cli.program import COMMANDS
from shes.console import LineConsole
from shes.drawing.renderer import CAMERAS
from shes.runs import comparison, export
from shes.runs.config import resumable_settings
from shes.runs.make_config import make_config
from shes.runs.named_algorithms import ALGORITHMS, PRESET_NAMES
from shes.types import Listing
from shes.viewing import plot, render


def joined(text):
    """Return a help without frames and line breaks."""
    return " ".join(text.replace("│", "").split())


def test_the_overview_names_every_command_and_flag(shes):
    text = shes()
    for words in (*COMMANDS, "--help", "--help-all", "--import", "--debug"):
        assert re.search(rf"^  (-h, )?{words} +\w", text, re.MULTILINE)
    assert "First steps: shes train point-gather" in text
    assert {shes(word) for word in ("--help", "-h", "help")} == {text}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(shes, command):
    text = shes(command, "--help")
    assert text.startswith(f"usage: shes {command} ")
    assert "-h, --help" in text
    for word in ("and return", "on_step", "on-step", "`", "Raises"):  # for callers in Python
        assert word not in text


def test_the_choices_are_those_there_are():
    for function, name, known in (
        (plot.plot, "x", plot.X_AXES),
        (render.render, "camera", ("both", *CAMERAS)),
        (export.export, "format", export.FORMATS),
        (comparison.compare, "measure", comparison.MEASURES),
    ):
        assert set(get_args(get_type_hints(function)[name])) == set(known)


def test_a_command_has_the_help_of_the_function_behind_it(shes):
    text = joined(shes("render", "--help") + shes("plot", "--help"))
    assert "--camera {both,follow,top} Camera. (default: both)" in text
    assert "Checkpoints: best, last or numbers of gen" in text
    assert "left out if others have one. (required)" in text


def test_with_json_a_command_prints_nothing_but_its_facts(capsys):
    def count(first: int = 1) -> Listing:
        """Count."""
        LineConsole().print_line("counting ...")
        return Listing({"first": first}, ["counted"], errors=["one is left"])

    assert parsing.call("count", count, ["2", "--json"]) == 1
    assert capsys.readouterr() == ('{"first": 2}\n', "Error: one is left\n")
    assert parsing.call("count", count, []) == 1
    assert capsys.readouterr().out == "counting ...\ncounted\n"


@pytest.mark.parametrize(
    "line",
    [
        *("", "ant-fall", "point-flagrun"),
        *(f"--algorithm {each}" for each in ALGORITHMS),
        *(f"--preset {each}" for each in PRESET_NAMES),
    ],
)
def test_the_short_help_of_train_fits_two_screens(shes, line):
    text = shes("train", *line.split(), "--help")
    assert sum(-(-max(len(line), 1) // 80) for line in text.splitlines()) <= 48
    entries = re.split(r"\n  --(?=\w)", text.partition("everyday options")[2])[1:]
    assert 8 <= len(entries) <= 11
    assert all("(default: " in " ".join(entry.split()) for entry in entries)


def test_the_short_help_of_train_shows_what_the_preset_sets(shes):
    text = joined(shes("train", "point-gather", "--preset", "paper", "--help"))
    assert "preset paper for point-gather" in text
    assert "the SHES paper's Table I" in text.partition(" I:")[0] + " I:"  # where it is first named
    assert "--help-all" in text
    assert re.search(r"--sigma FLOAT [^-]*\(default: 0\.02\)", text)
    assert "preset laptop for ant-gather" in joined(shes("train", "--help"))


@pytest.mark.parametrize("line", ["ant-gather", "ant-flagrun --preset smoke", "point-fall", "ant-maze --algorithm es"])
def test_the_whole_help_shows_every_setting_in_its_group(shes, line):
    env, *more = line.split()
    text = shes("train", env, *more, "--help-all")
    config = make_config(env, "smoke", {"algorithm": "es"} if "es" in more else {})
    for section in config.sections:
        assert f" {section} options " in text
    for name, setting in config.settings.items():
        assert name == "env" or re.search(rf"{setting.flag}\b", text), name
    assert ("--primitive-reward" in text) is ("es" not in more)


def test_the_whole_help_says_how_values_are_written(shes):
    short, full = (joined(shes("train", flag)) for flag in ("--help", "--help-all"))
    for text in ("--num-workers INT", "--mirrored {quad,pair,none}", "Does not affect results", "shes: Evolves contr"):
        assert (text in short, text in full) == (False, True)
    for text in ("--minutes none|FLOAT", "(Table I: 1000). (default: 40)", "--hidden none|INT ..."):
        assert (text in short, text in full) == (True, True)
    assert "--env " not in full
    assert "Population and update." in full
    assert "(default: none (linear))" in joined(shes("train", "ant-flagrun", "--help-all"))


def test_resume_takes_the_settings_that_change_no_number(shes):
    text = shes("resume", "--help")
    assert not any(flag in text for flag in ("--sigma", "--preset"))
    assert all(setting.flag in text for setting in resumable_settings().values())


@pytest.fixture
def given(monkeypatch):
    """Return a function that returns environment, settings and seed that a command line of `train` gives."""
    found = []

    def train(env: str, settings: dict, *, seed: tuple[int, ...] = (), out: Path = Path("x")) -> None:
        """Take."""
        found.append((env, settings, seed))

    def run(*words):
        assert parsing.call("train", train, words) == 0
        return found[-1]

    return run


WRITTEN = {
    "": {},
    "--sigma 0.07 --workers=2 --hidden 4 3": {"sigma": 0.07, "num_workers": 2, "hidden": (4, 3)},
    "--no-freeze-primitive --evaluation_horizon=none": {"freeze_primitive": False, "evaluation_horizon": None},
    "--hidden": {"hidden": ()},
    "--hidden none --primitive-hidden none": {"hidden": (), "primitive_hidden": None},
    "--weight-decay 0 --fall-price=0": {"weight_decay": 0.0, "fall_price": 0.0},
    '--env-kwargs {"a":3} --reset-options none': {"env_kwargs": '{"a":3}', "reset_options": None},
}


@pytest.mark.parametrize("line", WRITTEN)
def test_only_what_is_written_is_given_zero_and_none_too(given, line):
    """Also a value that the preset has."""
    assert given("point-gather", *line.split()) == ("point-gather", WRITTEN[line], ())


@pytest.mark.parametrize(
    "line",
    [
        "--primitive ant-maze ant-push --seed 1 2",
        "--primitive=ant-maze --seed 1 2 ant-push",
        "--out point-gather --primitive ant-maze --seed 1 2 ant-push",
        "--seed 1 2 ant-push --primitive ant-maze --out point-gather",
    ],
)
def test_the_value_of_a_flag_is_not_taken_for_the_environment(given, line):
    assert given(*line.split()) == ("ant-push", {"primitive": "ant-maze"}, (1, 2))


@pytest.mark.parametrize("preset", [*PRESET_NAMES])
def test_the_value_of_every_setting_can_be_written(given, preset):
    config = make_config("ant-gather", preset)
    words, expected, settings = [], {}, config.settings
    for name in sorted(config.values.keys() - {"env", "seed"}):
        value, flag = config.values[name], settings[name].flag
        if isinstance(value, bool):
            words.append(flag if value else flag.replace("--", "--no-"))
        else:
            words += [flag, *(str(item) for item in (value if isinstance(value, tuple) else (value,)))]
        expected[name] = value
    assert given("ant-gather", *words) == ("ant-gather", expected, ())


TWICE = [
    "--hidden 1 --sigma 1 --hidden=2",
    "--primitive a --sigma 1 --primitive=b",
    "--num-workers=2 --workers=1",
    "--no-normalise_inputs --mirrored pair --normalise-inputs",
    "--sweep sigma=1 --sweep seed=1 --seed 1 --seed=2",
]


@pytest.mark.parametrize("line", TWICE)
def test_a_flag_given_twice_is_refused(capsys, line):
    assert main(["train", "point-gather", "--preset", "smoke", *line.split()]) == 2
    assert f"{line.split()[-1].partition('=')[0]} is given twice. Give it once" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "default"),
    [
        ("train point-gather --preset paper --sigma abc", "0.02"),
        ("train point-gather --critic-learning-rate abc", "0.001"),
        ("resume x --generations abc", "as before"),
    ],
)
def test_the_error_for_a_value_shows_the_default_of_its_flag(capsys, monkeypatch, line, default):
    monkeypatch.setenv("COLUMNS", "160")
    assert main(line.split()) == 2
    assert re.findall(r"\(default: (.*?)\)", capsys.readouterr().err) == [default]


COMPLETED = {
    "shes tra": ["train"],
    "shes train --explore-": ["--explore-horizon"],
    "shes train --preset smo": ["smoke"],
    "shes evaluate x --epis": ["--episodes"],
}


def test_bash_completes_commands_flags_and_choices(shes, tmp_path):
    script = tmp_path / "shes.bash"
    script.write_text(shes("completion", "bash"))
    code = f"source {script}\ncompleting=$(complete -p shes | grep -oP '(?<=-F )\\S+')\n"
    for line in COMPLETED:
        words = line.split()
        code += f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}; COMP_LINE='{line}'\n"
        code += f"COMP_POINT={len(line)}; COMPREPLY=(); $completing; echo ${{COMPREPLY[@]}}\n"
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=True)
    assert [line.split() for line in done.stdout.splitlines()] == list(COMPLETED.values())
