"""Presets: starting values of a run's settings.

Source: SHES paper, Table I; Nachum et al. 2018 (HIRO), appendix C, and its code; docs/differences.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shes.envs.registry import ENVIRONMENTS, find_environment
from shes.errors import ConfigError, UnknownNameError
from shes.runs.config import TrainConfig
from shes.runs.device import check_asked_device
from shes.runs.rooms import RunSettings, check_names, learner, rooms_of
from shes.runs.shipped import run_text
from shes.settings import Needs, setting_fields
from shes.training.transfer import brought_settings, transferred_levels

_HIRO: dict[str, Any] = {
    "algorithm": "hiro",
    "hidden": (300, 300),
    "actor_learning_rate": 1e-4,
    "critic_learning_rate": 1e-3,
    "noise_unit": "raw",
    "exploration_noise": 1.0,
    "goal_noise": 1.0,
    "normalise_inputs": False,
    "reward_scale": 0.1,
    "update_interval": 1,
    "horizon": 500,
    "evaluation_horizon": 500,
    "env_steps": 10_000_000,
    "generations": 1_000_000,
    "generation_steps": 10_000,
    "evaluation_interval": 5,
}

PRESETS: dict[str, dict[str, Any]] = {
    # Table I exactly; what it leaves open is as in the authors' code.
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
    # Learns visibly on a few cores: the default settings.
    "laptop": {"evaluation_horizon": 500, "controller_update_interval": 2},
    # Takes seconds: a test that does not learn.
    "smoke": {
        "population_size": 16,
        "generations": 3,
        "horizon": 50,
        "hidden": (16,),
        "evaluation_interval": 2,
        "evaluation_episodes": 4,
        "noise_table_size": 1_000_000,
        "warmup_steps": 1000,
        "generation_steps": 500,
    },
    # The values of the HIRO paper, and of its code where it says nothing.
    "hiro-paper": _HIRO,
    # The same with the values of HIRO in Table I, in the environments of the SHES authors.
    "hiro-table1": {**_HIRO, "actor_learning_rate": 0.001},
}

# With these an ant learns in minutes; docs/learning.md measures each of them.
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

_IN_THE_WORLD = {"controller_view": "observation", "controller_output": "vector"}

_WALKERS: dict[str, dict[str, Any]] = {
    "ant-flagrun": {
        **_ANT_WALKER,
        "intervals": 1,
        "fall_price": 8.0,
        "hidden": (),
        "population_size": 1200,
        "sigma": 0.05,
        "learning_rate": 0.02,
        "generations": 30,
        "evaluation_interval": 5,
    },
    "ant-gather": _ANT,
    # The egocentric view hides where the robot is, which these tasks turn on.
    **{f"ant-{task}": {**_ANT, **_IN_THE_WORLD} for task in ("maze", "push", "fall")},
}
"""Changes to `laptop` where a primitive learns to walk, which `--algorithm es` does not have."""


def _hiro_noise(env: str) -> dict[str, Any]:
    """Return the exploration noise in raw units where it is not that of the ant: the point's controls are 1 at most."""
    return {"exploration_noise": 0.1} if env.startswith("point-") else {}


_PER_ENVIRONMENT: dict[tuple[str, str], dict[str, Any]] = {
    # The authors' pre-training of a primitive.
    ("paper", "ant-flagrun"): {"population_size": 256},
    ("paper", "point-flagrun"): {"population_size": 256},
    # The point reaches a goal in a second, not in two and a half, and its episodes cost little.
    ("laptop", "point-gather"): {"controller_interval": 10, "learning_rate": 0.04, "horizon": 500, "generations": 80},
    # Cells of the point's maze are 1 m wide, those of the ant's 4 m.
    ("laptop", "robotics-point-maze"): {"goal_distance": 1.0, "minimum_goal_distance": False},
    **{("hiro-paper", env): {"spec": "hiro", **_hiro_noise(env)} for env in ENVIRONMENTS},
    **{("hiro-table1", env): _hiro_noise(env) for env in ENVIRONMENTS},
}
"""Changes to a preset for an environment: (preset, environment) -> settings."""


def make_config(env: str, preset: str = "laptop", overrides: Mapping[str, Any] | None = None) -> TrainConfig:
    """Return the settings of `preset` for `env`, with `overrides` by name.

    The time limit of an environment applies to training and evaluation.

    Raises:
        UnknownNameError: `preset` or `env` is unknown.
        ConfigError: A setting is unknown, out of range or without effect, or `env` cannot be made.
        MissingExtraError: `env` needs a package that is not installed.
    """
    if not isinstance(preset, str) or preset not in PRESETS:
        raise UnknownNameError("preset", str(preset), PRESETS, "Set --preset.")
    asked = dict(overrides or {})
    for name in ("hidden", "primitive_hidden"):
        if isinstance(asked.get(name), int):
            asked[name] = (asked[name],)
    for name in transferred_levels():
        if isinstance(asked.get(name), Path):
            asked[name] = run_text(asked[name])
    identity = {"env": env, "preset": preset}
    values = {**identity, **_preset_values(env, preset, asked), **asked}
    check_names(values)
    for level in learner(RunSettings.of(values)).transfers:
        if values.get(level) is not None:
            checkpoint = values.get(f"{level}_checkpoint", "best")
            values.update(brought_settings(level, values[level], checkpoint, values, asked))
    config = TrainConfig(values)
    check_asked_device(config, asked)
    _check_effects(config, asked)
    return config


def _preset_values(env: str, preset: str, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that `preset` gives to settings of a run of `env`."""
    own_algorithm = PRESETS[preset].get("algorithm")
    run = {"algorithm": asked.get("algorithm", own_algorithm or "shes")}
    classes = rooms_of(RunSettings.of({"env": env, **run}))
    if own_algorithm is not None and "learner" not in classes:
        raise ConfigError(
            f"preset {preset!r} is for the algorithms hiro and td3, got algorithm {run['algorithm']!r}. Set --preset "
            "paper, laptop or smoke, or omit --algorithm."
        )
    has_walker = preset == "laptop" and run["algorithm"] == "shes"
    own = _WALKERS.get(env, {}) if has_walker else {}
    limit = find_environment(env).max_episode_steps
    limits = {} if limit is None else {"horizon": limit, "evaluation_horizon": limit}
    values = {**PRESETS[preset], **limits, **_PER_ENVIRONMENT.get((preset, env), {}), **own}
    return {name: values[name] for cls in classes.values() for name in setting_fields(cls) if name in values}


def _check_effects(config: TrainConfig, asked: Mapping[str, Any]) -> None:
    """Raise ConfigError if a setting in `asked` has no effect beside the others."""
    for name in asked:
        setting = config.setting(name)
        if not setting.needs or _is_heeded(config, setting.needs):
            continue
        needed = [each for each in setting.needs if each.other in config.settings]
        others = ", ".join(f"{each.other} {config.settings[each.other]!r}" for each in needed)
        fixes = ", or ".join(f"{config.setting(each.other).flag}{_one_of(each.values)}" for each in needed[:1])
        raise ConfigError(
            f"{name} has no effect with {others}, got {asked[name]!r}. Set {fixes}, or omit {setting.flag}."
        )
    config.algorithm.check_effects(config, asked)


def _is_heeded(config: TrainConfig, needs: tuple[Needs, ...]) -> bool:
    """Return whether one of `needs` is fulfilled by a setting that has an effect itself."""
    for need in needs:
        if need.other not in config.settings:
            continue
        value, others = config.settings[need.other], config.setting(need.other).needs
        if (value in need.values if need.values else value is not None) and (not others or _is_heeded(config, others)):
            return True
    return False


def _one_of(values: tuple[str, ...]) -> str:
    return f" to {' or '.join(values)}" if values else ""
