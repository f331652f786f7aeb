"""SHES: scalable hierarchical evolution strategies for long, sparse-reward control tasks.

```python
import shes

run = shes.train("point-gather", preset="smoke", seed=0)
agent = shes.load(run.path)
```
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any

from shes.envs.gymnasium_ids import register_known
from shes.import_hook import ImportHook, with_any_opengl

if TYPE_CHECKING:
    __version__: str
    from shes import es
    from shes.agents.goals import register_controller_output, register_goal_encoding
    from shes.agents.rewards import register_primitive_reward
    from shes.envs.named_environments import register_environment, register_external
    from shes.runs.comparison import compare
    from shes.runs.evaluate import Evaluation, evaluate
    from shes.runs.export import export
    from shes.runs.loaded_agent import Agent, load
    from shes.runs.named_algorithms import register_algorithm
    from shes.runs.recorder import StopTraining
    from shes.runs.train import Run, resume, train
    from shes.viewing.plot import plot
    from shes.viewing.render import render
    from shes.viewing.report import report

__all__ = [
    "Agent", "Evaluation", "Run", "StopTraining", "__version__", "compare", "es", "evaluate", "export", "load",
    "plot", "register_algorithm", "register_controller_output", "register_environment", "register_external",
    "register_goal_encoding", "register_primitive_reward", "render", "report", "resume", "train",
]  # fmt: skip
_HOMES = {
    "agents.goals": ("register_controller_output", "register_goal_encoding"),
    "agents.rewards": ("register_primitive_reward",),
    "envs.named_environments": ("register_environment", "register_external"),
    "runs.comparison": ("compare",),
    "runs.evaluate": ("Evaluation", "evaluate"),
    "runs.export": ("export",),
    "runs.recorder": ("StopTraining",),
    "runs.loaded_agent": ("Agent", "load"),
    "runs.named_algorithms": ("register_algorithm",),
    "runs.train": ("Run", "resume", "train"),
    "viewing.plot": ("plot",),
    "viewing.render": ("render",),
    "viewing.report": ("report",),
}
"""Names by module. They are imported on first access: worker processes import this package, too, but need none."""

sys.meta_path.insert(0, ImportHook("mujoco", with_any_opengl))
register_known()  # entry points are strings: MuJoCo is imported when the first environment is made


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("shes")
    if name == "es":
        return importlib.import_module("shes.es")
    for module, names in _HOMES.items():
        if name in names:
            return getattr(importlib.import_module(f"shes.{module}"), name)
    raise AttributeError(f"module 'shes' has no attribute {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
