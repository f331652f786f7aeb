"""The environments as single and vector Gymnasium environments."""

from shes.errors import import_module

import_module("mujoco")  # with a clear error for a MUJOCO_GL that does not work here
