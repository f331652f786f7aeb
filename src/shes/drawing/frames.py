"""Pictures that an environment has drawn of itself: they are only brought to size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from shes.drawing.drawer import Drawer, Picture
from shes.drawing.markers import Marker
from shes.drawing.opengl import offer_opengl

__all__ = ["FrameDrawer", "FrameWindow"]


class FrameDrawer(Drawer):
    """A pose is a picture [H, W, 3]. Markers cannot be put into it."""

    cameras = ("own",)

    def __init__(self, width: int, height: int) -> None:
        """Make pictures of `width` times `height` pixels; the environment is offered the OpenGL that there is."""
        offer_opengl()
        self.size = (width, height)

    def draw(self, pose: Picture, /, markers: Sequence[Marker] = (), camera: str = "own") -> Picture:
        """Return the picture at this drawer's size, with black bars where its proportions are others."""
        from PIL import Image, ImageOps

        return np.asarray(ImageOps.pad(Image.fromarray(np.asarray(pose, dtype=np.uint8)), self.size))

    def between(self, start: Picture, end: Picture, fraction: float) -> Picture:
        """Return `end`: there is nothing between two pictures."""
        return end

    def close(self) -> None:
        """Hold nothing: the environment draws."""


class FrameWindow:
    """The window of an environment that shows its own steps, and closes it by itself."""

    is_open = True

    def show(self, pose: Any, /, markers: Sequence[Marker] = (), *, is_new_episode: bool = False) -> None:
        """Do nothing: the environment has shown it."""

    def close(self) -> None:
        """Do nothing: the environment closes it."""
