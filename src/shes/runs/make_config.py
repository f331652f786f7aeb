"""The settings of a run from a preset and the values that were asked for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shes.algorithms.contract import PRESETS, Preset
from shes.envs.named_environments import find_environment
from shes.envs.tasks.task_options import TaskOptions
from shes.errors import ConfigError, UnknownNameError
from shes.runs.build import check_asked_device
from shes.runs.config import RunSettings, TrainConfig, algorithm_of, by_name, check_names, settings_by_section
from shes.runs.named_algorithms import ALGORITHMS, PRESET_NAMES
from shes.runs.shipped import run_text
from shes.runs.transfer import brought_settings, transferred_levels
from shes.settings import setting_fields


def make_config(env: str, preset: str = "laptop", overrides: Mapping[str, Any] | None = None) -> TrainConfig:
    """Return the settings of `preset` for `env`, with `overrides` by name.

    The time limit of an environment applies to training and evaluation. Raise ShesError if a name is unknown, or a
    setting is out of range or has no effect.
    """
    if not isinstance(preset, str) or preset not in PRESET_NAMES:
        raise UnknownNameError("preset", str(preset), PRESET_NAMES, "Set --preset.")
    asked = dict(overrides or {})
    asked |= {name: run_text(asked[name]) for name in transferred_levels() if isinstance(asked.get(name), Path)}
    values = {"env": env, "preset": preset, **preset_values(env, preset, asked), **asked}
    known = by_name(check_names(values))
    asked = {name: known[name].checked(value) for name, value in asked.items()}
    values |= asked
    for level in algorithm_of(RunSettings.of(values)).transfers:
        if values.get(level) is not None:
            values |= brought_settings(level, values, asked)
    config = TrainConfig.of(**values)
    check_asked_device(config, asked)
    _check_effects(config, asked)
    return config


def preset_values(env: str, preset: str, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that `preset` gives to a run of `env`, by the algorithm in `asked` if it has one."""
    known = [name for name, cls in ALGORITHMS.items() if preset in PRESETS or preset in cls.presets]
    default = RunSettings.algorithm if RunSettings.algorithm in known else known[0]
    run = RunSettings.of({"env": env, "algorithm": asked.get("algorithm", default)})
    own = algorithm_of(run).presets
    if run.algorithm not in known:
        raise ConfigError(
            f"preset {preset!r} is for algorithm {' or '.join(known)}, got algorithm {run.algorithm!r}. "
            f"Set --preset {', '.join(dict.fromkeys((*PRESETS, *own)))}, or omit --algorithm."
        )
    limit = find_environment(env).max_episode_steps
    limits = {} if limit is None else {"horizon": limit, "evaluation_horizon": limit}
    common, special = (presets.get(preset, Preset()).of(env) for presets in (PRESETS, own))
    settings = by_name(settings_by_section(run))
    values = {**common, **special, **limits, "algorithm": run.algorithm}
    return {name: value for name, value in values.items() if name in settings}


def _check_effects(config: TrainConfig, asked: Mapping[str, Any]) -> None:
    """Raise ConfigError if a setting in `asked` has no effect with the others."""
    is_ours = not find_environment(config.run.env).has_own_physics
    for name in asked:
        setting = config.setting(name)
        if name in setting_fields(TaskOptions) and not is_ours:
            raise ConfigError(
                f"{name} has no effect on {config.run.env}, which has its own physics, got {asked[name]!r}. "
                f"Omit {setting.flag}."
            )
        needed = [(need, config.values[need.other]) for need in setting.needs]
        if not needed or any(value in need.values if need.values else value is not None for need, value in needed):
            continue
        first, found = needed[0][0], ", ".join(f"{need.other} {value!r}" for need, value in needed)
        fix = " to ".join(filter(None, (config.setting(first.other).flag, " or ".join(first.values))))
        raise ConfigError(f"{name} has no effect with {found}, got {asked[name]!r}. Set {fix}, or omit {setting.flag}.")
    config.algorithm.check_effects(config, asked)
