"""The settings of a run: from a preset, what was asked for, and the levels that it takes from other runs.

A run may begin with the primitive or the controller of another one. Such a level brings the settings that determine its
inputs and layers. They become settings of the new run, which then no longer needs the folder of the other.
Source: SHES paper, II-D.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shes.algorithms.contract import PRESETS, Algorithm, LevelTransfer, Preset
from shes.envs.bodies.robot import RobotOptions
from shes.envs.bodies.robot_file import read_robot
from shes.envs.external_task import ExternalEnvironment
from shes.envs.gymnasium_ids import BUILTIN_ENVIRONMENTS
from shes.envs.named_environments import ROBOT_ENVIRONMENTS, Environment, find_environment, with_robot
from shes.envs.tasks.task import TaskOptions
from shes.errors import CheckpointError, ConfigError, RunFolderError, UnknownNameError
from shes.runs.build import OpenedRun, open_run
from shes.runs.config import RunSettings, TrainConfig, algorithm_of, by_name, check_names, settings_by_section
from shes.runs.folder import RunFolder
from shes.runs.named_algorithms import ALGORITHMS, PRESET_NAMES, algorithm_classes
from shes.runs.shipped import find_run, shipped_name
from shes.settings import Needs, flag, setting_fields


def make_config(env: str | None, preset: str | None = None, overrides: Mapping[str, Any] | None = None) -> TrainConfig:
    """Return the settings of `preset` (laptop if none) for `env`, with `overrides` by name.

    If `like` is among the overrides, it names a run, whose settings take the place of those of a preset; see `train`.
    The time limit of an environment applies to training and evaluation. Raise ShesError if a name is unknown, or a
    setting is out of range or has no effect.
    """
    asked, own, kept = dict(overrides or {}), dict[str, Any](), dict[str, Any]()
    if (like := asked.pop("like", None)) is not None:
        old = RunFolder.open(like).read_config()
        if preset is not None:
            raise ConfigError(f"preset has no effect with like, got {preset!r}. Omit --preset, or --like.")
        env, preset, kept = env or old.run.env, old.run.preset, dict(old.values)
        own = _own_settings(like, old, env, asked)
    if not env:
        raise ConfigError("a run needs an environment: shes train ENV, or shes train --like RUN for that of a run.")
    preset = RunSettings.preset if preset is None else preset
    if not isinstance(preset, str) or preset not in PRESET_NAMES:
        raise UnknownNameError("preset", str(preset), PRESET_NAMES, "Set --preset.")
    named = with_robot(env, asked.get("robot"))
    if named != env:
        env = named
        del asked["robot"]
    elif asked.get("robot") is not None and env in BUILTIN_ENVIRONMENTS:
        task = env.partition("-")[2]
        raise ConfigError(f"{env} has its own robot, got robot {asked['robot']!r}. Name the task: {task} --robot …")
    asked = {name: os.fspath(value) if isinstance(value, os.PathLike) else value for name, value in asked.items()}
    values = {"env": env, "preset": preset, **preset_values(env, preset, {**own, **asked}), **own, **asked}
    known = by_name(check_names(values))
    asked = {name: known[name].checked(value) for name, value in asked.items()}
    values |= asked
    for level in algorithm_of(RunSettings.of(values)).transfers:
        if values.get(level) is not None:
            values |= brought_settings(level, values, asked if level in asked else {**kept, **asked})
    config = TrainConfig.of(**values)
    check_effects(config, asked)
    return config


def _own_settings(like: Any, old: TrainConfig, env: str, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings `old` of run `like`, but its seed, that are not those of its preset.

    Raise ShesError if a run of `env` has no such setting, or if the run from which `like` took a level is gone.
    """
    run = old.run
    usual = TrainConfig.of(env=run.env, preset=run.preset, **preset_values(run.env, run.preset, old.values)).values
    own = {name: value for name, value in old.values.items() if name != "seed" and value != usual.get(name)}
    algorithm = asked.get("algorithm", run.algorithm)
    known = by_name(settings_by_section(RunSettings.of({"env": env, "algorithm": algorithm})))
    for name in sorted(own.keys() - known.keys()):
        raise ConfigError(
            f"{name} is {own[name]!r} in {like}, but it is not a setting of a run of {env} with algorithm "
            f"{algorithm!r}. Omit --like, and give the settings that you want to keep."
        )
    for level in old.algorithm.transfers:
        if level not in asked and level in own and not RunFolder(find_run(_named(own[level])[0])).config.is_file():
            raise RunFolderError(
                f"{like} took its {level} from {own[level]}, which is not here. Name another one, such as "
                f"{flag(level)} {like}, or set {flag(level)} none to begin without."
            )
    return {**own, "algorithm": run.algorithm}


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
    found = find_environment(env)
    limit = found.with_options(asked).max_episode_steps if isinstance(found, ExternalEnvironment) else None
    limits = {} if limit is None else {"horizon": limit, "evaluation_horizon": limit}
    common, special = (presets.get(preset, Preset()).of(env) for presets in (PRESETS, own))
    settings = by_name(settings_by_section(run))
    values = {**common, **special, **limits, "algorithm": run.algorithm}
    step = asked.get("control_step")
    if env in ROBOT_ENVIRONMENTS and isinstance(step, int | float) and step > 0:  # the preset's times are for its own
        for name in ("horizon", "evaluation_horizon", "controller_interval", "explore_horizon"):
            if values.get(name):
                values[name] = max(1, round(values[name] * RobotOptions.control_step / step))
    return {name: value for name, value in values.items() if name in settings}


def check_effects(config: TrainConfig, asked: Mapping[str, Any]) -> None:
    """Raise ConfigError if a setting in `asked` has no effect with the others.

    Settings that were not asked for may be left from another device, for a run that returns to it.
    """
    settings, has_own_physics = config.settings, find_environment(config.run.env).has_own_physics
    for name, usual in (("backend", ("serial",)), ("num_workers", (0, 1))):
        if config.workers.device != "cpu" and asked.get(name, usual[0]) not in usual:
            raise ConfigError(
                f"{name} is {asked[name]!r}, but one process serves device {config.workers.device}. "
                f"Omit {settings[name].flag}, or set --device cpu."
            )
    for name in asked:
        setting = settings[name]
        is_of_file = name == "integrator" and config.run.env in ROBOT_ENVIRONMENTS
        if is_of_file or (name in setting_fields(TaskOptions) and has_own_physics):
            raise ConfigError(
                f"{name} has no effect on {config.run.env}, which has its own physics, got {asked[name]!r}. "
                f"Omit {setting.flag}{', and set it in the <option> of the robot' * is_of_file}."
            )
        needed = [(need, config.values[need.other]) for need in setting.all_of(Needs) if asked[name] != setting.default]
        if not needed or any(value in need.values if need.values else value is not None for need, value in needed):
            continue
        first, found = needed[0][0], ", ".join(f"{need.other} {value!r}" for need, value in needed)
        fix = " to ".join(filter(None, (settings[first.other].flag, " or ".join(first.values))))
        raise ConfigError(f"{name} has no effect with {found}, got {asked[name]!r}. Set {fix}, or omit {setting.flag}.")
    config.algorithm.check_effects(config, asked)


def transferred_levels() -> tuple[str, ...]:
    """Return the levels that runs of any algorithm may take from another run, which the setting of that name gives."""
    return tuple(dict.fromkeys(level for each in algorithm_classes() for level in each.transfers))


def _named(text: str) -> tuple[str, str]:
    """Return the run and the checkpoint of `RUN@CHECKPOINT`; without one it is the best. An existing path wins."""
    run, _, checkpoint = text.rpartition("@")
    is_given = run and (checkpoint in ("best", "last") or checkpoint.isdecimal()) and not Path(text).exists()
    return (run, checkpoint) if is_given else (text, "best")


def _read(level: str, own: LevelTransfer, values: Mapping[str, Any]) -> OpenedRun:
    """Return the run from which a run with settings `values` takes its `level`; raise ConfigError if it cannot."""
    path, checkpoint = _named(values[level])
    try:
        opened = open_run(path, checkpoint)
    except (CheckpointError, RunFolderError) as error:
        raise type(error)(f"{flag(level)} {values[level]}: {error}") from error
    source = opened.algorithm
    if level not in source.level_names or source.transfers.get(level) is not own:
        raise ConfigError(
            f"{path} has no {level} that can be transferred: it was trained by {opened.config.run.algorithm}, and its "
            f"levels are {', '.join(source.level_names)}. Name a run with --{level} that trained one: {own.trained_by}."
        )
    return opened


def brought_settings(level: str, values: Mapping[str, Any], asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that come with the primitive or the controller, `level`, of another run.

    `values` are the settings of the new run so far; those in `asked` were asked for, not taken from a preset.
    """
    algorithm = algorithm_of(RunSettings.of(values))
    own = algorithm.transfers[level]
    source = _read(level, own, values).config
    if values["env"] in ROBOT_ENVIRONMENTS and "robot" in source.values and not values.get("robot"):
        values = {**values, "robot": source.values["robot"]}
    theirs, ours = _robot(source.run.env, source.values), _robot(values["env"], values)
    if theirs != ours:
        raise ConfigError(
            f"the {level} of {values[level]} does not fit {values['env']}: it was trained on {source.run.env} for "
            f"{theirs}, but {values['env']} has {ours}. Name a {level} of the same robot with --{level}, or omit it."
        )
    brought = own.settings(source, algorithm.level_names)
    if "robot" in source.values:
        brought |= {name: source.values[name] for name in ("motors", "control_step", "robot_keyframe")}
    for name in sorted(brought.keys() & asked.keys()):
        if asked[name] != brought[name]:
            raise ConfigError(
                f"{name} is {asked[name]!r}, but the {level} of {values[level]} was trained with {brought[name]!r}. "
                f"Omit {flag(name)}: it comes with the {level}."
            )
    brought |= {"robot": values["robot"]} if "robot" in source.values else {}
    return brought | {name: source.values[name] for name in own.suggested if name not in asked}


def _robot(env: str, values: Mapping[str, Any]) -> str:
    found = find_environment(env)
    if env in ROBOT_ENVIRONMENTS:
        return f"the robot {read_robot(values.get('robot')).label}"
    return f"the {found.body.name}" if isinstance(found, Environment) else "an external robot"


def transfer(algorithm: Algorithm[Any], state: Any) -> tuple[Any, dict[str, dict[str, Any]]]:
    """Return `state` with the levels from other runs that the settings name, and their origins.

    A level comes with its parameters and observation statistics; raise ConfigError if its inputs or outputs differ.
    """
    origins: dict[str, dict[str, Any]] = {}
    config = algorithm.problem.settings
    for level, own in algorithm.transfers.items():
        path = config.values.get(level)
        if path is None:
            continue
        source = _read(level, own, config.values)
        theirs, ours = own.interface(source.algorithm.problem), own.interface(algorithm.problem)
        if theirs != ours:
            raise ConfigError(
                f"the {level} of {path} does not fit {config.run.env}.\n"
                f"It was trained on {source.config.run.env}: {theirs}.\n"
                f"Here there is: {ours}.\n"
                f"{own.advice}"
            )
        state = own.move(level, source.state, state)
        record = source.folder.read_record() if shipped_name(source.folder.path) is None else {}  # its name says enough
        run, checkpoint = _named(path)
        origins[level] = {
            "run": run,
            "env": source.config.run.env,
            "checkpoint": checkpoint,
            "generation": source.state.generation,
            **{name: record[name] for name in ("config", *source.algorithm.transfers) if name in record},
        }
    return state, origins
