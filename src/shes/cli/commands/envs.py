"""`shes envs`: the environments with their dimensions, rewards and scores."""

from __future__ import annotations

import json as json_text
from typing import Any

from shes.cli.output import print_line, print_table
from shes.cli.parsing import Json
from shes.envs.external.environment import ExternalEnvironment
from shes.envs.external.included import EXTERNAL_ENVIRONMENTS
from shes.envs.gymnasium_ids import gymnasium_id
from shes.envs.registry import ENVIRONMENTS, Environment, make_task
from shes.envs.tasks.options import TaskOptions
from shes.errors import ShesError


def envs(*, json: Json = False) -> int:
    """List the environments."""
    rows = [_row(name, environment) for name, environment in ENVIRONMENTS.items()]
    rows += map(_external_row, EXTERNAL_ENVIRONMENTS.values())
    if json:
        print(json_text.dumps(rows, indent=2))
        return 0
    shown: list[tuple[str, ...]] = []
    for row in rows:
        sizes = [*row["observation"].values(), "", ""]
        shown.append((row["name"], row["task"], str(sizes[0]), str(sizes[1]), str(row["action"] or "")))
    print_table(("environment", "task", "observation", "hiro", "action"), shown)
    tasks = {(row["task"], row["score"]): (row["task"], row["reward"], row["ends"], row["score"]) for row in rows}
    print_table(("task", "reward of a step", "ends early", "score of an episode"), list(tasks.values()))
    for row in rows:
        if not row["observation"]:
            print_line(row["about"])
    print("In Gymnasium: shes/AntGather-v0, and shes/AntGatherHiro-v0 for --spec hiro. More: --json, and `make docs`.")
    return 0


def _row(name: str, environment: Environment) -> dict[str, Any]:
    """Return the description of an environment."""
    task, text = environment.task, environment.task.description
    sizes = {spec: make_task(name, 1, TaskOptions(spec=spec)) for spec in task.specs}
    return {
        "name": name,
        "task": task.name,
        "gymnasium": [gymnasium_id(name, spec) for spec in task.specs],
        "observation": {spec: each.observation_size for spec, each in sizes.items()},
        "action": sizes[task.specs[0]].action_size,
        "reward": text.reward,
        "ends": text.ends,
        "score": text.score,
        "about": " ".join((task.__doc__ or "").split("\n\n", maxsplit=1)[0].split()),
    }


def _external_row(environment: ExternalEnvironment) -> dict[str, Any]:
    """Return the description of an external environment, without dimensions if it cannot be made."""
    env_id = environment.source if isinstance(environment.source, str) else "made by a function"
    about, sizes, action = f"Gymnasium's {env_id}", {}, None
    try:
        task = environment.make(1)
        sizes, action = {"external": task.observation_size}, task.action_size
    except ShesError as error:
        about = str(error)
    return {
        "name": environment.name,
        "task": "external",
        "gymnasium": [env_id],
        "observation": sizes,
        "action": action,
        "reward": "its own",
        "ends": "by its own rule",
        "score": "success" if environment.is_scored_by_success else "return",
        "about": about,
    }
