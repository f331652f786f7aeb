"""Things to be drawn that are not part of the physics: food, poison, targets, goals, trails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shes.types import F64Array

__all__ = ["FOOD", "GOAL", "POISON", "ROBOT", "TARGET", "TRAIL", "Marker", "ball", "disc", "line"]

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
    """Centre, or the beginning of a line."""
    radius: float
    """Radius, or half the width of a line."""
    color: Rgba
    """Red, green, blue, opacity, from 0 to 1."""
    end: tuple[float, float, float] | None = None
    """The other end of a line."""
    height: float = 0.02
    """Half the height of a disc."""


def ball(place: Sequence[float] | F64Array, radius: float, color: Rgba) -> Marker:
    """Return a ball at `place` (x, y, z)."""
    return Marker(shape="ball", position=_point(place), radius=radius, color=color)


def disc(place: Sequence[float] | F64Array, radius: float, color: Rgba, height: float = 0.02) -> Marker:
    """Return an upright disc, or a column, with its centre at `place` (x, y, z)."""
    return Marker(shape="disc", position=_point(place), radius=radius, color=color, height=height)


def line(start: Sequence[float] | F64Array, end: Sequence[float] | F64Array, radius: float, color: Rgba) -> Marker:
    """Return a line between two places (x, y, z)."""
    return Marker(shape="line", position=_point(start), end=_point(end), radius=radius, color=color)


def _point(place: Sequence[float] | F64Array) -> tuple[float, float, float]:
    x, y, z = np.asarray(place, dtype=np.float64)
    return float(x), float(y), float(z)
