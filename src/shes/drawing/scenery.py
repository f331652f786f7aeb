"""Decorates a world for drawing with sky, ground, light and colours. The simulated model is never decorated."""

from __future__ import annotations

import mujoco
import numpy as np

from shes.envs.markers import ROBOT

MAX_PIXELS = 2048
"""Largest width or height of a picture."""
FOLLOW_FIELD_OF_VIEW_DEG = 45.0
SCENERY_GROUP = 0
"""Geom group of ground, walls, platforms and blocks, and of nothing else."""

_SKY = ([0.62, 0.76, 0.90], [0.93, 0.96, 0.98])
_GROUND = ([0.80, 0.83, 0.80], [0.87, 0.89, 0.86])
_GROUND_LINE = [0.70, 0.74, 0.70]
_WALL = [0.52, 0.56, 0.62, 1.0]
_WALL_HALF_HEIGHT_M = 0.4
_CHASM = [0.55, 0.57, 0.58, 1.0]
_BLOCK = [0.78, 0.62, 0.42, 1.0]
_GROUND_SQUARES_M = 2.0
_ROBOT_GROUP = 1


def decorate(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Decorate the world of `spec` in place and return it."""
    looks = spec.visual
    looks.global_.offwidth = looks.global_.offheight = MAX_PIXELS
    looks.global_.fovy = FOLLOW_FIELD_OF_VIEW_DEG
    looks.quality.shadowsize = 4096
    looks.headlight.ambient = [0.38, 0.38, 0.38]
    looks.headlight.diffuse = [0.35, 0.35, 0.35]
    looks.headlight.specular = [0.0, 0.0, 0.0]
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_SKY[0],
        rgb2=_SKY[1],
        width=256,
        height=256,
    )
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=[0, 0, 30],
        dir=[0.35, 0.25, -1],
        diffuse=[0.45, 0.45, 0.45],
        specular=[0.1, 0.1, 0.1],
        castshadow=True,
    )
    _add_ground(spec)
    has_platforms = any(geom.name.startswith("platform") for geom in spec.geoms)
    for geom in spec.geoms:
        if geom.name.startswith(("floor", "platform")):
            geom.material = "ground"
            if has_platforms and geom.name == "floor":
                geom.rgba = _CHASM
        elif geom.name.startswith("wall"):
            geom.rgba = _WALL
            _lower(geom)
        elif geom.name.startswith("block"):
            geom.rgba = _BLOCK
        else:
            geom.rgba = ROBOT
            geom.group = geom.group or _ROBOT_GROUP
    return spec


def _lower(wall: mujoco.MjsGeom) -> None:
    """Lower the top of a wall, so that it hides nothing behind it."""
    position, size = np.array(wall.pos), np.array(wall.size)
    position[2] += _WALL_HALF_HEIGHT_M - size[2]
    size[2] = _WALL_HALF_HEIGHT_M
    wall.pos, wall.size = position, size


def _add_ground(spec: mujoco.MjSpec) -> None:
    """Add the material of the ground: a checkerboard, which makes movement visible."""
    spec.add_texture(
        name="ground",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=_GROUND[0],
        rgb2=_GROUND[1],
        markrgb=_GROUND_LINE,
        width=512,
        height=512,
    )
    material = spec.add_material(name="ground", texuniform=True, texrepeat=[0.5 / _GROUND_SQUARES_M] * 2)
    textures = list(material.textures)
    textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "ground"
    material.textures = textures
