"""Three-dimensional pictures by MuJoCo's renderer."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from shes.drawing.drawer import Picture
from shes.drawing.follow import follow_view
from shes.drawing.opengl import use_opengl
from shes.drawing.renderer import Renderer, check_camera
from shes.drawing.scenery import FOLLOW_FIELD_OF_VIEW_DEG, decorate
from shes.envs.markers import Marker
from shes.types import F64Array

_TOP_MARGIN = 1.02
_TOP_DISTANCE_M = 120.0  # nearly no perspective, so that walls hide nothing
_MAX_GEOMS = 4000
_LINE = mujoco.mjtGeom.mjGEOM_LINE
_LINE_PIXELS_PER_M = 80.0


class MujocoRenderer(Renderer):
    """A renderer that uses OpenGL."""

    def __init__(self, spec: mujoco.MjSpec, width: int, height: int, opengl: str) -> None:
        """Decorate the world of `spec` and draw it with OpenGL `opengl`."""
        super().__init__(decorate(spec).compile(), width, height)
        use_opengl(opengl)
        self._renderer = mujoco.Renderer(self.model, height, width, max_geom=_MAX_GEOMS)
        self._camera = mujoco.MjvCamera()

    def draw(self, qpos: F64Array, markers: Sequence[Marker] = (), camera: str = "follow") -> Picture:
        """Return a picture of the world at `qpos`."""
        self.data.qpos[:] = qpos
        mujoco.mj_forward(self.model, self.data)
        self._aim(camera)
        self._renderer.update_scene(self.data, self._camera)
        # From above, shadows hide more than they show, and take half of the time.
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = camera != "top"
        add_markers(self._renderer.scene, markers)
        return self._renderer.render()

    def _aim(self, name: str) -> None:
        """Point the camera; raise an UnknownNameError for an unknown `name`."""
        check_camera(name)
        camera = self._camera
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        if name == "follow":
            self.model.vis.global_.fovy = FOLLOW_FIELD_OF_VIEW_DEG
            camera.lookat[:], camera.azimuth, camera.elevation, camera.distance = follow_view(
                self.model, self.data, self.extent
            )
            return
        x, y, half = self.top_view
        self.model.vis.global_.fovy = np.rad2deg(2 * np.arctan2(half * _TOP_MARGIN, _TOP_DISTANCE_M))
        camera.azimuth, camera.elevation, camera.distance = 90.0, -90.0, _TOP_DISTANCE_M
        camera.lookat[:] = (x, y, 0)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


def add_markers(scene: mujoco.MjvScene, markers: Sequence[Marker]) -> None:
    """Add `markers` to `scene`, up to its capacity."""
    for marker in markers:
        if scene.ngeom >= scene.maxgeom:
            return
        geom = scene.geoms[scene.ngeom]
        color = np.array(marker.color, dtype=np.float32)
        if marker.end is not None:
            # A line of pixels: a trail of capsules takes longer to draw than everything else.
            mujoco.mjv_initGeom(geom, _LINE, np.zeros(3), np.zeros(3), np.zeros(9), color)
            pixels = marker.radius * _LINE_PIXELS_PER_M
            mujoco.mjv_connector(geom, _LINE, pixels, np.array(marker.position), np.array(marker.end))
        else:
            is_ball = marker.shape == "ball"
            shape = mujoco.mjtGeom.mjGEOM_SPHERE if is_ball else mujoco.mjtGeom.mjGEOM_CYLINDER
            size = np.array([marker.radius, marker.radius if is_ball else marker.height, marker.radius])
            mujoco.mjv_initGeom(geom, shape, size, np.array(marker.position), np.eye(3).ravel(), color)
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        scene.ngeom += 1
