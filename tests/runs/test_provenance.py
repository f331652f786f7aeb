"""Where a run comes from: the versions of the packages on which its numbers depend."""

import sys
from importlib import metadata

import pytest

from shes.runs import provenance as module
from shes.runs.folder import RunFolder
from shes.runs.provenance import provenance
from shes.training.make_config import make_config

EVERY = {"python", "shes", "mujoco", "numpy"}


@pytest.fixture
def installed(monkeypatch):
    """The versions of the installed packages, which tests change. None of the packages can be imported."""
    found = {**dict.fromkeys(("shes", "mujoco", "numpy"), "1"), "jax": "0.10.2", "optax": "0.2.8"}

    def version(name):
        if name not in found:
            raise metadata.PackageNotFoundError(name)
        return found[name]

    monkeypatch.setattr(module, "_version", version)
    for name in ("jax", "optax"):
        monkeypatch.setitem(sys.modules, name, None)
    return found


@pytest.mark.parametrize(
    ("algorithm", "own"),
    [("hiro", {"jax", "optax"}), ("td3", {"jax", "optax"}), ("shes", set()), ("es", set())],
)
def test_a_run_records_the_packages_that_its_algorithm_names(installed, tmp_path, algorithm, own):
    folder = RunFolder.create(tmp_path / "run")
    folder.record_start(make_config("point-gather", "smoke", {"algorithm": algorithm}), {})
    versions = folder.read_record()["versions"]
    assert versions.keys() == EVERY | own
    assert {versions[name] for name in own} == {installed[name] for name in own}


def test_a_package_that_is_not_installed_has_no_version(installed):
    del installed["optax"]
    assert provenance("cpu", ("jax", "optax"))["versions"].keys() == {*EVERY, "jax"}


def test_a_run_of_hiro_records_jax_and_its_resume_says_that_it_has_changed(installed, tmp_path):
    config, folder = make_config("point-gather", "smoke", {"algorithm": "hiro"}), RunFolder.create(tmp_path / "run")
    folder.record_start(config, {})
    assert folder.read_record()["versions"]["jax"] == "0.10.2"
    installed["jax"] = "0.11.0"
    assert folder.record_resume(1, config) == ["jax 0.10.2 -> 0.11.0"]
