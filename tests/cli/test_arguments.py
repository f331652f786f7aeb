"""The arguments of commands are checked before any work, with one message for the command line and for Python."""

import re

import pytest

from shes.cli import main
from shes.cli.program import find_command
from shes.errors import ConfigError, UnknownNameError

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
        ("render", "size", [63, 1081], "a whole number between 64 and 1080"),
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
        with pytest.raises(ConfigError, match=f"^{re.escape(message)}$"):
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
    with pytest.raises(UnknownNameError, match=rf"^unknown {name} 'nonesuch'\. .*Set --{name}\.$"):
        find_command(command)(*GIVEN.get(command, ("no-run",)), **{name: "nonesuch"})
    assert list(tmp_path.iterdir()) == []
