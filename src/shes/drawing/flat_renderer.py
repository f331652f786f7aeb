"""Flat pictures from above, for machines without OpenGL."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np
from PIL import Image, ImageDraw

from shes.drawing.renderer import Picture, Renderer, box_corners, box_kind, check_camera
from shes.envs.markers import ROBOT, Marker, Rgba
from shes.types import F64Array

_BOX, _SPHERE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_SPHERE)
_BARS = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))
_OVERSAMPLING = 2  # pictures are drawn larger and then reduced, which smooths edges
_FOLLOW_HALF_M = 7.0
_GROUND, _GROUND_LINE, _CHASM = (216, 221, 214), (198, 205, 197), (164, 170, 166)
_BOX_COLORS = {"platform": _GROUND, "wall": (122, 130, 143), "block": (199, 158, 107)}
_LINE_EVERY_M = 2.0
_SCENERY = ("floor", "wall", "platform", "block")


class FlatRenderer(Renderer):
    """A renderer that draws geoms as rectangles, circles and bars: scenery, markers, then the robot, each by height."""

    def draw(self, qpos: F64Array, markers: Sequence[Marker] = (), camera: str = "follow") -> Picture:
        """Return a picture of the world at `qpos`."""
        check_camera(camera)
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        view = (float(qpos[0]), float(qpos[1]), _FOLLOW_HALF_M) if camera == "follow" else self.top_view
        heights = self.data.geom_xpos[:, 2] + (self.model.geom_type == _BOX) * self.model.geom_size[:, 2]
        geoms = [(geom, self.model.geom(geom).name) for geom in np.argsort(heights, kind="stable").tolist()]
        has_platforms = any(name.startswith("platform") for _, name in geoms)
        sheet = _Sheet(view, self.width, self.height, _CHASM if has_platforms else _GROUND)
        for geom, name in geoms:
            if name.startswith(_SCENERY):
                self._draw_geom(sheet, geom)
        for marker in sorted(markers, key=lambda each: each.position[2]):
            start, end = np.array(marker.position), np.array(marker.end or marker.position)
            sheet.bar(start, end, marker.radius, _rgb(marker.color))
        for geom, name in geoms:
            if not name.startswith(_SCENERY):
                self._draw_geom(sheet, geom)
        return sheet.picture()

    def _draw_geom(self, sheet: _Sheet, geom: int) -> None:
        """Draw a geom at its current position; planes are not drawn."""
        kind, size = int(self.model.geom_type[geom]), self.model.geom_size[geom]
        place, axes = self.data.geom_xpos[geom], self.data.geom_xmat[geom].reshape(3, 3)
        if kind == _BOX:
            sheet.polygon(box_corners(self.model, self.data, geom), _BOX_COLORS[box_kind(self.model, geom)])
        elif kind == _SPHERE:
            sheet.bar(place, place, size[0], _rgb(ROBOT[:3]))
        elif kind in _BARS:
            sheet.bar(place - axes[:, 2] * size[1], place + axes[:, 2] * size[1], size[0], _rgb(ROBOT[:3]))


def _rgb(color: Rgba | tuple[float, ...]) -> tuple[int, ...]:
    return tuple(round(255 * part) for part in color)


class _Sheet:
    """An image of the ground to draw on, in metres."""

    def __init__(self, view: tuple[float, float, float], width: int, height: int, ground: tuple[int, ...]) -> None:
        """Show the area with its centre and half height (x, y, half) at `view`."""
        self._x, self._y, half = view
        self._size = (width, height)
        self._width, self._height = width * _OVERSAMPLING, height * _OVERSAMPLING
        self._scale = self._height / (2 * half)
        self._image = Image.new("RGB", (self._width, self._height), ground)
        self._draw = ImageDraw.Draw(self._image, "RGBA")
        across = half * width / height
        for x in _multiples(self._x - across, self._x + across):
            column = self._pixel((x, 0.0))[0]
            self._draw.line([(column, 0), (column, self._height)], _GROUND_LINE, _OVERSAMPLING)
        for y in _multiples(self._y - half, self._y + half):
            row = self._pixel((0.0, y))[1]
            self._draw.line([(0, row), (self._width, row)], _GROUND_LINE, _OVERSAMPLING)

    def _pixel(self, place: F64Array | tuple[float, float]) -> tuple[float, float]:
        x, y = float(place[0]) - self._x, float(place[1]) - self._y
        return self._width / 2 + x * self._scale, self._height / 2 - y * self._scale

    def polygon(self, corners: Iterable[F64Array], color: tuple[int, ...]) -> None:
        """Draw a filled polygon."""
        self._draw.polygon([self._pixel(corner) for corner in corners], color)

    def bar(self, start: F64Array, end: F64Array, radius: float, color: tuple[int, ...]) -> None:
        """Draw a line with round ends; where both ends are one place, a circle."""
        reach, ends = radius * self._scale, [self._pixel(start), self._pixel(end)]
        is_circle = ends[0] == ends[1]
        if not is_circle:
            self._draw.line(ends, color, max(1, round(2 * reach)))
        if is_circle or len(color) == 3:  # the overlap of transparent ends would show
            for x, y in ends[is_circle:]:
                self._draw.ellipse([x - reach, y - reach, x + reach, y + reach], color)

    def picture(self) -> Picture:
        """Return the image, reduced, as pixels [H, W, 3]."""
        return np.asarray(self._image.resize(self._size, Image.Resampling.LANCZOS))


def _multiples(first: float, last: float) -> F64Array:
    """Return the coordinates of the ground's lines between `first` and `last`, in metres."""
    return np.arange(_LINE_EVERY_M * np.ceil(first / _LINE_EVERY_M), last, _LINE_EVERY_M)
