"""Choice of the OpenGL: MUJOCO_GL if it is set, else the first that works."""

import logging
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from shes.drawing import opengl
from shes.drawing.flat_renderer import FlatRenderer
from shes.drawing.rendering import make_renderer
from shes.envs.registry import make_task
from shes.errors import ConfigError


@pytest.fixture
def works(monkeypatch):
    """Set which OpenGLs work on this machine; return the list of those tried."""
    tried = []

    def say(*names):
        def run(command, **options):
            name = next(name for name in ("egl", "osmesa", "glfw") if f"mujoco.{name} " in command[-1])
            tried.append(name)
            return subprocess.CompletedProcess(command, 0 if name in names else -11)

        monkeypatch.setattr(opengl.subprocess, "run", run)
        return tried

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(opengl.sys, "platform", "linux")
    opengl.find_opengl.cache_clear()
    yield say
    opengl.find_opengl.cache_clear()


def test_egl_comes_first(works):
    tried = works("egl", "osmesa")
    assert opengl.find_opengl() == "egl"
    assert opengl.find_opengl() == "egl"
    assert tried == ["egl"]


def test_osmesa_comes_second(works):
    works("osmesa")
    assert opengl.find_opengl() == "osmesa"


def test_none_is_found_where_none_works(works):
    tried = works()
    assert opengl.find_opengl() is None
    assert tried == ["egl", "osmesa"]


@pytest.mark.parametrize("word", ["off", "0", "disable", "FALSE"])
def test_it_can_be_switched_off(works, monkeypatch, word):
    works("egl")
    monkeypatch.setenv("MUJOCO_GL", word)
    assert opengl.find_opengl() is None


def test_mujoco_gl_decides(works, monkeypatch):
    works("egl", "osmesa")
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert opengl.find_opengl() == "osmesa"


def test_a_choice_that_does_not_work_is_refused(works, monkeypatch):
    works("osmesa")
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(ConfigError, match=r"asks for egl, which does not work here. Unset MUJOCO_GL.*libosmesa6"):
        opengl.find_opengl()


def test_another_kind_of_opengl_is_tried_too(works, monkeypatch):
    works("egl")
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    with pytest.raises(ConfigError, match="asks for glfw, which does not work here"):
        opengl.find_opengl()


def test_what_was_found_is_used_whatever_the_environment_said(monkeypatch):
    monkeypatch.setenv("PYOPENGL_PLATFORM", "other")
    monkeypatch.setitem(sys.modules, "mujoco.osmesa", SimpleNamespace(GLContext="the context"))
    monkeypatch.setattr(opengl.gl_context, "GLContext", None)
    opengl.use_opengl("osmesa")
    assert (os.environ["PYOPENGL_PLATFORM"], opengl.gl_context.GLContext) == ("osmesa", "the context")


def test_switched_off_it_is_not_said_to_be_missing(works, monkeypatch, caplog):
    works("egl")
    monkeypatch.setenv("MUJOCO_GL", "off")
    task = make_task("point-gather", 1)
    with caplog.at_level(logging.WARNING, logger="shes.drawing"):
        make_renderer(lambda: task.build_world(task.body, task.options), 64, 64)
    assert "MUJOCO_GL is off" in caplog.text
    assert "apt" not in caplog.text


def test_a_driver_that_hangs_does_not_work(works, monkeypatch):
    def run(command, **options):
        raise subprocess.TimeoutExpired(command, 1)

    works()
    monkeypatch.setattr(opengl.subprocess, "run", run)
    assert opengl.find_opengl() is None


def test_without_opengl_the_picture_is_flat_and_the_packages_are_named(works, caplog):
    works()
    task = make_task("point-gather", 1)
    with caplog.at_level(logging.WARNING, logger="shes.drawing"):
        renderer = make_renderer(lambda: task.build_world(task.body, task.options), 64, 64)
    assert isinstance(renderer, FlatRenderer)
    assert "libegl1" in caplog.text
    assert "libosmesa6" in caplog.text
