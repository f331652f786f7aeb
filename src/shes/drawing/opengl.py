"""Finds an OpenGL for rendering without a screen: EGL (GPU drivers or Mesa), then OSMesa."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from importlib import import_module

from mujoco.rendering.classic import gl_context

from shes.errors import ConfigError

HOW_TO_GET_OPENGL = (
    "For three-dimensional pictures install EGL or OSMesa, on Debian and Ubuntu: "
    "sudo apt install libegl1 libgl1-mesa-dri (EGL), or: sudo apt install libosmesa6 (OSMesa)."
)
_PROBE_TIMEOUT_S = 60.0
_OFF = ("disable", "disabled", "off", "false", "0")
_ON = ("", "enable", "enabled", "on", "true", "1")
# A faulty driver may kill the process, so each is tried in a subprocess.
_PROBE = "from mujoco.{0} import GLContext; c = GLContext(8, 8); c.make_current(); c.free()"


@functools.cache
def find_opengl() -> str | None:
    """Return the OpenGL of this machine: `egl`, `osmesa`, another name from MUJOCO_GL, or None.

    The environment variable MUJOCO_GL takes precedence (`off` is None). Otherwise EGL and OSMesa are tried; macOS has
    its own OpenGL.

    Raises:
        ConfigError: MUJOCO_GL names an OpenGL that does not work.
    """
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if asked in _OFF:
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


def offer_opengl() -> None:
    """Set MUJOCO_GL, which Gymnasium's environments read, to the OpenGL found, unless it is set."""
    found = find_opengl()
    if found is not None and not os.environ.get("MUJOCO_GL"):
        os.environ["MUJOCO_GL"] = found


def _works(name: str) -> bool:
    """Return whether a subprocess can create a context of OpenGL `name`."""
    environment = {**os.environ, "MUJOCO_GL": "off"}
    environment.pop("PYOPENGL_PLATFORM", None)
    command = [sys.executable, "-c", _PROBE.format(name)]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, timeout=_PROBE_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def use_opengl(name: str) -> None:
    """Make `mujoco.Renderer` use OpenGL `name`.

    MuJoCo reads MUJOCO_GL only when it is imported, so this replaces the context class that its renderer looks up.
    """
    if name in ("egl", "osmesa"):
        os.environ["PYOPENGL_PLATFORM"] = name  # overrides the caller's: `find_opengl` has tried this one
        gl_context.GLContext = import_module(f"mujoco.{name}").GLContext
