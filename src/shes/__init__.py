"""SHES: scalable hierarchical evolution strategies for long, sparse-reward control tasks.

```python
import shes

run = shes.train("point-gather", preset="smoke", seed=0)
agent = shes.load(run.path)
```
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from shes import es
    from shes.experiments.evaluate import Evaluation, evaluate
    from shes.experiments.play import Agent, load
    from shes.experiments.train import Run, resume, train

__all__ = ["Agent", "Evaluation", "Run", "es", "evaluate", "load", "resume", "train"]

# Loaded when first asked for: a worker process imports this package too, and needs none of it.
_HOMES = {
    "Agent": "shes.experiments.play",
    "Evaluation": "shes.experiments.evaluate",
    "Run": "shes.experiments.train",
    "evaluate": "shes.experiments.evaluate",
    "load": "shes.experiments.play",
    "resume": "shes.experiments.train",
    "train": "shes.experiments.train",
}


def __getattr__(name: str) -> Any:
    if name == "es":
        return importlib.import_module("shes.es")
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'shes' has no attribute {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
