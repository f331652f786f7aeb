"""Makes the drawer that suits an environment, which may draw itself, and the OpenGL of the machine."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

import mujoco
import numpy as np
from PIL import Image, ImageOps

from shes.drawing.flat_renderer import FlatRenderer
from shes.drawing.mujoco_renderer import MAX_PIXELS, MujocoRenderer
from shes.drawing.opengl import HOW_TO_GET_OPENGL, find_opengl, offer_opengl
from shes.drawing.renderer import Drawer, Picture, Renderer
from shes.envs.episode_batch import EpisodeBatch
from shes.envs.markers import Marker
from shes.errors import ConfigError
from shes.types import is_whole

logger = logging.getLogger("shes.drawing")


class PassthroughDrawer(Drawer):
    """A drawer for an environment that draws itself. Its poses are pictures [H, W, 3]; it ignores markers."""

    cameras = ("own",)

    def __init__(self, width: int, height: int) -> None:
        self.size = (width, height)

    def draw(self, pose: Picture, /, markers: Sequence[Marker] = (), camera: str = "own") -> Picture:
        """Return `pose` at this drawer's size, with black bars if the proportions differ."""
        return np.asarray(ImageOps.pad(Image.fromarray(np.asarray(pose, dtype=np.uint8)), self.size))

    def between(self, start: Picture, end: Picture, fraction: float) -> Picture:
        """Return `end`: pictures are not interpolated."""
        return end


def make_drawer(batch: EpisodeBatch, width: int, height: int) -> Drawer:
    """Return a drawer of the poses of `batch`, with pictures of this size; call it before the first reset."""
    if batch.draws_itself:
        batch.draw_by("rgb_array")
        offer_opengl()
        return PassthroughDrawer(width, height)
    return make_renderer(batch.world_to_draw, width, height)


def make_renderer(make_spec: Callable[[], mujoco.MjSpec], width: int, height: int) -> Renderer:
    """Return MuJoCo's renderer of the undecorated world of `make_spec` or, without OpenGL, the flat renderer.

    Raises:
        ConfigError: The size in pixels is not allowed, or MUJOCO_GL names an OpenGL that does not work.
    """
    for name, pixels in (("width", width), ("height", height)):
        if not (is_whole(pixels) and 16 <= pixels <= MAX_PIXELS):
            raise ConfigError(f"{name} of a picture must be 16 to {MAX_PIXELS} pixels, got {pixels!r}. Change {name}.")
    found = find_opengl()
    if found is not None:
        return MujocoRenderer(make_spec(), width, height, found)
    logger.warning("MUJOCO_GL is off or no OpenGL works: drawing flat pictures from above. %s", HOW_TO_GET_OPENGL)
    return FlatRenderer(make_spec().compile(), width, height)
