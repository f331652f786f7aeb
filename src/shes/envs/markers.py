"""Markers: shapes that are drawn but are not part of the physics, such as food, targets, goals and trails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shes.types import F64Array

Rgba = tuple[float, float, float, float]

FOOD: Rgba = (0.18, 0.65, 0.30, 1.0)
POISON: Rgba = (0.82, 0.20, 0.22, 1.0)
TARGET: Rgba = (0.95, 0.72, 0.10, 0.9)
GOAL: Rgba = (0.13, 0.45, 0.90, 0.95)
TRAIL: Rgba = (0.93, 0.50, 0.16, 0.8)
ROBOT: Rgba = (0.93, 0.50, 0.16, 1.0)


@dataclass(frozen=True, kw_only=True)
class Marker:
    """A ball, an upright disc or a line, in metres."""

    shape: str
    """`ball`, `disc` or `line`."""
    position: tuple[float, float, float]
    """Centre, or the start of a line."""
    radius: float
    """Radius, or half width of a line."""
    color: Rgba
    """Red, green, blue and opacity, from 0 to 1."""
    end: tuple[float, float, float] | None = None
    """End of a line."""
    height: float = 0.02
    """Half height of a disc."""


def ball(position: Sequence[float] | F64Array, radius: float, color: Rgba) -> Marker:
    """Return a ball with its centre at `position` (x, y, z)."""
    return Marker(shape="ball", position=_point(position), radius=radius, color=color)


def disc(position: Sequence[float] | F64Array, radius: float, color: Rgba, height: float = 0.02) -> Marker:
    """Return an upright disc or column with its centre at `position` (x, y, z)."""
    return Marker(shape="disc", position=_point(position), radius=radius, color=color, height=height)


def line(start: Sequence[float] | F64Array, end: Sequence[float] | F64Array, radius: float, color: Rgba) -> Marker:
    """Return a line between two points (x, y, z)."""
    return Marker(shape="line", position=_point(start), end=_point(end), radius=radius, color=color)


def _point(position: Sequence[float] | F64Array) -> tuple[float, float, float]:
    x, y, z = np.asarray(position, dtype=np.float64)
    return float(x), float(y), float(z)
