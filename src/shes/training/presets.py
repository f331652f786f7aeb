"""Presets: what a run's settings start from. Source: algorithm specification section 7; SHES paper, Table I."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shes.envs.registry import find_environment
from shes.errors import ConfigError, UnknownNameError
from shes.es.novelty import NOVELTY_RULES
from shes.runs.config import TrainConfig, check_fields
from shes.runs.device import check_asked_device
from shes.runs.settings import SCHEDULED, flag
from shes.training.transfer import TRANSFERRED, brought_settings

__all__ = ["PRESETS", "make_config"]

PRESETS: dict[str, dict[str, Any]] = {
    # Table I to the letter; what it leaves out, as the authors' code does it.
    "paper": {
        "population_size": 1000,
        "episodes_per_policy": 5,
        "sigma": 0.02,
        "hold_tied": False,
        "generations": 3000,
        "hidden": (256, 256, 256),
        "biases": "glorot_normal",
        "horizon": 500,
        "rank_ties": "index",
        "common_random_numbers": "off",
        "statistics_fraction": 0.01,
        "reset_noise": 0.0,
        "evaluation_episodes": 10,
        "noise_table_size": 250_000_000,
    },
    # Learns visibly on a few cores: the defaults of TrainConfig.
    "laptop": {"evaluation_horizon": 500},
    # Seconds: to see that everything works, not to learn.
    "smoke": {
        "population_size": 16,
        "generations": 3,
        "horizon": 50,
        "hidden": (16,),
        "evaluation_interval": 2,
        "evaluation_episodes": 4,
        "noise_table_size": 1_000_000,
    },
}

# What makes an ant learn in minutes: docs/learning.md says what each is worth.
_ANT_WALKER: dict[str, Any] = {
    "primitive_view": "egocentric",
    "symmetry": "dihedral",
    "goal_encoding": "angle_metres",
    "clock_frequency": 0.8,
    "primitive_estimate": "interval",
    "intervals": 2,
    "fall_price": 2.0,
    "output_weights": "zero",
    "weight_decay": 0.0,
    "horizon": 500,
}
_ANT: dict[str, Any] = {
    **_ANT_WALKER,
    "hidden": (),
    "primitive_hidden": (64, 64),
    "controller_view": "egocentric",
    "controller_output": "heading_vector",
    "minimum_goal_distance": False,
    "population_size": 200,
    "sigma": 0.1,
    "learning_rate": 0.05,
    "primitive_population_size": 1200,
    "primitive_sigma": 0.05,
    "primitive_learning_rate": 0.015,
    "generations": 200,
}

_WALKERS: dict[str, dict[str, Any]] = {
    "ant-flagrun": {
        **_ANT_WALKER,
        "fall_price": 8.0,
        "hidden": (),
        "population_size": 1200,
        "sigma": 0.05,
        "learning_rate": 0.02,
        "generations": 20,
        "evaluation_interval": 5,
    },
    **{f"ant-{task}": _ANT for task in ("gather", "maze", "push", "fall")},
}
"""What `laptop` sets otherwise where a primitive learns to walk: with `--algorithm es` there is none."""

_PER_ENVIRONMENT: dict[tuple[str, str], dict[str, Any]] = {
    # The authors' pre-training of a primitive.
    ("paper", "ant-flagrun"): {"population_size": 256},
    ("paper", "point-flagrun"): {"population_size": 256},
    # The point reaches a goal in a second, not in two and a half, and its episodes cost little.
    ("laptop", "point-gather"): {
        "controller_interval": 10,
        "learning_rate": 0.04,
        "horizon": 500,
        "generations": 80,
    },
    # Cells of the point's maze are 1 m wide, those of the ant's 4 m.
    ("laptop", "robotics-point-maze"): {"goal_distance": 1.0, "minimum_goal_distance": False},
}
"""What a preset sets otherwise for an environment: (preset, environment) -> settings."""


def make_config(env: str, preset: str = "laptop", overrides: Mapping[str, Any] | None = None) -> TrainConfig:
    """Return the settings of `preset` for `env`, with `overrides` by name.

    An environment that brings a time limit has it in training and evaluation.

    Raises:
        UnknownNameError: `preset` or `env` is not known.
        ConfigError: A setting is unknown or out of range, or `env` cannot be made.
        MissingExtraError: `env` comes with a package that is not installed.
    """
    if not isinstance(preset, str) or preset not in PRESETS:
        raise UnknownNameError("preset", str(preset), PRESETS, "Set --preset.")
    overrides = dict(overrides or {})
    check_fields(overrides)
    for name in ("hidden", "primitive_hidden"):
        if isinstance(overrides.get(name), int):
            overrides[name] = (overrides[name],)
    for name in TRANSFERRED:
        if isinstance(overrides.get(name), Path):
            overrides[name] = str(overrides[name])
    has_walker = preset == "laptop" and overrides.get("algorithm", "shes") == "shes"
    own = _WALKERS.get(env, {}) if has_walker else {}
    limit = find_environment(env).max_episode_steps
    limits = {} if limit is None else {"horizon": limit, "evaluation_horizon": limit}
    values = {**PRESETS[preset], **limits, **_PER_ENVIRONMENT.get((preset, env), {}), **own, **overrides}
    for level in TRANSFERRED:
        if values.get(level) is not None:
            checkpoint = values.get(f"{level}_checkpoint", "best")
            values.update(brought_settings(level, values[level], checkpoint, overrides))
    config = TrainConfig(env=env, preset=preset, **values)
    check_asked_device(config, overrides)
    _refuse_unheeded(config, overrides)
    return config


_OF_CONTROLLERS = frozenset(
    {
        "controller_output",
        "controller_view",
        "controller_weight_decay",
        "minimum_goal_distance",
        "primitive_hidden",
        "primitive_learning_rate",
        "primitive_population_size",
        "primitive_sigma",
    }
)
"""Settings that concern two levels only."""
_OF_PRIMITIVES = frozenset(
    {
        "controller_interval",
        "fall_price",
        "goal_distance",
        "goal_encoding",
        "hide_position",
        "intervals",
        "primitive_estimate",
        "primitive_fitness_shaping",
        "primitive_reward",
        "primitive_view",
        "symmetry",
    }
    | _OF_CONTROLLERS
)
"""Settings that concern goals."""
_OF_RANDOM_CONTROLLERS = frozenset({"controller_interval", "goal_distance"})
"""Settings of goals that an environment heeds which sets them itself."""

_OF_BRANCHES = frozenset(
    {
        "fall_price",
        "intervals",
        "primitive_fitness_shaping",
        "primitive_learning_rate",
        "primitive_population_size",
        "primitive_sigma",
    }
)
"""Settings of a primitive that is judged by intervals, if it learns."""
_OF_EPISODES = frozenset(
    {"common_random_numbers", "episodes_per_policy", "fitness_shaping", "mirrored", "statistics_fraction"}
)
"""Settings of whole episodes: a primitive alone that is judged by intervals has none."""

_NEEDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "momentum": ("optimizer", ("sgd", "clipup")),
    "intervals": ("primitive_estimate", ("interval",)),
    "primitive_fitness_shaping": ("primitive_estimate", ("interval",)),
    "primitive_learning_rate": ("primitive_estimate", ("interval",)),
    "primitive_population_size": ("primitive_estimate", ("interval",)),
    "primitive_sigma": ("primitive_estimate", ("interval",)),
    "symmetry": ("primitive_view", ("egocentric",)),
    "novelty_neighbours": ("novelty", tuple(NOVELTY_RULES)),
    "rank_ties": ("fitness_shaping", ("centred_rank", "top_fraction")),
    "top_fraction": ("fitness_shaping", ("top_fraction",)),
}
"""Settings that concern some choices of another one only."""


def _refuse_unheeded(config: TrainConfig, overrides: Mapping[str, Any]) -> None:
    """Refuse settings that somebody asked for, and that would do nothing in this run.

    Raises:
        ConfigError: There is one.
    """
    for level, name in (
        ("primitive", "freeze_primitive"),
        ("primitive", "primitive_checkpoint"),
        ("controller", "controller_checkpoint"),
    ):
        if getattr(config, level) is None and name in overrides:
            raise ConfigError(
                f"{name} is {overrides[name]!r}, but no run is named whose {level} it would be. "
                f"Set --{level} RUN, or leave {flag(name)} away."
            )
    _refuse_unheeded_estimate(config, overrides)
    for name, (other, needed) in _NEEDS.items():
        has_other = getattr(config, other) in needed
        if other == "fitness_shaping" and config.primitive_estimate == "interval" and config.learns[-1]:
            has_other |= config.primitive_fitness_shaping in needed
        if name in overrides and not has_other:
            raise ConfigError(
                f"{name} does nothing with {other} {getattr(config, other)!r}, got {overrides[name]!r}. "
                f"Set {flag(other)} to {' or '.join(needed)}, or leave {flag(name)} away."
            )
    if "schedule_generations" in overrides and not config.has_schedule:
        kinds = ", ".join(flag(kind) for kind, _ in SCHEDULED.values())
        raise ConfigError(
            f"schedule_generations does nothing without a schedule, got {overrides['schedule_generations']!r}. "
            f"Set one of {kinds}, or leave --schedule-generations away."
        )
    if "perturbation" in overrides and sum(config.by_episodes) == 1:
        (learning,) = (name for name, learns in zip(config.level_names, config.by_episodes, strict=True) if learns)
        told = "learns" if sum(config.learns) == 1 else "is judged by whole episodes"
        raise ConfigError(
            f"perturbation says how two levels share the population, but in this run the {learning} alone {told}; got "
            f"{overrides['perturbation']!r}. Leave --perturbation away."
        )
    unheeded = frozenset[str]()
    if config.level_names == ("primitive",):
        unheeded = _OF_CONTROLLERS
    elif config.level_names == ("policy",):
        sets_goals = find_environment(config.env).sets_goals
        unheeded = _OF_PRIMITIVES - (_OF_RANDOM_CONTROLLERS if sets_goals else frozenset())
    for name in sorted(unheeded & set(overrides)):
        raise ConfigError(
            f"{name} does nothing in a run of {config.env} with algorithm {config.algorithm!r}, whose one level is the "
            f"{config.level_names[0]}; got {overrides[name]!r}. Leave {flag(name)} away."
        )


def _refuse_unheeded_estimate(config: TrainConfig, overrides: Mapping[str, Any]) -> None:
    """Refuse settings that somebody asked for, and that the way in which the primitive is judged does not heed.

    Raises:
        ConfigError: There is one.
    """
    if config.level_names == ("primitive",) and config.primitive_estimate == "interval":
        for name in sorted(_OF_EPISODES & set(overrides)):
            raise ConfigError(
                f"{name} does nothing in a run of {config.env} whose primitive is judged by intervals: it concerns "
                f"whole episodes; got {overrides[name]!r}. "
                f"Leave {flag(name)} away, or set --primitive-estimate episode."
            )
    if "primitive" in config.level_names and not config.learns[-1]:
        for name in sorted(_OF_BRANCHES & set(overrides)):
            raise ConfigError(
                f"{name} does nothing where the primitive stays as it is; got {overrides[name]!r}. "
                f"Leave {flag(name)} away, or set --no-freeze-primitive."
            )
