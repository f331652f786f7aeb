"""Transfer: a run that begins with the primitive or the controller of another run. Source: SHES paper, II-D.

A level brings the settings that determine its inputs and layers. They become settings of the new run, which then no
longer needs the folder of the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shes.algorithms.contract import Algorithm, LevelTransfer
from shes.envs.named_environments import Environment, find_environment
from shes.errors import ConfigError
from shes.runs.build import OpenedRun, open_run
from shes.runs.config import RunSettings, algorithm_of
from shes.runs.named_algorithms import ALGORITHMS, algorithm_classes
from shes.settings import flag


def transferred_levels() -> tuple[str, ...]:
    """Return the levels that runs of any algorithm may take from another run, which the setting of that name gives."""
    return tuple(dict.fromkeys(level for each in algorithm_classes() for level in each.transfers))


def _read(level: str, own: LevelTransfer, values: Mapping[str, Any]) -> OpenedRun:
    """Return the run from which a run with settings `values` takes its `level`; raise ConfigError if it cannot."""
    path = values[level]
    opened = open_run(path, values.get(f"{level}_checkpoint", "best"))
    source = opened.algorithm
    if level not in source.level_names:
        raise ConfigError(
            f"{path} has no {level}: its levels are {', '.join(source.level_names)}. Name a run with "
            f"--{level} that trained one: {own.trained_by}."
        )
    if source.transfers.get(level) is not own:
        names = sorted(name for name, cls in ALGORITHMS.items() if cls.transfers.get(level) is own)
        raise ConfigError(
            f"the {level} of {path} was trained by {opened.config.run.algorithm}; only levels that "
            f"{' or '.join(names)} trained can be transferred. Name another run with --{level}."
        )
    return opened


def brought_settings(level: str, values: Mapping[str, Any], asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that come with the primitive or the controller, `level`, of another run.

    `values` are the settings of the new run so far; those in `asked` were asked for, not taken from a preset.
    """
    algorithm = algorithm_of(RunSettings.of(values))
    own = algorithm.transfers[level]
    source = _read(level, own, values).config
    theirs, ours = (_robot(each) for each in (source.run.env, values["env"]))
    if theirs != ours:
        raise ConfigError(
            f"the {level} of {values[level]} does not fit {values['env']}: it was trained on {source.run.env} for "
            f"{theirs}, but {values['env']} has {ours}. Name a {level} of the same robot with --{level}, or omit it."
        )
    brought = own.settings(source, algorithm.level_names)
    for name in sorted(brought.keys() & asked.keys()):
        if asked[name] != brought[name]:
            raise ConfigError(
                f"{name} is {asked[name]!r}, but the {level} of {values[level]} was trained with {brought[name]!r}. "
                f"Omit {flag(name)}: it comes with the {level}."
            )
    return brought | {name: source.values[name] for name in own.suggested if name not in asked}


def _robot(env: str) -> str:
    found = find_environment(env)
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
        state = own.move(source.state, state)
        origins[level] = {
            "run": path,
            "env": source.config.run.env,
            "checkpoint": config.values.get(f"{level}_checkpoint", "best"),
            "generation": source.state.generation,
            **source.folder.origin(),
        }
    return state, origins
