"""Hooks into the first import of another package, without importing it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.machinery import ModuleSpec
from types import ModuleType


class ImportHook:
    """A finder for `sys.meta_path`: `execute`, given the usual function and the module, executes module `name`."""

    def __init__(self, name: str, execute: Callable[[Callable[[ModuleType], None], ModuleType], None]) -> None:
        self.hooked, self._execute = name, execute

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of the module that the other finders find, with that loader; None for all other modules."""
        if name != self.hooked:
            return None
        others = [each for each in sys.meta_path if getattr(each, "hooked", None) != name]  # a reload adds one more
        spec = next(filter(None, (each.find_spec(name, path, target) for each in others)), None)
        if spec is not None and spec.loader is not None:
            spec.loader.exec_module = partial(self._execute, spec.loader.exec_module)  # type: ignore[method-assign]
        return spec


def with_any_opengl(execute: Callable[[ModuleType], None], module: ModuleType) -> None:
    """Execute MuJoCo's module; if that fails, and MUJOCO_GL has a value, once more without OpenGL.

    Only those who draw need an OpenGL that works.
    """
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
