"""The viewer's window: the poses that it shows, and the error without a screen."""

import shutil
import subprocess
import sys
from contextlib import nullcontext
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from shes.drawing import viewer as viewer_module
from shes.drawing.viewer import Viewer
from shes.envs.markers import FOOD, ball
from shes.envs.registry import make_task
from shes.errors import ConfigError


class FakeWindow:
    """A stand-in for MuJoCo's window that records poses and closes after some."""

    def __init__(self, model, data, frames=10_000):
        self.data, self.frames = data, frames
        self.cam = mujoco.MjvCamera()
        self.user_scn = mujoco.MjvScene(model, 100)
        self.poses, self.num_markers, self.texts, self.is_closed = [], [], [], False

    def is_running(self):
        return len(self.poses) < self.frames and not self.is_closed

    def lock(self):
        return nullcontext()

    def sync(self):
        self.poses.append(self.data.qpos.copy())
        self.num_markers.append(self.user_scn.ngeom)

    def set_texts(self, texts):
        self.texts.append(texts)

    def close(self):
        self.is_closed = True


@pytest.fixture
def windows(monkeypatch):
    """The windows opened in this test."""
    opened = []

    def launch_passive(model, data, **options):
        opened.append(FakeWindow(model, data))
        return opened[-1]

    monkeypatch.setitem(sys.modules, "mujoco.viewer", SimpleNamespace(launch_passive=launch_passive))
    monkeypatch.setattr(mujoco, "viewer", sys.modules["mujoco.viewer"], raising=False)
    monkeypatch.setattr(viewer_module, "_check_screen", lambda: None)
    return opened


def start():
    task = make_task("point-gather", 1)
    task.reset(np.array([0]), [1])
    return task, Viewer(task.build_world(task.body, task.options), 0.003)


def test_a_step_is_shown_as_a_smooth_movement_with_markers(windows):
    task, viewer = start()
    pose = task.sim.qpos[0].copy()
    viewer.show(pose, [ball((1, 1, 1), 0.4, FOOD)])
    viewer.show(pose + 3, [])
    window = windows[0]
    np.testing.assert_allclose(
        [shown - pose for shown in window.poses], np.outer([0, 0, 0, 1, 2, 3], [1, 1]), atol=1e-9
    )
    assert window.num_markers == [1, 1, 1, 0, 0, 0]
    assert window.texts == []
    viewer.show(pose, lines=["3.0 s", "score 1.0"])
    assert window.texts == [
        (mujoco.mjtFontScale.mjFONTSCALE_150, mujoco.mjtGridPos.mjGRID_TOPLEFT, "3.0 s\nscore 1.0", None)
    ]


def test_a_new_episode_does_not_fly_in(windows):
    task, viewer = start()
    pose = task.sim.qpos[0].copy()
    viewer.show(pose)
    viewer.show(pose + 3, is_new_episode=True)
    np.testing.assert_allclose(windows[0].poses[3], pose + 3)


def test_nothing_is_shown_in_a_window_that_was_closed(windows):
    task, viewer = start()
    windows[0].frames = 2
    viewer.show(task.sim.qpos[0])
    viewer.show(task.sim.qpos[0])
    assert len(windows[0].poses) == 2
    assert not viewer.is_open
    viewer.close()
    assert windows[0].is_closed


def test_the_camera_is_tied_to_the_robot(windows):
    start()
    assert windows[0].cam.type == mujoco.mjtCamera.mjCAMERA_TRACKING


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have a screen")
def test_without_a_screen_the_error_names_the_other_way(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    task = make_task("point-gather", 1)
    with pytest.raises(ConfigError, match=r"no screen to open a window on.*shes render RUN --out walk.mp4"):
        Viewer(task.build_world(task.body, task.options), 0.1)


@pytest.mark.render
@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="needs Debian's package xvfb")
def test_a_real_window_opens_shows_and_closes():
    code = """
import gymnasium, shes
env = gymnasium.make("shes/AntGather-v0", render_mode="human")
env.reset(seed=0)
for _ in range(5):
    env.step(env.action_space.sample())
print("shown")
"""
    for ending in ("env.close()", ""):
        done = subprocess.run(
            ["xvfb-run", "-a", sys.executable, "-c", code + ending], capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stdout) == (0, "shown\n"), done.stderr
