"""The viewer's window: the poses that it shows, and the error without a screen."""

import shutil
import subprocess
import sys
from contextlib import nullcontext
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from shes.drawing.window import Viewer, open_window
from shes.envs.markers import FOOD, Marker
from shes.errors import ConfigError
from tests.envs.episodes import make_task


class FakeWindow:
    """A stand-in for MuJoCo's window that records what it shows and closes after some frames."""

    def __init__(self, model, data, **_):
        self.data, self.frames = data, 10_000
        self.cam, self.user_scn = mujoco.MjvCamera(), mujoco.MjvScene(model, 100)
        self.poses, self.num_markers, self.texts = [], [], []
        self.lock, self.set_texts = nullcontext, self.texts.append
        FakeWindow.last = self

    def is_running(self):
        return len(self.poses) < self.frames

    def sync(self):
        self.poses.append(self.data.qpos.copy())
        self.num_markers.append(self.user_scn.ngeom)

    def close(self):
        self.frames = 0


@pytest.fixture
def opened(monkeypatch):
    """A viewer, its window and a pose to show."""
    launch = SimpleNamespace(launch_passive=FakeWindow)
    monkeypatch.setitem(sys.modules, "mujoco.viewer", launch)
    monkeypatch.setattr(mujoco, "viewer", launch, raising=False)
    task = make_task("point-gather", 1)
    task.reset(np.array([0]), [1])
    return Viewer(task.world_to_draw(), 0.003), FakeWindow.last, task.sim.qpos[0].copy()


def test_a_step_is_shown_as_a_smooth_movement_with_markers(opened):
    viewer, window, pose = opened
    viewer.show(pose, [Marker("ball", (1, 1, 1), 0.4, FOOD)])
    viewer.show(pose + 3, [])
    moved = [shown - pose for shown in window.poses]
    np.testing.assert_allclose(moved, np.outer([0, 0, 0, 1, 2, 3], [1, 1]), atol=1e-9)
    assert (window.num_markers, window.texts) == ([1, 1, 1, 0, 0, 0], [])
    viewer.show(pose, is_new_episode=True, lines=["3.0 s", "score 1.0"])  # it does not fly in
    np.testing.assert_allclose(window.poses[6], pose)
    assert window.texts[0][2] == "3.0 s\nscore 1.0"
    assert (window.cam.type, window.cam.trackbodyid) == (mujoco.mjtCamera.mjCAMERA_TRACKING, 1)


def test_nothing_is_shown_in_a_window_that_was_closed(opened):
    viewer, window, pose = opened
    window.frames = 2
    viewer.show(pose)
    viewer.show(pose)
    assert len(window.poses) == 2
    assert not viewer.is_open
    viewer.close()
    assert window.frames == 0


def test_without_a_screen_the_error_names_the_other_way(monkeypatch):
    monkeypatch.setitem(sys.modules, "glfw", SimpleNamespace(init=lambda: False))
    for task in (make_task("point-gather", 1), SimpleNamespace(robot=None)):
        with pytest.raises(ConfigError, match=r"no screen to open a window on.*shes render RUN --out walk.mp4"):
            open_window(task)


@pytest.mark.render
@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="needs Debian's package xvfb")
@pytest.mark.parametrize("ending", ["env.close()", ""])
def test_a_real_window_opens_shows_and_closes(ending):
    code = f"""
import gymnasium, shes
env = gymnasium.make("shes/AntGather-v0", render_mode="human")
env.reset(seed=0)
for _ in range(5):
    env.step(env.action_space.sample())
print("shown")
{ending}"""
    command = ["xvfb-run", "-a", sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "shown\n"), done.stderr
