"""SHES: scalable hierarchical evolution strategies for long, sparse-reward control tasks.

```python
import shes

run = shes.train("point-gather", preset="smoke", seed=0)
agent = shes.load(run.path)
```
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import TYPE_CHECKING, Any

from shes.envs.gymnasium_ids import register_known
from shes.errors import ConfigError

if TYPE_CHECKING:
    __version__: str
    from shes import es
    from shes.agents.goals import register_controller_output, register_goal_encoding
    from shes.agents.rewards import register_primitive_reward
    from shes.envs.named_environments import register_environment, register_external
    from shes.runs.evaluate import Evaluation, evaluate
    from shes.runs.export import export
    from shes.runs.listeners import StopTraining
    from shes.runs.loaded_agent import Agent, load
    from shes.runs.named_algorithms import register_algorithm
    from shes.runs.train import Run, resume, train
    from shes.viewing.plot import plot
    from shes.viewing.render import render
    from shes.viewing.report import report

__all__ = [
    "Agent",
    "Evaluation",
    "Run",
    "StopTraining",
    "__version__",
    "es",
    "evaluate",
    "export",
    "load",
    "plot",
    "register_algorithm",
    "register_controller_output",
    "register_environment",
    "register_external",
    "register_goal_encoding",
    "register_primitive_reward",
    "render",
    "report",
    "resume",
    "train",
]

# Imported on first access: worker processes import this package, too, but need none of these.
_HOMES = {
    "Agent": "shes.runs.loaded_agent",
    "Evaluation": "shes.runs.evaluate",
    "Run": "shes.runs.train",
    "StopTraining": "shes.runs.listeners",
    "evaluate": "shes.runs.evaluate",
    "export": "shes.runs.export",
    "load": "shes.runs.loaded_agent",
    "plot": "shes.viewing.plot",
    "register_algorithm": "shes.runs.named_algorithms",
    "register_controller_output": "shes.agents.goals",
    "register_environment": "shes.envs.named_environments",
    "register_external": "shes.envs.named_environments",
    "register_goal_encoding": "shes.agents.goals",
    "register_primitive_reward": "shes.agents.rewards",
    "render": "shes.viewing.render",
    "report": "shes.viewing.report",
    "resume": "shes.runs.train",
    "train": "shes.runs.train",
}


register_known()  # entry points are strings: MuJoCo is imported when the first environment is made


def import_module(name: str) -> ModuleType:
    """Import a module of this package.

    Raises:
        ConfigError: The import of MuJoCo fails because of the value of MUJOCO_GL.
    """
    try:
        return importlib.import_module(name)
    except RuntimeError as error:
        if "MUJOCO_GL" not in str(error):
            raise
        raise ConfigError(f"{error}. Unset MUJOCO_GL to let SHES choose, or set it to egl, osmesa or off.") from error


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("shes")
    if name == "es":
        return import_module("shes.es")
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'shes' has no attribute {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
