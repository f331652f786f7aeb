"""Import of MuJoCo with any value of MUJOCO_GL: only those who draw need an OpenGL that works."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType


class AnyOpenGL:
    """A finder for `sys.meta_path`."""

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, _: ModuleType | None = None) -> ModuleSpec | None:
        """Return where MuJoCo is, with a loader that calls `_execute`; None for all other modules."""
        spec = PathFinder.find_spec(name, path) if name == "mujoco" else None
        if spec is not None and spec.loader is not None:
            spec.loader.exec_module = partial(_execute, spec.loader.exec_module)  # type: ignore[method-assign]
        return spec


def _execute(execute: Callable[[ModuleType], None], module: ModuleType) -> None:
    """Execute MuJoCo's module; if that fails, and MUJOCO_GL has a value, once more without OpenGL."""
    try:
        execute(module)
    except Exception:
        if (asked := os.environ.get("MUJOCO_GL")) is None:
            raise
        os.environ["MUJOCO_GL"] = "off"
        try:
            execute(module)
        finally:
            os.environ["MUJOCO_GL"] = asked
