"""Gymnasium's registry: every environment of ours, single and vector, under `shes/`."""

from __future__ import annotations

from collections.abc import Collection

__all__ = ["MAX_EPISODE_STEPS", "gymnasium_id", "register_ids"]

MAX_EPISODE_STEPS = 500
"""Control steps after which Gymnasium truncates an episode (Table I)."""


def gymnasium_id(name: str, spec: str = "shes") -> str:
    """Return the Gymnasium id of `name`: of `ant-gather`, `shes/AntGather-v0`, or `shes/AntGatherHiro-v0` for hiro."""
    variant = "" if spec == "shes" else spec.title()
    return f"shes/{name.title().replace('-', '')}{variant}-v0"


def register_ids(name: str, specs: Collection[str]) -> None:
    """Register environment `name` in each of its `specs` that Gymnasium does not know yet."""
    import gymnasium  # worker processes do without

    for spec in specs:
        if gymnasium_id(name, spec) not in gymnasium.registry:
            gymnasium.register(
                gymnasium_id(name, spec),
                entry_point="shes.gymnasium.env:TaskEnv",
                vector_entry_point="shes.gymnasium.vector_env:TaskVectorEnv",
                max_episode_steps=MAX_EPISODE_STEPS,
                kwargs={"name": name, "spec": spec},
            )
