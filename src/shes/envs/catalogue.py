"""The catalogue of the environments with a name: dimensions, rewards and scores."""

from __future__ import annotations

from typing import Any

from shes.envs.external_task import ExternalEnvironment
from shes.envs.gymnasium_ids import gymnasium_id
from shes.envs.named_environments import ENVIRONMENTS, EXTERNAL_ENVIRONMENTS, Environment, make_task
from shes.envs.tasks.task_options import TaskOptions
from shes.errors import ShesError
from shes.types import Listing, Table


def list_environments() -> Listing:
    """List the environments with their dimensions, rewards and scores."""
    rows = [_describe(name, environment) for name, environment in ENVIRONMENTS.items()]
    rows += map(_describe_external, EXTERNAL_ENVIRONMENTS.values())
    shown: list[tuple[str, ...]] = []
    for row in rows:
        sizes = [*row["observation"].values(), "", ""]
        shown.append((row["name"], row["task"], str(sizes[0]), str(sizes[1]), str(row["action"] or "")))
    tasks = {(row["task"], row["score"]): (row["task"], row["reward"], row["ends"], row["score"]) for row in rows}
    parts = (
        Table(("environment", "task", "observation", "hiro", "action"), shown),
        Table(("task", "reward of a step", "ends early", "score of an episode"), list(tasks.values())),
        *(row["about"] for row in rows if not row["observation"]),
        "In Gymnasium: shes/AntGather-v0, and shes/AntGatherHiro-v0 for --spec hiro. More: --json, and `make docs`.",
    )
    return Listing(rows, parts)


def _describe(name: str, environment: Environment) -> dict[str, Any]:
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


def _describe_external(environment: ExternalEnvironment) -> dict[str, Any]:
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
