"""`shes envs`: the environments with their dimensions, rewards and scores."""

from __future__ import annotations

import json as json_text
from typing import Any

from shes.cli.output import print_table
from shes.envs.external.environment import ExternalEnvironment
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.gymnasium_ids import gymnasium_id
from shes.envs.registry import ENVIRONMENTS, make_task
from shes.envs.tasks.options import SPECS, TaskOptions
from shes.errors import ShesError


def envs(*, json: bool = False) -> int:
    """List the environments.

    Args:
        json: Print a JSON array of objects.
    """
    rows: list[dict[str, Any]] = []
    for name, environment in ENVIRONMENTS.items():
        specs = environment.task.specs
        sizes = {spec: make_task(name, 1, TaskOptions(spec=spec)) for spec in specs}
        rows.append(
            {
                "name": name,
                "task": environment.task.name,
                "gymnasium": [gymnasium_id(name, spec) for spec in specs],
                "observation": {spec: task.observation_size for spec, task in sizes.items()},
                "action": sizes[specs[0]].action_size,
                "reward": environment.task.description.reward,
                "ends": environment.task.description.ends,
                "score": environment.task.description.score,
                "about": " ".join((environment.task.__doc__ or "").split("\n\n", maxsplit=1)[0].split()),
            }
        )
    others = [_external_row(environment) for environment in EXTERNAL_ENVIRONMENTS.values()]
    if json:
        print(json_text.dumps([*rows, *others], indent=2))
        return 0
    print_table(
        ("environment", "task", "observation", "hiro", "action"),
        [
            (row["name"], row["task"], *(str(row["observation"].get(spec, "")) for spec in SPECS), str(row["action"]))
            for row in rows
        ],
    )
    words = {environment.task.name: environment.task.description for environment in ENVIRONMENTS.values()}
    texts = [(name, each.reward, each.ends, each.score) for name, each in words.items()]
    print_table(("task", "reward of a step", "ends early", "score of an episode"), texts)
    print_table(
        ("of others", "in Gymnasium", "observation", "action"),
        [(row["name"], row["gymnasium"][0], *_shown_sizes(row)) for row in others],
    )
    print("In Gymnasium: shes/AntGather-v0, and shes/AntGatherHiro-v0 for --spec hiro. More: --json, and `make docs`.")
    return 0


def _external_row(environment: ExternalEnvironment) -> dict[str, Any]:
    """Return what there is to say of an environment of others; no numbers where it cannot be made."""
    env_id = environment.source if isinstance(environment.source, str) else "made by a function"
    row: dict[str, Any] = {
        "name": environment.name,
        "task": "external",
        "gymnasium": [env_id],
        "observation": {},
        "action": None,
        "reward": "its own",
        "ends": "by its own rule",
        "score": "success" if environment.is_scored_by_success else "return",
        "about": f"Gymnasium's {env_id}",
    }
    try:
        task = environment.make(1)
    except ShesError as error:
        return {**row, "about": str(error)}
    return {**row, "observation": {"external": task.observation_size}, "action": task.action_size}


def _shown_sizes(row: dict[str, Any]) -> tuple[str, str]:
    """Return the sizes of observation and action; of what cannot be made, why."""
    if row["action"] is None:
        return row["about"], ""
    return str(row["observation"]["external"]), str(row["action"])
