"""The README is short and true: its links exist, its Python runs, its flags and commands exist."""

import re
from pathlib import Path

import pytest

from shes.cli.program import COMMANDS
from shes.runs.config import known_settings

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
LINKS = re.findall(r"\]\((?!http)([^)]+)\)", README)


@pytest.mark.parametrize("link", sorted(set(LINKS)))
def test_link_leads_to_a_file_or_to_the_line_it_names(link):
    path, _, anchor = link.partition("#L")
    target = ROOT / path
    assert target.exists()
    if anchor:
        assert "line" in target.read_text(encoding="utf-8").splitlines()[int(anchor) - 1]


def test_it_is_short():
    lines = README.splitlines()
    assert len(lines) <= 120
    assert [line for line in lines if len(line) > 120] == []


def test_python_example_runs(tmp_path, monkeypatch, capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(example, "README.md", "exec"), {})  # noqa: S102 - our own README
    assert len(capsys.readouterr().out.splitlines()) >= 2


def test_flags_and_commands_exist():
    known = {setting.flag for setting in known_settings().values()}
    known |= {"--no-" + setting.flag[2:] for setting in known_settings().values() if setting.kind is bool}
    known |= {"--checkpoint", "--episodes", "--help", "--help-all", "--import", "--json", "--out", "--size", "--steps"}
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", README)) <= known
    assert set(re.findall(r"^shes ([a-z]+)", README, flags=re.MULTILINE)) <= set(COMMANDS)


@pytest.mark.parametrize("name", ["README.md", "results/README.md"])
def test_nothing_is_left_to_be_filled_in(name):
    assert not re.findall(r"\b[A-Z]+_[A-Z]+\b(?<!SHES_CACHE_DIR)", (ROOT / name).read_text(encoding="utf-8"))
