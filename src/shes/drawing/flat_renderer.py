"""Flat pictures from above, for machines without OpenGL."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np
from PIL import Image, ImageDraw

from shes.drawing.renderer import Picture, Renderer, box_corners, outlines
from shes.envs.markers import ROBOT, Marker, Rgba
from shes.types import F64Array

_BOX, _SPHERE = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_SPHERE)
_BARS = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_CYLINDER))
_OVERSAMPLING = 2  # pictures are drawn larger and then reduced, which smooths edges
_FOLLOW_HALF_M = 7.0
_GROUND, _GROUND_LINE, _CHASM = (216, 221, 214), (198, 205, 197), (164, 170, 166)
_BOX_COLORS = {"platform": _GROUND, "wall": (122, 130, 143), "block": (199, 158, 107)}
_LINE_EVERY_M = 2.0


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
            start, end = self.scale * np.array([marker.position, marker.end or marker.position])
            sheet.bar(start, end, self.scale * marker.radius, _rgb(marker.color))
        drawn = {outline.geom for outline in scenery}
        for geom in np.argsort(self.data.geom_xpos[:, 2], kind="stable").tolist():
            if geom not in drawn:
                self._draw_part(sheet, geom)
        return sheet.picture()

    def _draw_part(self, sheet: _Sheet, geom: int) -> None:
        """Draw a geom of the robot; planes are not drawn."""
        kind, size, color = int(self.model.geom_type[geom]), self.model.geom_size[geom], _rgb(ROBOT[:3])
        place, axis = self.data.geom_xpos[geom], self.data.geom_xmat[geom].reshape(3, 3)[:, 2]
        if kind == _BOX:
            sheet.polygon(box_corners(self.model, self.data, geom), color)
        elif kind == _SPHERE:
            sheet.bar(place, place, size[0], color)
        elif kind in _BARS:
            sheet.bar(place - axis * size[1], place + axis * size[1], size[0], color)


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
        center, reach = np.array(view[:2]), half * np.array([width / height, 1.0])
        for axis, (low, high) in enumerate(zip(center - reach, center + reach, strict=True)):
            for place in np.arange(_LINE_EVERY_M * np.ceil(low / _LINE_EVERY_M), high, _LINE_EVERY_M):
                ends = np.array([center - reach, center + reach])
                ends[:, axis] = place
                self._draw.line([self._pixel(end) for end in ends], _GROUND_LINE, _OVERSAMPLING)

    def _pixel(self, place: F64Array) -> tuple[float, float]:
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
