"""Three-dimensional pictures by MuJoCo's renderer: the looks of a world, and the camera that follows the robot."""

from __future__ import annotations

import os
from bisect import bisect_left
from collections.abc import Sequence
from importlib import import_module

import mujoco
import numpy as np
from mujoco.rendering.classic import gl_context

from shes.drawing.renderer import Extent, Picture, Renderer, scale_of
from shes.envs.markers import ROBOT, Marker
from shes.envs.worlds import SCALE
from shes.types import F64Array

ROBOT_BODY = 1
"""The first body of every world is the robot's."""
_TOP_MARGIN = 1.02
_TOP_DISTANCE_M = 120.0  # nearly no perspective, so that walls hide nothing
_MAX_GEOMS = 4000
_LINE, _LINE_PIXELS_PER_M = mujoco.mjtGeom.mjGEOM_LINE, 80.0

_AZIMUTH_DEG, _DISTANCE_M = 90.0, 11.0
_ELEVATIONS_DEG = range(42, 90)
"""Heights of the following camera above the horizon; the first from which the robot is visible is used."""
_SPARE_DEG = 12
"""The robot must be visible from this much lower too, so that its legs are."""
_EDGE_M = 4.0
"""The camera does not point nearer to the edge of the world than this, so that walls do not fill the picture."""
_MAX_SHIFT_M = 3.0
"""The camera points at most this far from the robot, which stays in the picture."""
MAX_PIXELS = 2048
"""Largest width or height of a picture."""
FOLLOW_FIELD_OF_VIEW_DEG = 45.0

_SKY = ([0.62, 0.76, 0.90], [0.93, 0.96, 0.98])
_GROUND = ([0.80, 0.83, 0.80], [0.87, 0.89, 0.86])
_GROUND_LINE = [0.70, 0.74, 0.70]
_WALL = [0.52, 0.56, 0.62, 1.0]
_WALL_HALF_HEIGHT_M = 0.4
_CHASM = [0.55, 0.57, 0.58, 1.0]
_BLOCK = [0.78, 0.62, 0.42, 1.0]
_GROUND_SQUARES_M = 2.0
_ROBOT_GROUP, _LAST_SEEN_GROUP = 1, 2
_SCENERY = (np.arange(mujoco.mjNGROUP) == 0).astype(np.uint8)
"""Geom group 0 has ground, walls, platforms and blocks, and nothing else."""


class MujocoRenderer(Renderer):
    """A renderer that uses OpenGL."""

    def __init__(self, spec: mujoco.MjSpec, width: int, height: int, opengl: str) -> None:
        """Decorate the world of `spec` and draw it with OpenGL `opengl`."""
        super().__init__(decorate(spec).compile(), width, height)
        if opengl in ("egl", "osmesa"):
            os.environ["PYOPENGL_PLATFORM"] = opengl  # overrides the caller's: `find_opengl` has tried this one
            # MuJoCo reads MUJOCO_GL only when it is imported, so this replaces the class that its renderer looks up.
            gl_context.GLContext = import_module(f"mujoco.{opengl}").GLContext
        self._renderer = mujoco.Renderer(self.model, height, width, max_geom=_MAX_GEOMS)
        self._camera = mujoco.MjvCamera()

    def draw(self, qpos: F64Array, markers: Sequence[Marker] = (), camera: str = "follow") -> Picture:
        """Return a picture of the world at `qpos`."""
        self.data.qpos[:] = qpos
        mujoco.mj_forward(self.model, self.data)
        if camera == "follow":
            self.model.vis.global_.fovy = FOLLOW_FIELD_OF_VIEW_DEG
            follow(self._camera, self.model, self.data, self.extent)
        else:
            x, y, half = self.top_view
            self.model.vis.global_.fovy = np.rad2deg(2 * np.arctan2(half * _TOP_MARGIN, _TOP_DISTANCE_M))
            _aim(self._camera, np.array([x, y, 0.0]), -90.0, _TOP_DISTANCE_M)
        self._renderer.update_scene(self.data, self._camera)
        # From above, shadows hide more than they show, and take half of the time.
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = camera != "top"
        add_markers(self._renderer.scene, markers, self.scale)
        return self._renderer.render()

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


def follow(camera: mujoco.MjvCamera, model: mujoco.MjModel, data: mujoco.MjData, extent: Extent) -> None:
    """Point `camera` at the robot from behind and above, steeper where a wall, a block or a platform would hide it.

    The positions in `data` have been computed; the decorated world `model` covers `extent`.
    """
    robot, scale = data.xpos[ROBOT_BODY], scale_of(model)
    low, high = np.reshape(extent, (2, 2))
    inside = np.clip(robot[:2], low + scale * _EDGE_M, high - scale * _EDGE_M)
    lookat = robot.copy()
    lookat[:2] += np.clip(inside - robot[:2], -scale * _MAX_SHIFT_M, scale * _MAX_SHIFT_M)

    def is_clear(degrees: int) -> bool:
        azimuth, elevation = np.deg2rad((_AZIMUTH_DEG, _SPARE_DEG - degrees))
        level = np.cos(elevation)
        direction = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
        ray = lookat - scale * _DISTANCE_M * direction - robot
        # A distance of -1 is no hit; 1 is the camera.
        return not 0 <= mujoco.mj_ray(model, data, robot, ray, _SCENERY, True, -1, None) <= 1

    first = bisect_left(_ELEVATIONS_DEG, True, key=is_clear)
    _aim(camera, lookat, -float(_ELEVATIONS_DEG[min(first, len(_ELEVATIONS_DEG) - 1)]), scale * _DISTANCE_M)


def _aim(camera: mujoco.MjvCamera, lookat: F64Array, elevation_deg: float, distance_m: float) -> None:
    camera.type, camera.lookat[:] = mujoco.mjtCamera.mjCAMERA_FREE, lookat
    camera.azimuth, camera.elevation, camera.distance = _AZIMUTH_DEG, elevation_deg, distance_m


def add_markers(scene: mujoco.MjvScene, markers: Sequence[Marker], scale: float) -> None:
    """Add `markers`, lengths times `scale`, to `scene`, up to its capacity."""
    for marker in markers[: scene.maxgeom - scene.ngeom]:
        geom, color = scene.geoms[scene.ngeom], np.array(marker.color, dtype=np.float32)
        if marker.end is not None:
            # A line of pixels: a trail of capsules takes longer to draw than everything else.
            mujoco.mjv_initGeom(geom, _LINE, np.zeros(3), np.zeros(3), np.zeros(9), color)
            pixels = marker.radius * _LINE_PIXELS_PER_M
            mujoco.mjv_connector(geom, _LINE, pixels, *(scale * np.array([marker.position, marker.end])))
        else:
            is_ball = marker.shape == "ball"
            shape = mujoco.mjtGeom.mjGEOM_SPHERE if is_ball else mujoco.mjtGeom.mjGEOM_CYLINDER
            size = scale * np.array([marker.radius, marker.radius if is_ball else marker.height, marker.radius])
            mujoco.mjv_initGeom(geom, shape, size, scale * np.array(marker.position), np.eye(3).ravel(), color)
        geom.category = mujoco.mjtCatBit.mjCAT_DECOR
        scene.ngeom += 1


def decorate(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Decorate the world of `spec` in place and return it."""
    looks, light = spec.visual, spec.visual.headlight
    looks.global_.offwidth = looks.global_.offheight = MAX_PIXELS
    looks.global_.fovy = FOLLOW_FIELD_OF_VIEW_DEG
    looks.quality.shadowsize = 2048
    light.ambient, light.diffuse, light.specular = [0.38] * 3, [0.35] * 3, [0.0] * 3
    sky, gradient = mujoco.mjtTexture.mjTEXTURE_SKYBOX, mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.add_texture(name="sky", type=sky, builtin=gradient, rgb1=_SKY[0], rgb2=_SKY[1], width=256, height=256)
    sun = {"diffuse": [0.45, 0.45, 0.45], "specular": [0.1, 0.1, 0.1], "castshadow": True}
    parallel = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    spec.worldbody.add_light(name="sun", type=parallel, pos=[0, 0, 30], dir=[0.35, 0.25, -1], **sun)
    scale = next((each.data[0] for each in spec.numerics if each.name == SCALE), 1.0)
    _add_ground(spec, scale)
    is_seen = any(1 <= geom.group <= _LAST_SEEN_GROUP for geom in spec.geoms)
    has_platforms = any(geom.name.startswith("platform") for geom in spec.geoms)
    for geom in spec.geoms:
        if geom.name.startswith(("floor", "platform")):
            geom.material = "ground"
            if has_platforms and geom.name == "floor":
                geom.rgba = _CHASM
        elif geom.name.startswith("wall"):
            geom.rgba = _WALL
            position, size = np.array(geom.pos), np.array(geom.size)
            position[2] += scale * _WALL_HALF_HEIGHT_M - size[2]  # lowered, so that it hides nothing behind it
            size[2] = scale * _WALL_HALF_HEIGHT_M
            geom.pos, geom.size = position, size
        elif geom.name.startswith("block"):
            geom.rgba = _BLOCK
        else:
            if not geom.material:
                geom.rgba = ROBOT
            # A robot's file may show meshes, and hide what collides; without meshes, that is shown.
            geom.group = (geom.group or _ROBOT_GROUP) if is_seen or geom.group <= _LAST_SEEN_GROUP else _ROBOT_GROUP
    return spec


def _add_ground(spec: mujoco.MjSpec, scale: float) -> None:
    """Add the material of the ground: a checkerboard, which makes movement visible."""
    flat, checker = mujoco.mjtTexture.mjTEXTURE_2D, mujoco.mjtBuiltin.mjBUILTIN_CHECKER
    looks = {"rgb1": _GROUND[0], "rgb2": _GROUND[1], "mark": mujoco.mjtMark.mjMARK_EDGE, "markrgb": _GROUND_LINE}
    spec.add_texture(name="ground", type=flat, builtin=checker, width=512, height=512, **looks)
    material = spec.add_material(name="ground", texuniform=True, texrepeat=[0.5 / (scale * _GROUND_SQUARES_M)] * 2)
    textures = list(material.textures)
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "ground"
    material.textures = textures
