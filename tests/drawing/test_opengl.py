"""Choice of the OpenGL: MUJOCO_GL if it is set, else the first that works."""

import logging
import subprocess

import pytest

from shes.drawing import make_drawer
from shes.envs.named_environments import find_environment
from shes.errors import ConfigError
from tests.envs.episodes import make_task


@pytest.fixture
def works(monkeypatch):
    """Set which OpenGLs work on this machine, or that a driver hangs; return the list of those tried."""
    tried = []

    def say(*names):
        def run(command, **options):
            tried.append(name := options["env"]["MUJOCO_GL"])
            if "hangs" in names:
                raise subprocess.TimeoutExpired(command, 1)
            return subprocess.CompletedProcess(command, 0 if name in names else -11)

        monkeypatch.setattr(make_drawer.subprocess, "run", run)
        return tried

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(make_drawer.sys, "platform", "linux")
    make_drawer.find_opengl.cache_clear()
    yield say
    make_drawer.find_opengl.cache_clear()


@pytest.mark.parametrize(
    ("working", "asked", "found", "tried"),
    [
        (("egl", "osmesa"), None, "egl", ["egl"]),
        (("osmesa",), None, "osmesa", ["egl", "osmesa"]),
        ((), None, None, ["egl", "osmesa"]),
        (("hangs",), None, None, ["egl", "osmesa"]),
        (("egl", "osmesa"), "osmesa", "osmesa", ["osmesa"]),
        *((("egl",), word, None, []) for word in ("off", "0", "disable", "FALSE")),
    ],
)
def test_the_first_opengl_that_works_or_is_asked_for_is_found(works, monkeypatch, working, asked, found, tried):
    all_tried = works(*working)
    if asked is not None:
        monkeypatch.setenv("MUJOCO_GL", asked)
    assert make_drawer.find_opengl() == make_drawer.find_opengl() == found
    assert all_tried == tried


@pytest.mark.parametrize(("asked", "other"), [("egl", "osmesa"), ("glfw", "egl"), ("nonsense", "glfw")])
def test_a_choice_that_does_not_work_is_refused(works, monkeypatch, caplog, asked, other):
    works(other)
    monkeypatch.setenv("MUJOCO_GL", asked)
    with pytest.raises(ConfigError, match=f"asks for {asked}, which does not work here. Unset MUJOCO_GL.*libosmesa6"):
        make_drawer.make_drawer(make_task("point-gather", 1), 64, 64)
    make_drawer.make_drawer(find_environment("gymnasium:CartPole-v1").make(1), 64, 64)  # which draws by other means
    assert f"asks for {asked}, which" in caplog.text


def test_a_window_system_without_a_screen_does_not_work(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    with pytest.raises(ConfigError):
        make_drawer.find_opengl.__wrapped__()


def test_without_opengl_the_packages_to_install_are_named(works, caplog):
    works()
    with caplog.at_level(logging.WARNING, logger="shes.drawing"):
        assert isinstance(make_drawer.make_drawer(make_task("point-gather", 1), 64, 64), make_drawer.FlatRenderer)
    for word in ("MUJOCO_GL", "libegl1", "libosmesa6"):
        assert word in caplog.text
