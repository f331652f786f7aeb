"""Finds an OpenGL without a screen: EGL (drivers of graphics cards, or Mesa), then OSMesa, else none."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from importlib import import_module

from mujoco.rendering.classic import gl_context

from shes.errors import ConfigError

__all__ = ["HOW_TO_GET_OPENGL", "find_opengl", "is_switched_off", "offer_opengl", "use_opengl"]

HOW_TO_GET_OPENGL = (
    "For three-dimensional pictures install EGL or OSMesa, on Debian and Ubuntu: "
    "sudo apt install libegl1 libgl1-mesa-dri (EGL), or: sudo apt install libosmesa6 (OSMesa)."
)
_PROBE_TIMEOUT_S = 60.0
_OFF = ("disable", "disabled", "off", "false", "0")
_ON = ("", "enable", "enabled", "on", "true", "1")
# What a driver does wrong may kill the process: each is tried in another one.
_PROBE = "from mujoco.{0} import GLContext; c = GLContext(8, 8); c.make_current(); c.free()"


@functools.cache
def find_opengl() -> str | None:
    """Return what MuJoCo can draw with on this machine: `egl`, `osmesa`, another name from MUJOCO_GL, or None.

    The environment variable MUJOCO_GL decides where it is set (`off` for none); else EGL and OSMesa are tried. On macOS
    the system's own OpenGL serves.

    Raises:
        ConfigError: MUJOCO_GL asks for one that does not work here.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if is_switched_off():
        return None
    if sys.platform != "linux":
        return asked or "cgl"
    if asked not in _ON:
        if not _works(asked if asked in ("egl", "osmesa") else "glfw"):
            raise ConfigError(
                f"MUJOCO_GL asks for {asked}, which does not work here. Unset MUJOCO_GL to let SHES choose, or set it "
                f"to off for flat pictures. {HOW_TO_GET_OPENGL}"
            )
        return asked
    return next((name for name in ("egl", "osmesa") if _works(name)), None)


def is_switched_off() -> bool:
    """Tell whether MUJOCO_GL says that there is to be no OpenGL."""
    return os.environ.get("MUJOCO_GL", "").lower().strip() in _OFF


def _works(name: str) -> bool:
    """Tell whether a process can make a context of this kind."""
    environment = {**os.environ, "MUJOCO_GL": "off"}
    environment.pop("PYOPENGL_PLATFORM", None)
    command = [sys.executable, "-c", _PROBE.format(name)]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, timeout=_PROBE_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def offer_opengl() -> None:
    """Let an environment that draws itself find OpenGL: those of Gymnasium look at MUJOCO_GL."""
    found = find_opengl()
    if found is not None and not os.environ.get("MUJOCO_GL"):
        os.environ["MUJOCO_GL"] = found


def use_opengl(name: str) -> None:
    """Let `mujoco.Renderer` draw with OpenGL `name`.

    MuJoCo chooses by MUJOCO_GL when it is first imported, which is long past; the renderer looks the class up here.
    """
    if name in ("egl", "osmesa"):
        os.environ["PYOPENGL_PLATFORM"] = name  # whatever it was: `find_opengl` has seen that this one works
        gl_context.GLContext = import_module(f"mujoco.{name}").GLContext
