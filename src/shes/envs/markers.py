"""Markers: shapes that are drawn but are not part of the physics, such as food, targets, goals and trails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Point = tuple[float, float, float]
"""x, y and z."""
Rgba = tuple[float, float, float, float]

FOOD: Rgba = (0.18, 0.65, 0.30, 1.0)
POISON: Rgba = (0.82, 0.20, 0.22, 1.0)
TARGET: Rgba = (0.95, 0.72, 0.10, 0.9)
GOAL: Rgba = (0.13, 0.45, 0.90, 0.95)
TRAIL: Rgba = (0.93, 0.50, 0.16, 0.8)
ROBOT: Rgba = (0.93, 0.50, 0.16, 1.0)


@dataclass(frozen=True)
class Marker:
    """A ball, an upright disc or a line. Lengths are in units of the world's `scale`."""

    shape: Literal["ball", "disc", "line"]
    position: Point
    """Centre, or the start of a line."""
    radius: float
    """Radius, or half width of a line."""
    color: Rgba
    """Red, green, blue and opacity, from 0 to 1."""
    end: Point | None = None
    """End of a line."""
    height: float = 0.02
    """Half height of a disc."""
