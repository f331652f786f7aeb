"""Gymnasium's registry: every environment of ours, single and vector, under `shes/`."""

from __future__ import annotations

import gymnasium

from shes.envs.registry import ENVIRONMENTS, check_name

__all__ = ["MAX_EPISODE_STEPS", "gymnasium_id", "register_all"]

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
