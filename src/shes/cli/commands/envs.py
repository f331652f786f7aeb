"""`shes envs`: the environments with their dimensions."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from shes.cli.command import Command
from shes.cli.options import Group, options_of
from shes.cli.output import print_table


@dataclass(frozen=True, kw_only=True)
class Arguments:
    """What `shes envs` takes."""

    json: bool = False
    """Print a JSON array of objects."""


_GROUPS = (Group(heading="flags", options=options_of(Arguments)),)


def _run(values: dict[str, Any]) -> int:
    from shes.envs.registry import ENVIRONMENTS, make_task

    rows: list[dict[str, Any]] = []
    for name in ENVIRONMENTS:
        task = make_task(name, 1)
        what = " ".join((type(task).__doc__ or "").split("\n\n", maxsplit=1)[0].split())
        rows.append({"name": name, "observation": task.observation_size, "action": task.action_size, "task": what})
    if Arguments(**values).json:
        print(json.dumps(rows, indent=2))
        return 0
    headings = ("environment", "observation", "action", "task")
    print_table(headings, [[str(value) for value in row.values()] for row in rows])
    return 0


COMMAND = Command(
    name="envs",
    description="List the environments.",
    groups=_GROUPS,
    run=_run,
)
