"""Completion by the tab key. bash is tried; the other shells read their script if they are there."""

import shutil
import subprocess

import pytest

from shes.cli import main
from shes.cli.commands import SUMMARIES
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.registry import ENVIRONMENTS
from shes.runs import shipped
from shes.runs.config import TrainConfig

ANTS = [name for name in sorted(ENVIRONMENTS) if name.startswith("ant-")]
POINTS = [name for name in sorted(ENVIRONMENTS) if name.startswith("point-")]
SHELLS = ("bash", "zsh", "fish", "tcsh")


@pytest.fixture
def script(capsys):
    """Return a function that returns the script for a shell."""

    def make(shell):
        assert main(["completion", shell]) == 0
        out, err = capsys.readouterr()
        assert err == ""
        return out

    return make


@pytest.fixture
def agents(tmp_path_factory, monkeypatch):
    """The names of two shipped agents."""
    names, place = ["ant-one", "point-two"], tmp_path_factory.mktemp("agents")
    for name in names:
        (place / name).mkdir()
        (place / name / "agent.json").touch()
    monkeypatch.setattr(shipped, "AGENTS", place)
    return names


@pytest.fixture
def complete(script, tmp_path):
    """Return a function that presses the tab key in bash after each line, in one bash, and returns what is offered."""
    (tmp_path / "shes.bash").write_text(script("bash"))
    (tmp_path / "a run").mkdir()
    (tmp_path / "a file").touch()

    def press(*lines):
        program = ["source ./shes.bash"]
        for line in lines:
            words = " ".join(f"'{word}'" for word in line.replace("=", " = ").split(" "))
            program += [f"COMP_WORDS=({words}) COMPREPLY=()", "COMP_CWORD=$((${#COMP_WORDS[@]} - 1))", "_shes"]
            program += ["printf '%s,' \"${COMPREPLY[@]}\"", "echo"]
        # -u: a variable that is not set is an error.
        done = subprocess.run(
            ["bash", "--norc", "-u"], input="\n".join(program), cwd=tmp_path, capture_output=True, text=True, check=True
        )
        assert done.stderr == ""
        return [[word for word in offered.split(",") if word] for offered in done.stdout.splitlines()]

    return press


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_commands_flags_environments_presets_and_choices(complete):
    expected = {
        "shes ": list(SUMMARIES),
        "shes tr": ["train"],
        "shes --ver": ["--version"],
        "shes train ": [*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS],
        "shes train po": POINTS,
        "shes train --sig": ["--sigma", "--sigma-end", "--sigma-schedule"],
        "shes train point-gather --work": ["--workers"],
        "shes train --no-m": ["--no-minimum-goal-distance"],
        "shes train --hidden 8 8 ant": ANTS,
        "shes train --preset ": ["paper", "laptop", "smoke"],
        "shes train --preset=la": ["laptop"],
        "shes train --mirrored=": ["quad", "pair", "none"],
        "shes train --sigma ": [],
        "shes --import mine train po": POINTS,
        "shes --import=mine train po": POINTS,
        "shes --import ": [],
        "shes bench ": ["rollout", "update"],
        "shes bench rollout ": [*ENVIRONMENTS, *EXTERNAL_ENVIRONMENTS],
        "shes resume ": ["a run"],
        "shes train --out a": ["a file", "a run"],
        "shes render --camera ": ["both", "follow", "top"],
        "shes evaluate run --js": ["--json"],
        "shes completion ": list(SHELLS),
        "shes nonsense ": [],
    }
    found = dict(zip(expected, complete(*expected), strict=True))
    assert {line: sorted(words) for line, words in found.items()} == {
        line: sorted(words) for line, words in expected.items()
    }


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_offers_shipped_agents_beside_folders_where_a_run_is_read(agents, complete):
    expected = {
        "shes evaluate ": ["a run", *agents],
        "shes plot point-": [agents[1]],
        "shes plot a": ["a run", agents[0]],
        "shes train ant-gather --primitive a": ["a file", "a run", agents[0]],
        "shes resume ": ["a run"],
        "shes evaluate --": [],
    }
    found = dict(zip(expected, complete(*expected), strict=True))
    assert all(word.startswith("--") for word in found.pop("shes evaluate --"))
    assert {line: sorted(words) for line, words in found.items()} == {
        line: sorted(words) for line, words in expected.items() if line in found
    }


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_offer_shipped_agents_too(script, agents, shell):
    assert script(shell).count(" ".join(agents)) == 6  # evaluate, plot, render, watch; train and bench --primitive


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_offers_every_setting_once_the_environment_is_there(complete):
    (flags,) = complete("shes train ant-gather ")
    config = TrainConfig.of(env="ant-gather")
    assert {config.setting(name).flag for name in config.settings.keys() - {"env", "external"}} <= set(flags)
    assert "--num-workers" not in flags


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_has_a_script_with_all_the_words(script, shell, tmp_path):
    text = script(shell)
    assert text.endswith("\n")
    for word in (*SUMMARIES, *ENVIRONMENTS, "laptop", "population-size", "glorot_normal"):
        assert word in text
    if shutil.which(shell):
        file = tmp_path / "script"
        file.write_text(text)
        subprocess.run([shell, "-n", str(file)], check=True, capture_output=True)


def test_the_help_says_how_to_install_it(capsys):
    assert main(["completion", "--help"]) == 0
    text = capsys.readouterr().out
    for shell in SHELLS:
        assert f"  shes completion {shell} > " in text
