"""Gymnasium's registry: every environment of ours, single and vector, under `shes/`."""

from __future__ import annotations

import gymnasium

from shes.envs.registry import ENVIRONMENTS, check_name

__all__ = ["MAX_EPISODE_STEPS", "find_id", "gymnasium_id", "register_all"]

MAX_EPISODE_STEPS = 500
"""Control steps after which Gymnasium truncates an episode (Table I)."""


def gymnasium_id(name: str, spec: str = "shes") -> str:
    """Return the id in Gymnasium of environment `name`: `shes/AntGather-v0` for `ant-gather`, `AntGatherHiro` for hiro.

    Raises:
        UnknownNameError: `name` is not in the registry.
    """
    check_name(name)
    variant = "" if spec == "shes" else spec.title()
    return f"shes/{name.title().replace('-', '')}{variant}-v0"


def find_id(name: str) -> str | None:
    """Return the id in Gymnasium that `name` spells in any case, with or without its version; None if there is none."""
    ids: dict[str, str] = {}
    for env_id in gymnasium.registry:  # the latest version comes last
        ids |= {env_id.casefold(): env_id, env_id.casefold().rpartition("-v")[0]: env_id}
    return ids.get(name.casefold())


def register_all() -> None:
    """Register every environment that Gymnasium does not know yet."""
    for name, environment in ENVIRONMENTS.items():
        for spec in environment.task.specs:
            if gymnasium_id(name, spec) not in gymnasium.registry:
                gymnasium.register(
                    gymnasium_id(name, spec),
                    entry_point="shes.envs.gymnasium.env:TaskEnv",
                    vector_entry_point="shes.envs.gymnasium.vector_env:TaskVectorEnv",
                    max_episode_steps=MAX_EPISODE_STEPS,
                    kwargs={"name": name, "spec": spec},
                )
