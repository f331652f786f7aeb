"""Pictures that an environment has drawn of itself: they are only brought to size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shes.drawing.drawer import Drawer, Picture
from shes.drawing.markers import Marker

__all__ = ["FrameDrawer"]


class FrameDrawer(Drawer):
    """A pose is a picture [H, W, 3]. Markers cannot be put into it."""

    cameras = ("own",)

    def __init__(self, width: int, height: int) -> None:
        """Make pictures of `width` times `height` pixels."""
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
