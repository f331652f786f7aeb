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
from typing import Any, TypeAlias

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageOps

from shes.drawing.mujoco_renderer import MAX_PIXELS, MujocoRenderer
from shes.drawing.renderer import Picture, Renderer, box_corners, outlines
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.markers import ROBOT, Marker
from shes.errors import ConfigError
from shes.types import F64Array, is_whole

logger = logging.getLogger("shes.drawing")
_HOW_TO_GET_OPENGL = (
    "For three-dimensional pictures install EGL or OSMesa, on Debian and Ubuntu: "
    "sudo apt install libegl1 libgl1-mesa-dri (EGL), or: sudo apt install libosmesa6 (OSMesa)."
)
_PROBE_TIMEOUT_S = 60.0
_BOX, _SPHERE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_SPHERE)
_ROUND = (_SPHERE, int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))
_OVERSAMPLING = 2  # flat pictures are drawn larger and then reduced, which smooths edges
_FOLLOW_HALF_M, _LINE_EVERY_M = 7.0, 2.0
_GROUND, _GROUND_LINE, _CHASM = (216, 221, 214), (198, 205, 197), (164, 170, 166)
_BOX_COLORS = {"platform": _GROUND, "wall": (122, 130, 143), "block": (199, 158, 107)}
_ROBOT = tuple(round(255 * part) for part in ROBOT[:3])
_OFF = ("disable", "disabled", "off", "false", "0")
_ON = ("", "enable", "enabled", "on", "true", "1")
# A faulty driver may kill the process, so each is tried in a subprocess.
_PROBE = "import mujoco as m; m.Renderer(m.MjModel.from_xml_string('<mujoco/>'), 8, 8).close()"


class FlatRenderer(Renderer):
    """A renderer that draws geoms as rectangles, circles and bars: scenery, markers, then the robot, each by height."""

    def draw(self, qpos: F64Array, markers: Sequence[Marker] = (), camera: str = "follow") -> Picture:
        """Return a picture of the world at `qpos`."""
        self.data.qpos[:] = qpos
        view = (float(qpos[0]), float(qpos[1]), _FOLLOW_HALF_M * self.scale) if camera == "follow" else self.top_view
        scenery = outlines(self.model, self.data)
        has_platforms = any(outline.kind == "platform" for outline in scenery)
        sheet = _Sheet(view, self.width, self.height, _CHASM if has_platforms else _GROUND)
        for outline in scenery:
            sheet.polygon(outline.corners, _BOX_COLORS[outline.kind])
        for marker in sorted(markers, key=lambda each: each.position[2]):
            ends = self.scale * np.array([marker.position, marker.end or marker.position])
            sheet.bar(ends, self.scale * marker.radius, tuple(round(255 * part) for part in marker.color))
        drawn = {outline.geom for outline in scenery}
        for geom in np.argsort(self.data.geom_xpos[:, 2], kind="stable").tolist():
            kind, size, place = self.model.geom_type[geom], self.model.geom_size[geom], self.data.geom_xpos[geom]
            if kind == _BOX and geom not in drawn:
                sheet.polygon(box_corners(self.model, self.data, geom), _ROBOT)
            elif kind in _ROUND:  # planes are not drawn
                half = self.data.geom_xmat[geom].reshape(3, 3)[:, 2] * (0 if kind == _SPHERE else size[1])
                sheet.bar(np.array([place - half, place + half]), size[0], _ROBOT)
        return sheet.picture()


class _Sheet:
    """An image of the ground to draw on, in metres."""

    def __init__(self, view: tuple[float, float, float], width: int, height: int, ground: tuple[int, ...]) -> None:
        """Show the area with its centre and half height (x, y, half) at `view`."""
        self._center, half = np.array(view[:2]), view[2]
        self._size = np.array([width, height])
        self._scale = _OVERSAMPLING * height / (2 * half)
        self._image = Image.new("RGB", (_OVERSAMPLING * width, _OVERSAMPLING * height), ground)
        self._draw = ImageDraw.Draw(self._image, "RGBA")
        reach = half * np.array([width / height, 1.0])
        edges = np.array([self._center - reach, self._center + reach])
        for axis, (low, high) in enumerate(edges.T):
            for place in np.arange(_LINE_EVERY_M * np.ceil(low / _LINE_EVERY_M), high, _LINE_EVERY_M):
                ends = edges.copy()
                ends[:, axis] = place
                self._draw.line(self._pixels(ends), _GROUND_LINE, _OVERSAMPLING)

    def _pixels(self, places: F64Array) -> list[tuple[float, ...]]:
        """Return the pixels at `places` [.., 2 or 3] in metres."""
        found = self._size * (_OVERSAMPLING / 2) + (places[:, :2] - self._center) * [self._scale, -self._scale]
        return [tuple(each) for each in found.tolist()]

    def polygon(self, corners: F64Array, color: tuple[int, ...]) -> None:
        """Draw a polygon with `corners` [.., 2], filled."""
        self._draw.polygon(self._pixels(corners), color)

    def bar(self, places: F64Array, radius: float, color: tuple[int, ...]) -> None:
        """Draw a line with round ends at `places` [2, 3]; where both are one place, a circle."""
        reach, ends = radius * self._scale, self._pixels(places)
        is_circle = ends[0] == ends[1]
        if not is_circle:
            self._draw.line(ends, color, max(1, round(2 * reach)))
        if is_circle or len(color) == 3:  # the overlap of transparent ends would show
            for x, y in ends[is_circle:]:
                self._draw.ellipse([x - reach, y - reach, x + reach, y + reach], color)

    def picture(self) -> Picture:
        """Return the image, reduced, as pixels [H, W, 3]."""
        return np.asarray(self._image.resize(self._size.tolist(), Image.Resampling.LANCZOS))


class PassthroughDrawer:
    """Draws an environment that draws itself. Its poses are pictures [H, W, 3]; it ignores markers."""

    cameras, model = ("own",), None

    def __init__(self, width: int, height: int) -> None:
        self.size = (width, height)

    def draw(self, pose: Any, markers: Sequence[Marker] = (), camera: str = "own") -> Picture:
        """Return `pose` at this drawer's size, with black bars if the proportions differ."""
        return np.asarray(ImageOps.pad(Image.fromarray(np.asarray(pose, dtype=np.uint8)), self.size))

    def close(self) -> None:
        """Do nothing: the environment is closed by its owner."""


Drawer: TypeAlias = Renderer | PassthroughDrawer
"""Makes pictures, of one size, of the poses of one environment."""


def make_drawer(batch: EpisodeBatch, width: int, height: int) -> Drawer:
    """Return a drawer of the poses of `batch`, with pictures of this size; call it before the first reset.

    A world of MuJoCo is drawn by MuJoCo's renderer or, without OpenGL, by the flat renderer.
    """
    if batch.robot is None:
        batch.draw_by("rgb_array")
        try:
            if found := find_opengl():
                os.environ["MUJOCO_GL"] = found  # which Gymnasium's environments read
        except ConfigError as error:  # not every environment draws by OpenGL
            logger.warning("%s", error)
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
        if not _works(asked):
            raise ConfigError(
                f"MUJOCO_GL asks for {asked}, which does not work here. Unset MUJOCO_GL to let SHES choose, or set it "
                f"to off for flat pictures. {_HOW_TO_GET_OPENGL}"
            )
        return asked
    return next((name for name in ("egl", "osmesa") if _works(name)), None)


def _works(name: str) -> bool:
    """Return whether a subprocess can create a context of OpenGL `name`."""
    environment = {**os.environ, "MUJOCO_GL": name}
    environment.pop("PYOPENGL_PLATFORM", None)
    command = [sys.executable, "-c", _PROBE]
    try:
        done = subprocess.run(command, env=environment, capture_output=True, timeout=_PROBE_TIMEOUT_S, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0
