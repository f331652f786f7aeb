"""Makes the drawer that suits an environment, which may draw itself, and the machine, which may lack OpenGL.

Pictures need no screen: EGL (GPU drivers or Mesa) is tried first, then OSMesa.
"""

from __future__ import annotations

import functools
import logging
import os
import subprocess
import sys
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageOps

from shes.drawing.flat_renderer import FlatRenderer
from shes.drawing.mujoco_renderer import MAX_PIXELS, MujocoRenderer
from shes.drawing.renderer import Drawer, Picture
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.markers import Marker
from shes.errors import ConfigError
from shes.types import is_whole

logger = logging.getLogger("shes.drawing")
_HOW_TO_GET_OPENGL = (
    "For three-dimensional pictures install EGL or OSMesa, on Debian and Ubuntu: "
    "sudo apt install libegl1 libgl1-mesa-dri (EGL), or: sudo apt install libosmesa6 (OSMesa)."
)
_PROBE_TIMEOUT_S = 60.0
_OFF = ("disable", "disabled", "off", "false", "0")
_ON = ("", "enable", "enabled", "on", "true", "1")
# A faulty driver may kill the process, so each is tried in a subprocess.
_PROBE = "from mujoco.{0} import GLContext; c = GLContext(8, 8); c.make_current(); c.free()"


class PassthroughDrawer(Drawer):
    """A drawer for an environment that draws itself. Its poses are pictures [H, W, 3]; it ignores markers."""

    cameras = ("own",)

    def __init__(self, width: int, height: int) -> None:
        self.size = (width, height)

    def draw(self, pose: Picture, /, markers: Sequence[Marker] = (), camera: str = "own") -> Picture:
        """Return `pose` at this drawer's size, with black bars if the proportions differ."""
        return np.asarray(ImageOps.pad(Image.fromarray(np.asarray(pose, dtype=np.uint8)), self.size))

    def between(self, start: Picture, end: Picture, fraction: float) -> Picture:
        """Return `end`: pictures are not interpolated."""
        return end


def make_drawer(batch: EpisodeBatch, width: int, height: int) -> Drawer:
    """Return a drawer of the poses of `batch`, with pictures of this size; call it before the first reset.

    A world of MuJoCo is drawn by MuJoCo's renderer or, without OpenGL, by the flat renderer.
    """
    if batch.draws_itself:
        batch.draw_by("rgb_array")
        if not os.environ.get("MUJOCO_GL") and (found := find_opengl()):
            os.environ["MUJOCO_GL"] = found  # which Gymnasium's environments read
        return PassthroughDrawer(width, height)
    for name, pixels in (("width", width), ("height", height)):
        if not (is_whole(pixels) and 16 <= pixels <= MAX_PIXELS):
            raise ConfigError(f"{name} of a picture must be 16 to {MAX_PIXELS} pixels, got {pixels!r}. Change {name}.")
    found = find_opengl()
    if found is not None:
        return MujocoRenderer(batch.world_to_draw(), width, height, found)
    logger.warning("MUJOCO_GL is off or no OpenGL works: drawing flat pictures from above. %s", _HOW_TO_GET_OPENGL)
    return FlatRenderer(batch.world_to_draw().compile(), width, height)


@functools.cache
def find_opengl() -> str | None:
    """Return the OpenGL of this machine: `egl`, `osmesa`, another name from MUJOCO_GL, or None.

    The environment variable MUJOCO_GL takes precedence (`off` is None). Otherwise EGL and OSMesa are tried; macOS has
    its own OpenGL.
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
                f"to off for flat pictures. {_HOW_TO_GET_OPENGL}"
            )
        return asked
    return next((name for name in ("egl", "osmesa") if _works(name)), None)


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
