"""The demo's drawing. Its training is that of `shes train`."""

import io
import subprocess
import sys

import numpy as np
import pytest
from rich.console import Console

from shes.cli import demo
from shes.cli.demo import _draw, _show
from shes.drawing import make_drawer
from shes.runs.evaluate import evaluation_seeds
from shes.streams import Purpose
from shes.viewing.playback import Playback


@pytest.fixture(autouse=True)
def flat(monkeypatch):
    """Draw without OpenGL, which is fast and works on every machine."""
    monkeypatch.setenv("MUJOCO_GL", "off")
    make_drawer.find_opengl.cache_clear()
    yield
    make_drawer.find_opengl.cache_clear()


@pytest.mark.parametrize("is_terminal", [True, False])
def test_both_agents_are_drawn_in_the_same_episode_with_progress(monkeypatch, run_copy, tmp_path, is_terminal):
    seeds, captions, out = [], [], io.StringIO()
    monkeypatch.setattr("shes.viewing.render.captioned", lambda view, parts: captions.append(parts[0]) or view)
    monkeypatch.setattr(Playback, "play", lambda self, seed, play=Playback.play: seeds.append(seed) or play(self, seed))
    console = Console(file=out, force_terminal=is_terminal, width=200)
    _draw(console, run_copy, tmp_path / "walking.mp4", episode=2, camera="top", steps=2)
    assert seeds == [evaluation_seeds(demo._SEED, 0, 3, Purpose.FRESH_EPISODES)[2]] * 2
    last = [facts for facts in captions if "time is up" in facts]
    assert {(facts[0], "score" in facts[2]) for facts in last} == {("untrained", True), ("after 1 generation", True)}
    assert ("100%" in out.getvalue()) == is_terminal
    assert f"walking: {tmp_path / 'walking.mp4'}   curves: {run_copy / 'curves.png'}" in out.getvalue()
    assert (tmp_path / "walking.mp4").stat().st_size > 0


def test_the_video_is_of_the_episode_nearest_to_the_printed_mean(monkeypatch, tmp_path):
    found = {"0": np.zeros(4), "best": np.array([9.0, 0.0, 6.0, 4.0])}
    monkeypatch.setattr(demo.shes, "evaluate", lambda *_, checkpoint, **__: found[checkpoint])
    out = io.StringIO()
    assert _show(Console(file=out, width=200), tmp_path, "score", lambda results: results) == 3
    assert "0.00 before training, 4.75 after" in out.getvalue()


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
