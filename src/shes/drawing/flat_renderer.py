"""Flat pictures from above, for machines without OpenGL."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import filterfalse

import mujoco
import numpy as np
from PIL import Image, ImageDraw

from shes.drawing.drawer import Picture
from shes.drawing.plan import box_corners, box_kind
from shes.drawing.renderer import Renderer, check_camera
from shes.envs.markers import ROBOT, Marker
from shes.types import F64Array

_BOX, _SPHERE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_SPHERE)
_BARS = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))
_OVERSAMPLING = 2  # pictures are drawn larger and then reduced, which smooths edges
_FOLLOW_HALF_M = 7.0
_GROUND, _GROUND_LINE = (216, 221, 214), (198, 205, 197)
_CHASM = (164, 170, 166)
_BOX_COLORS = {"platform": _GROUND, "wall": (122, 130, 143), "block": (199, 158, 107)}
_ROBOT = tuple(round(255 * part) for part in ROBOT[:3])
_LINE_EVERY_M = 2.0


class FlatRenderer(Renderer):
    """A renderer that draws geoms as rectangles, circles and bars: scenery, markers, then the robot, each by height."""

    def draw(self, qpos: F64Array, markers: Sequence[Marker] = (), camera: str = "follow") -> Picture:
        """Return a picture of the world at `qpos`."""
        check_camera(camera)
        has_platforms = any(self.model.geom(geom).name.startswith("platform") for geom in range(self.model.ngeom))
        ground = _CHASM if has_platforms else _GROUND
        sheet = _Sheet(self._window(qpos, camera), self.width * _OVERSAMPLING, self.height * _OVERSAMPLING, ground)
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        sheet.grid()
        is_box = self.model.geom_type == _BOX
        heights = self.data.geom_xpos[:, 2] + is_box * self.model.geom_size[:, 2]
        geoms = np.argsort(heights, kind="stable").tolist()
        for geom in filter(self._is_scenery, geoms):
            self._draw_geom(sheet, geom)
        for marker in sorted(markers, key=lambda each: each.position[2]):
            _draw_marker(sheet, marker)
        for geom in filterfalse(self._is_scenery, geoms):
            self._draw_geom(sheet, geom)
        return sheet.picture(self.width, self.height)

    def _window(self, qpos: F64Array, camera: str) -> tuple[float, float, float]:
        """Return the centre (x, y) and half height of the visible area, in metres."""
        if camera == "follow":
            return float(qpos[0]), float(qpos[1]), _FOLLOW_HALF_M
        return self.top_view

    def _is_scenery(self, geom: int) -> bool:
        return self.model.geom(geom).name.startswith(("floor", "wall", "platform", "block"))

    def _draw_geom(self, sheet: _Sheet, geom: int) -> None:
        """Draw a geom at its current position; planes are not drawn."""
        kind, size = int(self.model.geom_type[geom]), self.model.geom_size[geom]
        place, axes = self.data.geom_xpos[geom], self.data.geom_xmat[geom].reshape(3, 3)
        if kind == _BOX:
            sheet.polygon(box_corners(self.model, self.data, geom), _BOX_COLORS[box_kind(self.model, geom)])
        elif kind == _SPHERE:
            sheet.circle(place, size[0], _ROBOT)
        elif kind in _BARS:
            reach = axes[:, 2] * size[1]
            sheet.bar(place - reach, place + reach, size[0], _ROBOT)


def _draw_marker(sheet: _Sheet, marker: Marker) -> None:
    color = tuple(round(255 * part) for part in marker.color)
    if marker.end is not None:
        sheet.bar(np.array(marker.position), np.array(marker.end), marker.radius, color)
    else:
        sheet.circle(np.array(marker.position), marker.radius, color)


def _marks(first: float, last: float) -> F64Array:
    """Return the coordinates of the ground's lines between `first` and `last`, in metres."""
    return np.arange(_LINE_EVERY_M * np.ceil(first / _LINE_EVERY_M), last, _LINE_EVERY_M)


class _Sheet:
    """An image to draw on, in metres."""

    def __init__(
        self, window: tuple[float, float, float], width: int, height: int, ground: tuple[int, int, int]
    ) -> None:
        self._x, self._y, half = window
        self._scale = height / (2 * half)
        self._width, self._height = width, height
        self._image = Image.new("RGB", (width, height), ground)
        self._draw = ImageDraw.Draw(self._image, "RGBA")

    def _pixel(self, place: F64Array) -> tuple[float, float]:
        x, y = float(place[0]) - self._x, float(place[1]) - self._y
        return self._width / 2 + x * self._scale, self._height / 2 - y * self._scale

    def grid(self) -> None:
        """Draw the lines of the ground."""
        half_width, half_height = self._width / self._scale / 2, self._height / self._scale / 2
        for x in _marks(self._x - half_width, self._x + half_width):
            column = self._pixel(np.array([x, 0.0]))[0]
            self._draw.line([(column, 0), (column, self._height)], _GROUND_LINE, _OVERSAMPLING)
        for y in _marks(self._y - half_height, self._y + half_height):
            row = self._pixel(np.array([0.0, y]))[1]
            self._draw.line([(0, row), (self._width, row)], _GROUND_LINE, _OVERSAMPLING)

    def polygon(self, corners: Iterable[F64Array], color: tuple[int, ...]) -> None:
        """Draw a filled polygon."""
        self._draw.polygon([self._pixel(corner) for corner in corners], color)

    def circle(self, place: F64Array, radius: float, color: tuple[int, ...]) -> None:
        """Draw a filled circle."""
        x, y = self._pixel(place)
        r = radius * self._scale
        self._draw.ellipse([x - r, y - r, x + r, y + r], color)

    def bar(self, start: F64Array, end: F64Array, radius: float, color: tuple[int, ...]) -> None:
        """Draw a line with round ends."""
        width = max(1, round(2 * radius * self._scale))
        self._draw.line([self._pixel(start), self._pixel(end)], color, width)
        if len(color) == 3:  # the overlap of transparent ends would show
            self.circle(start, radius, color)
            self.circle(end, radius, color)

    def picture(self, width: int, height: int) -> Picture:
        """Return the image, reduced to `width` x `height`, as pixels [H, W, 3]."""
        return np.asarray(self._image.resize((width, height), Image.Resampling.LANCZOS))
