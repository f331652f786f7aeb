"""Drawer and window of an environment that draws itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from shes.drawing.drawer import Drawer, Picture
from shes.envs.markers import Marker


class PassthroughDrawer(Drawer):
    """A drawer whose poses are pictures [H, W, 3]. It resizes them, and ignores markers."""

    cameras = ("own",)

    def __init__(self, width: int, height: int) -> None:
        self.size = (width, height)

    def draw(self, pose: Picture, /, markers: Sequence[Marker] = (), camera: str = "own") -> Picture:
        """Return `pose` at this drawer's size, with black bars if the proportions differ."""
        from PIL import Image, ImageOps

        return np.asarray(ImageOps.pad(Image.fromarray(np.asarray(pose, dtype=np.uint8)), self.size))

    def between(self, start: Picture, end: Picture, fraction: float) -> Picture:
        """Return `end`: pictures are not interpolated."""
        return end


class PassthroughWindow:
    """The window of an environment that shows its own steps."""

    is_open = True

    def show(
        self, pose: Any, /, markers: Sequence[Marker] = (), *, is_new_episode: bool = False, lines: Sequence[str] = ()
    ) -> None:
        """Do nothing: the environment has shown the step."""

    def close(self) -> None:
        """Do nothing: the environment closes it."""
