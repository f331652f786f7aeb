"""The environments that come with SHES, one line each, and the ids of all environments in Gymnasium, under `shes/`.

Entry points are strings: `import shes` registers the environments without importing MuJoCo, and if Gymnasium is not
imported yet, when it is: its import takes longer than that of the rest.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection
from types import ModuleType

from shes.errors import UnknownNameError
from shes.import_hook import ImportHook

BUILTIN_SPECS = ("shes", "hiro")
"""Specifications of every environment here: equal to `Task.specs`, but known without importing the class."""
BUILTIN_ENVIRONMENTS = {
    "ant-gather": ("ant:Ant", "gather:Gather"),
    "ant-maze": ("ant:Ant", "target_task:Maze"),
    "ant-push": ("ant:Ant", "target_task:Push"),
    "ant-fall": ("ant:Ant", "target_task:Fall"),
    "ant-flagrun": ("ant:Ant", "flagrun:Flagrun"),
    "point-gather": ("point:Point", "gather:Gather"),
    "point-maze": ("point:Point", "target_task:Maze"),
    "point-push": ("point:Point", "target_task:Push"),
    "point-fall": ("point:FallingPoint", "target_task:Fall"),
    "point-flagrun": ("point:Point", "flagrun:Flagrun"),
}
"""Body, below `shes.envs.bodies`, and task, below `shes.envs.tasks`, of each environment, imported when needed.

A new one is a line here; its Gymnasium ids, tests and documentation follow from it.
"""
TASKS = tuple(dict.fromkeys(name.partition("-")[2] for name in BUILTIN_ENVIRONMENTS))
"""Tasks for a robot from a file, which the argument `robot` names."""
MAX_EPISODE_STEPS = 500
"""Control steps after which Gymnasium truncates an episode (SHES paper, Table I)."""
SPECS_OF: dict[str, Collection[str]] = {
    **dict.fromkeys(BUILTIN_ENVIRONMENTS, BUILTIN_SPECS),
    **dict.fromkeys(TASKS, BUILTIN_SPECS[:1]),
}
"""The specifications of every environment by name; `register_ids` adds to it."""


def gymnasium_id(name: str, spec: str = "shes") -> str:
    """Return the Gymnasium id of environment `name`.

    The id of `ant-gather` is `shes/AntGather-v0`, or `shes/AntGatherHiro-v0` with specification `hiro`.
    """
    if name not in SPECS_OF:
        raise UnknownNameError("environment", name, SPECS_OF, "`shes envs` lists them.")
    variant = "" if spec == "shes" else spec.title()
    return f"shes/{name.title().replace('-', '')}{variant}-v0"


def register_ids(name: str, specs: Collection[str]) -> None:
    """Register environment `name` in Gymnasium with each of `specs`; existing ids are left unchanged."""
    import gymnasium  # not at the top: worker processes do not need it

    SPECS_OF[name] = specs
    for spec in specs:
        if gymnasium_id(name, spec) not in gymnasium.registry:
            gymnasium.register(
                gymnasium_id(name, spec),
                entry_point="shes.gymnasium.env:TaskEnv",
                vector_entry_point="shes.gymnasium.vector_env:TaskVectorEnv",
                max_episode_steps=MAX_EPISODE_STEPS,
                kwargs={"name": name, "spec": spec},
            )


def register_known() -> None:
    """Register every environment that comes with SHES, now or as soon as Gymnasium is imported."""
    if "gymnasium" not in sys.modules:
        sys.meta_path.insert(0, ImportHook("gymnasium", _execute_and_register))
        return
    for name, specs in SPECS_OF.items():
        register_ids(name, specs)


def _execute_and_register(execute: Callable[[ModuleType], None], module: ModuleType) -> None:
    execute(module)
    register_known()
