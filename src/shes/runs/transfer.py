"""Transfer: a run that begins with the primitive or the controller of another run. Source: SHES paper, II-D.

A level brings the settings that determine its inputs and layers. They become settings of the new run, which then no
longer needs the folder of the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shes.algorithms.contract import Algorithm, LevelTransfer
from shes.errors import CheckpointError, ConfigError
from shes.runs.build import OpenedRun, build_task, open_run
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder
from shes.runs.named_algorithms import ALGORITHMS, algorithm_classes
from shes.runs.comparison import origin_of
from shes.runs.config import RunSettings, algorithm_of
from shes.settings import flag


def transferred_levels() -> tuple[str, ...]:
    """Return the levels that runs of any algorithm may take from another run, which the setting of that name gives."""
    return tuple(dict.fromkeys(level for each in algorithm_classes() for level in each.transfers))


def _read(level: str, own: LevelTransfer, path: str, checkpoint: str) -> tuple[OpenedRun, dict[str, Any]]:
    """Return the run at `path`, whose `level` can be transferred, and the level's origin for the record."""
    folder = RunFolder.open(path)
    if not folder.checkpoint_path(checkpoint).is_file():
        stems = (file.stem.removeprefix("generation_") for file in folder.checkpoints.glob("*.npz"))
        there = ", ".join(str(int(stem)) if stem.isdecimal() else stem for stem in sorted(stems)) or "none"
        raise CheckpointError(f"{path} has no checkpoint {checkpoint!r}; it has {there}. Set --{level}-checkpoint.")
    opened = open_run(path, checkpoint)
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
    env, generation = opened.config.run.env, opened.state.generation
    origin = {"run": path, "env": env, "checkpoint": checkpoint, "generation": generation}
    return opened, {**origin, **origin_of(folder)}


def brought_settings(
    level: str, path: str, checkpoint: str, values: Mapping[str, Any], asked: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the settings that come with the primitive or the controller, `level`, of the run at `path`.

    `values` are the settings of the new run so far; those in `asked` were asked for, not taken from a preset.

    Raises:
        ConfigError: The run has no such level, or a setting was asked for with another value than the level's.
    """
    algorithm = algorithm_of(RunSettings.of(values))
    own = algorithm.transfers[level]
    source = _read(level, own, path, checkpoint)[0].config
    brought = own.settings(source, algorithm.level_names)
    for name in sorted(brought.keys() & asked.keys()):
        if asked[name] != brought[name]:
            raise ConfigError(
                f"{name} is {asked[name]!r}, but the {level} of {path} was trained with {brought[name]!r}. "
                f"Omit {flag(name)}: it comes with the {level}."
            )
    return brought | {name: source.values[name] for name in own.suggested if name not in asked}


def check_robot(config: TrainConfig) -> None:
    """Raise ConfigError if the primitive that `config` names was trained with another robot."""
    own, path = config.algorithm.transfers.get("primitive"), config.values.get("primitive")
    if own is None or path is None:
        return
    source = _read("primitive", own, path, config.values["primitive_checkpoint"])[0].config
    (their_robot, theirs), (our_robot, ours) = _robot(source), _robot(config)
    # External robots can only be compared by their observation specs; but they have no egocentric view.
    is_known = None not in (their_robot, our_robot) or own.is_egocentric(source)
    if is_known and their_robot != our_robot:
        raise ConfigError(
            f"the primitive of {path} does not fit {config.run.env}: it was trained on {source.run.env} for "
            f"{theirs}, but {config.run.env} has {ours}. Name a primitive of the same robot with --primitive, or "
            "omit it."
        )


def _robot(config: TrainConfig) -> tuple[str | None, str]:
    """Return the name of the robot of `config`, None for an external one, and its description."""
    task = build_task(config, 1, is_evaluation=False)
    task.close()
    name = None if task.robot is None else task.robot.name
    who = "an external robot" if name is None else f"the {name}"
    return name, f"{who} with {task.action_size} controls of up to {task.control_limit:g}"


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
        source, origins[level] = _read(level, own, path, config.values.get(f"{level}_checkpoint", "best"))
        theirs, ours = own.interface(source.algorithm.problem), own.interface(algorithm.problem)
        if theirs != ours:
            raise ConfigError(
                f"the {level} of {path} does not fit {config.run.env}.\n"
                f"It was trained on {source.config.run.env}: {theirs}.\n"
                f"Here there is: {ours}.\n"
                f"{own.advice}"
            )
        state = own.move(source.state, state)
    return state, origins
