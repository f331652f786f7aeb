"""The environments that come with SHES, one line each. Importing this module does not import MuJoCo."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["BUILTIN_ENVIRONMENTS", "BuiltinEnvironment"]


class BuiltinEnvironment(NamedTuple):
    """The classes of an environment, as `module:Class`. They are imported when they are needed."""

    body: str
    """Body class, below `shes.envs.bodies`."""
    task: str
    """Task class, below `shes.envs.tasks`."""
    specs: tuple[str, ...] = ("shes", "hiro")
    """The task's specifications: equal to `Task.specs`, but known without importing the class."""


BUILTIN_ENVIRONMENTS = {
    "ant-gather": BuiltinEnvironment("ant:Ant", "gather:Gather"),
    "ant-maze": BuiltinEnvironment("ant:Ant", "maze:Maze"),
    "ant-push": BuiltinEnvironment("ant:Ant", "push:Push"),
    "ant-fall": BuiltinEnvironment("ant:Ant", "fall:Fall"),
    "ant-flagrun": BuiltinEnvironment("ant:Ant", "flagrun:Flagrun"),
    "point-gather": BuiltinEnvironment("point:Point", "gather:Gather"),
    "point-maze": BuiltinEnvironment("point:Point", "maze:Maze"),
    "point-push": BuiltinEnvironment("point:Point", "push:Push"),
    "point-fall": BuiltinEnvironment("point:FallingPoint", "fall:Fall"),
    "point-flagrun": BuiltinEnvironment("point:Point", "flagrun:Flagrun"),
}
"""The environments by name. A new one is a line here; its Gymnasium ids, tests and documentation follow from it."""
