"""Which levels of a run learn, and from what, by its settings."""

from __future__ import annotations

from typing import Any


def learns(settings: Any) -> tuple[bool, ...]:
    """Return whether each level learns."""
    is_frozen = (
        "transfer" in settings and settings.transfer.primitive is not None and settings.transfer.freeze_primitive
    )
    return tuple(not (is_frozen and name == "primitive") for name in settings.level_names)


def is_alone(settings: Any) -> bool:
    """Return whether there is only a primitive, because the environment sets the goals."""
    return settings.level_names == ("primitive",)


def is_branched(settings: Any) -> bool:
    """Return whether the primitive's fitness is estimated by branched intervals, even if it does not learn."""
    return "estimate" in settings and settings.estimate.primitive_estimate == "interval"


def explores(settings: Any) -> bool:
    """Return whether the run searches for a way to the target."""
    return "exploration" in settings and settings.exploration.explore == "archive"


def by_episodes(settings: Any) -> tuple[bool, ...]:
    """Return whether each level's mirrored groups are whole episodes: also those of a primitive that learns alone."""
    if is_branched(settings) and not is_alone(settings):
        return (*learns(settings)[:-1], False)
    return learns(settings)


def population(settings: Any) -> tuple[int, int]:
    """Return the number of policies in a generation, those in branches included, and the most episodes of each."""
    evolution = settings.evolution
    branches = settings.values.get("primitive_population_size") or 0
    return evolution.population_size + branches, evolution.episodes_per_policy


def steps_per_generation(settings: Any) -> int:
    """Return the environment steps of a generation if no episode and no branch ends early."""
    evolution = settings.evolution
    episodes = evolution.population_size * evolution.episodes_per_policy * settings.episodes.horizon
    if not is_branched(settings) or not learns(settings)[-1]:
        return episodes
    pairs = settings.values.get("primitive_population_size") or evolution.population_size
    branches = pairs * settings.estimate.intervals * settings.hierarchy.controller_interval
    return branches if is_alone(settings) else episodes + branches
