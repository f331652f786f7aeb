"""Which modules and names the reference shows."""

from __future__ import annotations

import inspect

import shes
from generate.source import find, module_name, modules
from generate.tables import table


def room(page: str, name: str) -> str:
    """Return the reference of every module of room `name`."""
    inside = [module_name(path) for path in modules() if not path.stem.startswith("_")]
    return module(page, *(each for each in inside if each.startswith(f"{name}.")))


def module(page: str, *names: str) -> str:
    """Return the reference of modules by name."""
    del page
    for name in names:
        find(name)
    return "\n\n".join(f"::: {name}" for name in names)


def face(page: str) -> str:
    """Return the table of what `import shes` offers."""
    del page
    rows = []
    for name in shes.__all__:
        value = getattr(shes, name)
        if isinstance(value, str):  # the version
            rows.append((f"`shes.{name}`", "The version of the package."))
            continue
        summary = " ".join(inspect.cleandoc(value.__doc__ or "").split("\n\n")[0].split())
        target = f"({name}.md)" if inspect.ismodule(value) else f"[{value.__module__}.{value.__qualname__}]"
        rows.append((f"[`shes.{name}`]{target}", summary))
    return table(["name", "what it is"], rows)
