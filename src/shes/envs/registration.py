"""Gymnasium's registry: every environment of ours, single and vector, under `shes/`."""

from __future__ import annotations

import gymnasium

from shes.envs.registry import ENVIRONMENTS, check_name

__all__ = ["MAX_EPISODE_STEPS", "gymnasium_id", "register_all"]

MAX_EPISODE_STEPS = 500
"""Control steps after which Gymnasium truncates an episode (Table I)."""


def gymnasium_id(name: str) -> str:
    """Return the id in Gymnasium of environment `name`: `shes/AntGather-v0` for `ant-gather`.

    Raises:
        UnknownNameError: `name` is not in the registry.
    """
    check_name(name)
    return f"shes/{name.title().replace('-', '')}-v0"


def register_all() -> None:
    """Register every environment that Gymnasium does not know yet."""
    for name in ENVIRONMENTS:
        if gymnasium_id(name) not in gymnasium.registry:
            gymnasium.register(
                gymnasium_id(name),
                entry_point="shes.envs.gymnasium_env:TaskEnv",
                vector_entry_point="shes.envs.vector_env:TaskVectorEnv",
                max_episode_steps=MAX_EPISODE_STEPS,
                kwargs={"name": name},
            )
