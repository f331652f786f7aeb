"""Runs of several kinds, to be looked at and not to be changed, and pictures without OpenGL."""

import shutil

import pytest

from shes.drawing import make_drawer
from tests.e2e import runs


@pytest.fixture(scope="session")
def kinds(tiny_run, tmp_path_factory):
    """Folders of three repetitions, a run of another sigma, a flat one and a primitive alone, by name."""
    folder = tmp_path_factory.mktemp("kinds")
    return {
        "first": shutil.copytree(tiny_run, folder / "seeds" / "first"),
        "second": runs.train_tiny(folder / "seeds" / "second", seed=6, generations=3),
        "third": runs.train_tiny(folder / "seeds" / "third", seed=7),
        "other": runs.train_tiny(folder / "other", sigma=0.5),
        "flat": runs.train_tiny(folder / "flat", algorithm="es", generations=2),
        "flag": runs.train_tiny(folder / "flag", "point-flagrun", generations=2, evaluation_horizon=8),
    }


@pytest.fixture(autouse=True)
def without_opengl(monkeypatch):
    """Draw flat pictures, which is fast and works on every machine."""
    monkeypatch.setenv("MUJOCO_GL", "off")
    make_drawer.find_opengl.cache_clear()
    yield
    make_drawer.find_opengl.cache_clear()
