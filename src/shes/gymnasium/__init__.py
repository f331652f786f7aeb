"""The environments as single and vector Gymnasium environments."""

from shes.errors import import_module

import_module("mujoco")  # even if MUJOCO_GL does not work here: only pictures need OpenGL
