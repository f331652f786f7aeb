"""The environments that come with SHES, one line each. Importing this module does not import MuJoCo."""

from __future__ import annotations

BUILTIN_SPECS = ("shes", "hiro")
"""Specifications of every environment here: equal to `Task.specs`, but known without importing the class."""
BUILTIN_ENVIRONMENTS = {
    "ant-gather": ("ant:Ant", "gather:Gather"),
    "ant-maze": ("ant:Ant", "maze:Maze"),
    "ant-push": ("ant:Ant", "push:Push"),
    "ant-fall": ("ant:Ant", "fall:Fall"),
    "ant-flagrun": ("ant:Ant", "flagrun:Flagrun"),
    "point-gather": ("point:Point", "gather:Gather"),
    "point-maze": ("point:Point", "maze:Maze"),
    "point-push": ("point:Point", "push:Push"),
    "point-fall": ("point:FallingPoint", "fall:Fall"),
    "point-flagrun": ("point:Point", "flagrun:Flagrun"),
}
"""Body, below `shes.envs.bodies`, and task, below `shes.envs.tasks`, of each environment, imported when needed.

A new one is a line here; its Gymnasium ids, tests and documentation follow from it.
"""
