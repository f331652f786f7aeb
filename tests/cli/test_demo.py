"""The demo's drawing. Its training is that of `shes train`."""

import io

import pytest
from rich.console import Console

from shes.cli.demo import _draw
from shes.drawing import opengl


@pytest.fixture(autouse=True)
def flat(monkeypatch):
    """Draw without OpenGL, which is fast and works on every machine."""
    monkeypatch.setenv("MUJOCO_GL", "off")
    opengl.find_opengl.cache_clear()
    yield
    opengl.find_opengl.cache_clear()


@pytest.mark.parametrize("is_terminal", [True, False])
def test_drawing_shows_its_progress_in_a_terminal_and_names_its_files(run_copy, tmp_path, is_terminal):
    out = io.StringIO()
    _draw(Console(file=out, force_terminal=is_terminal, width=200), {"walking": run_copy}, tmp_path, steps=2)
    assert ("100%" in out.getvalue()) == is_terminal
    assert f"walking: {tmp_path / 'walking.mp4'}   curves: {run_copy / 'curves.png'}" in out.getvalue()
    assert (tmp_path / "walking.mp4").stat().st_size > 0
