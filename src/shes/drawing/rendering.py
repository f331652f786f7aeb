"""Makes drawers and windows that suit the environment, which may draw itself, and the machine."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TypeAlias

import mujoco

from shes.drawing.drawer import Drawer
from shes.drawing.flat_renderer import FlatRenderer
from shes.drawing.mujoco_renderer import MujocoRenderer
from shes.drawing.opengl import HOW_TO_GET_OPENGL, find_opengl, is_switched_off, offer_opengl
from shes.drawing.passthrough import PassthroughDrawer, PassthroughWindow
from shes.drawing.renderer import Renderer
from shes.drawing.scenery import MAX_PIXELS
from shes.drawing.viewer import Viewer
from shes.envs.episode_batch import EpisodeBatch
from shes.errors import ConfigError
from shes.types import is_whole

logger = logging.getLogger("shes.drawing")

Window: TypeAlias = Viewer | PassthroughWindow
"""Shows poses in real time: `show` moves to a pose, with markers, in the time of a control step."""


def make_drawer(batch: EpisodeBatch, width: int, height: int) -> Drawer:
    """Return a drawer of the poses of `batch`, if it has pictures of this size; call it before the first reset."""
    if batch.draws_itself:
        batch.draw_by("rgb_array")
        offer_opengl()
        return PassthroughDrawer(width, height)
    return make_renderer(batch.world_to_draw, width, height)


def open_window(batch: EpisodeBatch) -> Window:
    """Return a window that shows the poses of `batch`, if there is a screen; call it before the first reset."""
    if batch.draws_itself:
        batch.draw_by("human")
        return PassthroughWindow()
    return Viewer(batch.world_to_draw(), batch.step_s)


def make_renderer(make_spec: Callable[[], mujoco.MjSpec], width: int, height: int) -> Renderer:
    """Return MuJoCo's renderer of the undecorated world of `make_spec` or, without OpenGL, the flat renderer.

    Raises:
        ConfigError: The size in pixels is not allowed, or MUJOCO_GL names an OpenGL that does not work.
    """
    for name, pixels in (("width", width), ("height", height)):
        if not (is_whole(pixels) and 16 <= pixels <= MAX_PIXELS):
            raise ConfigError(f"{name} of a picture must be 16 to {MAX_PIXELS} pixels, got {pixels!r}. Change {name}.")
    found = find_opengl()
    if found is None:
        if is_switched_off():
            logger.warning(
                "MUJOCO_GL is off: drawing flat pictures from above. Unset it for three-dimensional pictures."
            )
        else:
            logger.warning("No OpenGL here: drawing flat pictures from above. %s", HOW_TO_GET_OPENGL)
        return FlatRenderer(make_spec().compile(), width, height)
    return MujocoRenderer(make_spec(), width, height, found)
