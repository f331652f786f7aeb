"""The demo's drawing. Its training is that of `shes train`."""

import io
import subprocess
import sys

import pytest
from rich.console import Console

from shes.cli import demo
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


@pytest.mark.parametrize(("is_begun", "text"), [(False, "Stopped before the first run."), (True, "are in runs/demo-")])
def test_ctrl_c_names_the_folder_of_the_runs_if_there_is_one(tmp_path, monkeypatch, capsys, is_begun, text):
    def interrupted(console, folder):
        if is_begun:
            folder.mkdir(parents=True)
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(demo._DEMOS, "point", interrupted)
    assert demo._demo("point") == 130
    assert text in capsys.readouterr().out


def test_nothing_slow_is_imported_before_ctrl_c_is_handled():
    code = "import sys, shes.cli.demo; print({'mujoco', 'scipy', 'matplotlib'} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
