"""`--import MODULE`: a user's module, which registers environments, rewards or encodings."""

from __future__ import annotations

import importlib
from collections.abc import Sequence

from shes.errors import ConfigError

__all__ = ["import_modules"]


def import_modules(names: Sequence[str]) -> None:
    """Import the modules of these names.

    Raises:
        ConfigError: A module is not found, or fails.
    """
    for name in names:
        try:
            importlib.import_module(name)
        except (Exception, SystemExit) as error:
            raise ConfigError(_message(name, error)) from error


def _message(name: str, error: BaseException) -> str:
    """Return what to say of a module that cannot be imported."""
    parents = [".".join(name.split(".")[:depth]) for depth in range(1, name.count(".") + 2)]
    if isinstance(error, ModuleNotFoundError) and error.name in parents:
        file = f" Give a module's name, not a file: --import {name[:-3]}." if name.endswith(".py") else ""
        return (
            f"--import {name}: there is no module {error.name!r}. Is it installed or on PYTHONPATH?{file} "
            "For a module in this folder: PYTHONPATH=. shes ..."
        )
    return (
        f"--import {name}: the module failed: {type(error).__name__}: {str(error).rstrip('.')}. "
        "Mend it; --debug shows where it failed."
    )
