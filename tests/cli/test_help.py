"""The help and the parsing of the command line: readable, quick; every setting of a run is a flag in a group."""

import re
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from typing import get_args, get_type_hints

import pytest

from shes.algorithms.registry import ALGORITHMS, PRESET_NAMES
from shes.cli import main, parsing
from shes.cli.command_table import COMMANDS, EVERYWHERE, find_command
from shes.console import LineConsole
from shes.drawing.renderer import CAMERAS
from shes.envs.registry import ENVIRONMENTS
from shes.listing import Listing
from shes.runs.sections import execution_settings
from shes.training import comparison, export
from shes.training.make_config import make_config
from shes.viewing import plot, render


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


@pytest.mark.parametrize("words", [[], ["--help"], ["-h"], ["help"]])
def test_help_names_every_command(shes, words):
    text = shes(*words)
    for command in COMMANDS:
        assert re.search(rf"^  {command} +\w", text, re.MULTILINE)
    assert "First steps: shes train point-gather" in text
    for flag in EVERYWHERE:
        assert re.search(rf"^  (-h, )?{flag} ", text, re.MULTILINE)


def test_every_command_is_found():
    assert all(callable(find_command(name)) for name in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(shes, command):
    text = shes(command, "--help")
    assert text.startswith(f"usage: shes {command} ")
    assert "-h, --help" in text
    assert "and return" not in text  # the result is for callers in Python


def test_the_help_breaks_lines_where_the_terminal_does_and_not_where_the_source_does(shes, monkeypatch):
    monkeypatch.setenv("COLUMNS", "1000")
    text = shes("bench", "--help")
    assert "relative to a bare mj_step loop on one core, which replays the same episodes. The ratio" in text
    assert "\n\nshes bench rollout ant-gather --seconds 60\n" in text


def test_no_module_of_the_command_line_knows_one_that_knows_it():
    known = {
        file.stem: set(re.findall(r"\bcli\.(\w+)", file.read_text())) - {file.stem}
        for file in Path(parsing.__file__).parent.glob("*.py")
    }
    assert "completion" in known["program"]
    TopologicalSorter(known).prepare()  # raises CycleError


def test_the_help_loads_no_slow_package_and_neither_does_the_package():
    code = "import sys; from shes.cli import main; main(['--help']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert {"matplotlib", "mujoco", "rich", "tyro"} & set(done.stdout.splitlines()[-1].split()) == set()


def test_the_choices_are_those_there_are():
    for function, name, known in (
        (plot.plot, "x", plot.X_AXES),
        (render.render, "camera", ("both", *CAMERAS)),
        (export.export, "format", export.FORMATS),
        (comparison.compare_runs, "measure", comparison.MEASURES),
    ):
        assert set(get_args(get_type_hints(function)[name])) == set(known)


def test_a_command_has_the_flags_and_the_help_of_the_function_behind_it(shes):
    text = " ".join(shes("render", "--help").replace("│", "").split())
    assert "--camera {both,follow,top} Camera. (default: both)" in text
    assert "Checkpoints: best, last or numbers of generations." in text
    for word in ("on_step", "on-step", "`", "Raises"):
        assert word not in text


def test_several_runs_are_shown_as_required(shes):
    assert "left out if others have one. (required)" in " ".join(shes("plot", "--help").replace("│", "").split())


def test_with_json_a_command_prints_nothing_but_its_facts(capsys):
    def count(first: int = 1) -> Listing:
        """Count."""
        LineConsole().print_line("counting ...")
        return Listing({"first": first}, ["counted"], errors=["one is left"])

    assert parsing.call("count", count, ["2", "--json"]) == 1
    assert capsys.readouterr() == ('{"first": 2}\n', "Error: one is left\n")
    assert parsing.call("count", count, []) == 1
    assert capsys.readouterr().out == "counting ...\ncounted\n"


# The settings of a run.


@pytest.mark.parametrize(
    "words",
    [
        [],
        *([env] for env in ENVIRONMENTS),
        *(["--algorithm", name] for name in ALGORITHMS),
        *(["--preset", name] for name in PRESET_NAMES),
    ],
    ids=lambda words: " ".join(words) or "train",
)
def test_the_help_of_train_fits_two_screens(shes, words):
    text = shes("train", *words, "--help")
    assert sum(-(-max(len(line), 1) // 80) for line in text.splitlines()) <= 48
    _, algorithm, *others = re.split(r"\n  --(?=\w)", text.partition("everyday options")[2])
    assert algorithm.startswith("algorithm ")
    assert 7 <= len(others) <= 10
    for entry in others:
        assert len(entry.strip().splitlines()) <= 2
        assert "(default: " in " ".join(entry.split())


def test_the_help_of_train_shows_what_the_preset_sets(shes):
    text = shes("train", "point-gather", "--preset", "paper", "--help")
    assert "preset paper for point-gather" in text
    assert re.search(r"--sigma FLOAT.*?\(default: 0\.02\)", text, re.DOTALL)
    assert re.search(r"--population-size INT.*?\(default: 1000\)", text, re.DOTALL)
    assert "--help-all" in text
    assert "preset laptop for ant-gather" in shes("train", "--help")


@pytest.mark.parametrize(
    ("words", "env", "settings"),
    [
        (["ant-gather"], "ant-gather", {}),
        (["point-flagrun", "--preset", "smoke"], "point-flagrun", {}),
        (["ant-push"], "ant-push", {}),
        (["point-fall"], "point-fall", {}),
        (["point-maze", "--algorithm", "es"], "point-maze", {"algorithm": "es"}),
    ],
)
def test_all_of_the_help_shows_every_setting_of_the_run_in_the_group_of_its_section(shes, words, env, settings):
    text = shes("train", *words, "--help-all")
    config = make_config(env, "smoke", settings)
    for section in config.sections:
        assert f" {section} options " in text
    for name in config.values.keys() - {"env"}:
        assert re.search(rf"{config.setting(name).flag}\b", text), name
    assert ("--primitive-reward" in text) is ("es" not in words)


def test_no_group_of_the_help_repeats_its_name(shes):
    text = shes("train", "--help-all")
    titles = re.findall(r"^ (\w+) options +\n -+ \n +(.*?) *\n", text, re.MULTILINE)
    assert ("evolution", "Population and update.") in titles
    assert [section for section, title in titles if title.rstrip(".").lower() == section] == []


def test_the_short_help_leaves_out_what_all_of_the_help_says(shes):
    short, full = (" ".join(shes("train", flag).replace("│", "").split()) for flag in ("--help", "--help-all"))
    for text in (
        "--num-workers INT", "{cpu,warp-cpu,cuda}", "[INT [INT ...]]", "extra warp; for tests", "(paper: 256 256 256)",
    ):  # fmt: skip
        assert (text in short, text in full) == (False, True)
    for text in ("--workers INT", "cpu, cuda or warp-cpu. (default: cpu)", "(Table I: 1000). (default: 40)"):
        assert text in short


def test_no_values_are_shown_as_a_word(shes):
    assert "(default: none (linear))" in " ".join(shes("train", "ant-flagrun", "--help-all").split())


def test_values_are_written_as_people_write_them(shes):
    text = shes("train", "--help-all")
    assert "--mirrored {quad,pair,none}" in text
    assert "--minutes none|FLOAT" in text
    assert "--num-workers INT, --workers INT" in text or "--workers INT, --num-workers INT" in text
    assert "--env " not in text


@pytest.fixture
def given(monkeypatch):
    """Return a function that returns the settings that a command line of `train` gives."""
    found = []

    def train(env: str, settings: dict, *, out: str = "x") -> int:
        """Take.

        Args:
            env: Name.
            settings: Settings.
            out: Folder.
        """
        found.append(settings)
        return 0

    def run(*words):
        assert parsing.call("train", train, words) == 0
        return found[-1]

    return run


def test_only_what_is_written_is_given_even_if_it_is_the_presets_value(given):
    assert given("point-gather") == {}
    assert given("point-gather", "--sigma", "0.07", "--workers=2", "--hidden", "4", "3") == {
        "sigma": 0.07, "num_workers": 2, "hidden": (4, 3),
    }  # fmt: skip
    assert given("point-gather", "--no-hold-tied", "--evaluation_horizon=none", "--hidden") == {
        "hold_tied": False, "evaluation_horizon": None, "hidden": (),
    }  # fmt: skip


def test_no_hidden_layers_are_written_as_they_are_shown(given):
    assert given("point-gather", "--hidden", "none", "--primitive-hidden", "none") == {
        "hidden": (), "primitive_hidden": None,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("words", "flag"),
    [
        (["--seed", "1", "--seed", "2"], "--seed"),
        (["--hidden=1", "--sigma", "1", "--sigma", "2", "--hidden", "2"], "--hidden"),
        (["--sweep", "sigma=1", "--sweep", "seed=1", "--seed", "1", "--seed=2"], "--seed"),
    ],
)
def test_a_flag_of_several_values_given_twice_is_refused(capsys, words, flag):
    assert main(["train", "point-gather", *words]) == 2
    assert capsys.readouterr() == ("", f"Error: {flag} is given twice. Give it once, with all its values.\n")


@pytest.mark.parametrize(
    "words",
    [
        ["--primitive", "ant-maze", "ant-push", "--observe-block", "False"],
        ["--primitive=ant-maze", "--workers", "2", "--observe-block", "none", "ant-push"],
        ["--out", "point-gather", "point-maze", "--target", "1", "-2"],
        ["--target", "1", "2", "--out", "point-gather", "point-maze"],
        ["--out", "point-gather", "--target", "1", "2", "point-maze"],
        ["--no-hold-tied", "point-maze", "--target", "1", "2"],
        ["--seed", "1", "2", "point-maze", "--target", "1", "2"],
        ["--target", "1", "2", "point-maze", "--seed", "1", "2", "--primitive", "ant-maze"],
    ],
)
def test_the_value_of_a_flag_is_not_taken_for_the_environment(monkeypatch, words):
    found = []

    def train(env: str, settings: dict, *, seed: tuple[int, ...] = (), out: Path = Path()) -> int:
        """Take."""
        found.append((env, settings.keys() & {"target", "observe_block"}, seed))
        return 0

    assert parsing.call("train", train, words) == 0
    seed = (1, 2) if "--seed" in words else ()
    assert found in ([("ant-push", {"observe_block"}, seed)], [("point-maze", {"target"}, seed)])


@pytest.mark.parametrize("preset", PRESET_NAMES)
def test_the_value_of_every_setting_can_be_written_on_the_command_line(given, preset):
    config = make_config("ant-gather", preset)
    words, expected = [], {}
    for name in sorted(config.values.keys() - {"env"}):
        value, flag = config.values[name], config.setting(name).flag
        if isinstance(value, bool):
            words.append(flag if value else flag.replace("--", "--no-"))
        else:
            words += [flag, *(str(item) for item in (value if isinstance(value, tuple) else (value,)))]
        expected[name] = value
    assert given("ant-gather", *words) == expected


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["train", "ant-gather", "--backend", "proces"], "unknown backend 'proces'. Did you mean 'processes'?"),
        (["train", "ant-gater"], "unknown environment 'ant-gater'. Did you mean 'ant-gather'?"),
        (["train", "ant-gather", "--preset", "lap"], "unknown preset 'lap'. Did you mean 'laptop'?"),
        (["evaluate", "x", "--targets", "traning"], "--targets: unknown name 'traning'. Did you mean 'training'?"),
    ],
)
def test_a_misspelled_choice_is_answered_with_the_nearest(capsys, monkeypatch, words, message):
    monkeypatch.setenv("COLUMNS", "160")
    assert main(words) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "default"),
    [
        (["train", "point-gather", "--preset", "paper", "--sigma", "abc"], "0.02"),
        (["train", "ant-maze", "--sigma", "abc"], "0.1"),
        (["train", "point-gather", "--critic-learning-rate", "abc"], "0.001"),
        (["resume", "x", "--generations", "abc"], "as before"),
    ],
)
def test_the_error_for_a_value_shows_the_default_of_its_flag(capsys, monkeypatch, words, default):
    monkeypatch.setenv("COLUMNS", "160")
    assert main(words) == 2
    assert re.findall(r"\(default: (.*?)\)", capsys.readouterr().err) == [default]


def test_resume_takes_the_settings_that_change_no_number(shes):
    text = shes("resume", "--help")
    for name, setting in execution_settings().items():
        assert (setting.flag in text) is (name != "preset")
    assert "--sigma" not in text


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish", "tcsh"])
def test_every_shell_asks_for_the_words_that_may_follow(shes, shell):
    assert "shes --complete" in shes("completion", shell)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("tra", ["train"]),
        ("completion z", ["zsh"]),
        ("train ant-fl", ["ant-flagrun"]),
        ("bench rollout point-m", ["point-maze"]),
        ("train ant-maze --target-", ["--target-sampling"]),
        ("train ant-gather --targ", []),
        ("train --help-", ["--help-all"]),
        ("evaluate x --imp", ["--import"]),
        ("train ant-maze --preset sm", ["smoke"]),
        ("train ant-maze --preset=sm", ["smoke"]),
        ("train --preset smoke --primitive ant-walker-", ["ant-walker-stiff"]),
        ("train --preset unknown --outp", []),
        ("resume runs/fi", ["runs/first"]),
        ("evaluate ant-g", ["ant-gather", "ant-gather-coevolved"]),
        ("evaluate x --epis", ["--episodes"]),
        ("evaluate x --ru", []),
        ("bench roll", ["rollout"]),
        ("plot ant-walker runs/fi", ["runs/first"]),
    ],
)
def test_what_may_stand_at_the_cursor_completes_the_line(shes, tmp_path, monkeypatch, line, expected):
    (tmp_path / "runs" / "first").mkdir(parents=True)
    (tmp_path / "runs" / "first" / "config.json").touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COMP_LINE", f"shes {line} and more")
    monkeypatch.setenv("COMP_POINT", str(len(f"shes {line}")))
    assert shes("--complete", "shes", "a", "b").split() == expected
    for name in ("COMP_LINE", "COMP_POINT"):
        monkeypatch.delenv(name)
    monkeypatch.setenv("COMMAND_LINE", f"shes {line}")  # tcsh
    assert shes("--complete").split() == expected


OWN_ENVIRONMENTS = """
print("a message of the module")
from shes import register_environment
from shes.envs.registry import find_environment
body, task = find_environment("point-gather")
register_environment("dot-gather", body, task)
"""


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("--import dots train dot-", ["dot-gather"]),
        ("train --import=dots dot-", ["dot-gather"]),
        ("train --import dots --import none dot-gather --sig", ["--sigma", "--sigma-schedule", "--sigma-end"]),
        ("train --import ", []),
        ("train --import=", []),
        ("--import dots tra", ["train"]),
    ],
)
def test_what_an_imported_module_registers_completes_the_line(shes, tmp_path, monkeypatch, line, expected):
    (tmp_path / "dots.py").write_text(OWN_ENVIRONMENTS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("COMP_LINE", f"shes {line}")
    try:
        assert shes("--complete").split() == expected
    finally:
        ENVIRONMENTS.pop("dot-gather", None)
        sys.modules.pop("dots", None)


def test_bash_takes_the_script(shes):
    done = subprocess.run(
        ["bash", "-c", f"{shes('completion', 'bash')}\ncomplete -p shes"], capture_output=True, text=True, check=True
    )
    assert (done.stdout, done.stderr) == ("complete -o default -C 'shes --complete' shes\n", "")
