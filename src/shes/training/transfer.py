"""Transfer: a run that begins with the primitive or the controller of another run. Source: SHES paper, II-D.

A level brings the settings that determine its inputs and layers: a primitive its goal encoding, clock, view and
symmetry; a controller its view and output. They become settings of the new run, which then no longer needs the folder
of the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from shes.algorithms.contract import Algorithm
from shes.algorithms.evolution.designs import primitive_layers
from shes.algorithms.evolution.learners import EvolutionAlgorithm
from shes.errors import CheckpointError, ConfigError
from shes.es.level import LevelState
from shes.runs.config import TrainConfig
from shes.runs.folder import RunFolder
from shes.runs.rooms import RunSettings, learner
from shes.settings import flag
from shes.training.build import OpenedRun, build_task, open_run

TRANSFERRED = ("primitive", "controller")
"""Levels that may come from another run, which the setting of the same name gives."""
_BROUGHT = {
    "primitive": ("goal_encoding", "clock_frequency", "hide_position", "symmetry"),
    "controller": ("controller_output", "controller_view", "hidden"),
}
"""Settings that come with a level."""
_SUGGESTED = {"primitive": (), "controller": ("controller_interval", "goal_distance", "minimum_goal_distance")}
"""Settings that come with a level unless another value is asked for."""


def _read(level: str, path: str, checkpoint: str) -> tuple[OpenedRun, LevelState, dict[str, Any]]:
    """Return the run at `path`, the state of its level of this name, and the level's origin for the record."""
    folder = RunFolder.open(path)
    if not folder.checkpoint_path(checkpoint).is_file():
        there, checkpoint_flag = _checkpoint_names(folder), f"--{level}-checkpoint"
        fix = f"Omit {checkpoint_flag}." if there == ["best"] else f"Set {checkpoint_flag} to one of these."
        raise CheckpointError(f"{path} has no checkpoint {checkpoint!r}; it has {', '.join(there) or 'none'}. {fix}")
    opened = open_run(path, checkpoint)
    levels = {each.name: each for each in getattr(opened.state, "levels", ())}  # an algorithm other than ES has none
    if level not in levels and level in opened.algorithm.level_names:
        raise ConfigError(
            f"the {level} of {path} was trained by {opened.config.run.algorithm}; only levels that evolution "
            f"strategies trained can be transferred. Name another run with --{level}."
        )
    if level not in levels:
        trained_by = {
            "primitive": "shes train ant-flagrun, or a run of two levels with --primitive-view proprioception",
            "controller": "shes train ant-gather, or another run of two levels",
        }[level]
        raise ConfigError(
            f"{path} has no {level}: its levels are {', '.join(opened.algorithm.level_names)}. Name a run with "
            f"--{level} that trained one: {trained_by}."
        )
    env, generation = opened.config.run.env, opened.state.generation
    return opened, levels[level], {"run": path, "env": env, "checkpoint": checkpoint, "generation": generation}


def _checkpoint_names(folder: RunFolder) -> list[str]:
    stems = sorted(file.stem for file in folder.checkpoints.glob("*.npz"))
    prefix = "generation_"
    return [f"{int(stem.removeprefix(prefix))}" if stem.startswith(prefix) else stem for stem in stems]


def brought_settings(
    level: str, path: str, checkpoint: str, values: Mapping[str, Any], asked: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the settings that come with the primitive or the controller, `level`, of the run at `path`.

    `values` are the settings of the new run so far; those in `asked` were asked for, not taken from a preset.

    Raises:
        RunFolderError: `path` is neither a run folder nor a shipped agent.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: The run has no such level, or a setting was asked for with another value than the level's.
    """
    if not isinstance(path, str) or not path:
        raise ConfigError(f"{level} must be the path of a run folder, got {path!r}. Set --{level}.")
    source = _read(level, path, checkpoint)[0].config
    theirs = source.settings
    brought: dict[str, Any] = {name: theirs[name] for name in _BROUGHT[level]}
    if level == "primitive":
        is_alone = learner(RunSettings.of(values)).level_names == ("primitive",)
        brought["hidden" if is_alone else "primitive_hidden"] = primitive_layers(source)
        is_plain = source.level_names == ("primitive",) and source.hierarchy.primitive_view == "observation"
        brought["primitive_view"] = "proprioception" if is_plain else source.hierarchy.primitive_view
    for name in sorted(brought.keys() & asked.keys()):
        wanted = tuple(asked[name]) if isinstance(asked[name], list) else asked[name]
        if wanted != brought[name]:
            raise ConfigError(
                f"{name} is {wanted!r}, but the {level} of {path} was trained with {brought[name]!r}. "
                f"Omit {flag(name)}: it comes with the {level}."
            )
    return brought | {name: theirs[name] for name in _SUGGESTED[level] if name not in asked}


def check_robot(config: TrainConfig) -> None:
    """Raise ConfigError if the primitive that `config` names was trained with another robot."""
    path = config.settings.get("primitive")
    if path is None:
        return
    source = _read("primitive", path, config.transfer.primitive_checkpoint)[0].config
    (their_robot, theirs), (our_robot, ours) = _robot(source), _robot(config)
    # External robots can only be compared by their observation specs; but they have no egocentric view.
    is_known = None not in (their_robot, our_robot) or source.hierarchy.primitive_view == "egocentric"
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
    for name in TRANSFERRED:
        path = config.settings.get(name)
        if path is None or not isinstance(algorithm, EvolutionAlgorithm):
            continue
        source, level, origin = _read(name, path, config.settings[f"{name}_checkpoint"])
        assert isinstance(source.algorithm, EvolutionAlgorithm)
        _check_fit(name, path, source.algorithm, algorithm)
        state, origins[name] = algorithm.with_level(state, name, level), origin
    return state, origins


def _check_fit(level: str, path: str, source: EvolutionAlgorithm, own: EvolutionAlgorithm) -> None:
    """Raise ConfigError unless a level of the run at `path` has the inputs and outputs of the level in our own run."""
    spec, advice = {
        "primitive": (
            _primitive_spec,
            (
                "Name a primitive of the same robot, trained with the same --spec by shes train ant-flagrun or "
                "point-flagrun, or by a run of two levels with --primitive-view proprioception (for the point of Fall, "
                "which has a height)."
            ),
        ),
        "controller": (_controller_spec, "Name a controller of the same task, trained with the same --spec."),
    }[level]
    theirs, ours = spec(source), spec(own)
    if theirs != ours:
        raise ConfigError(
            f"the {level} of {path} does not fit {own.problem.name}.\n"
            f"It was trained on {source.problem.name}: {theirs}.\n"
            f"Here there is: {ours}.\n"
            f"{advice}"
        )


def _primitive_spec(algorithm: EvolutionAlgorithm) -> str:
    """Return the inputs and outputs of the primitive in words."""
    inputs, task, settings = algorithm.inputs("primitive"), algorithm.problem.sample(), algorithm.problem.settings
    kind = settings.hierarchy.symmetry
    symmetry = "" if kind == "none" else f" ({kind} symmetry)"
    return (
        f"{len(inputs)} inputs{symmetry} ({', '.join(inputs)}) of specification {settings.environment.spec} and "
        f"{task.action_size} controls of up to {task.control_limit:g}"
    )


def _controller_spec(algorithm: EvolutionAlgorithm) -> str:
    """Return the inputs and outputs of the controller in words."""
    inputs, settings = algorithm.inputs("controller"), algorithm.problem.settings
    spec = f"specification {settings.environment.spec}, output {settings.hierarchy.controller_output}"
    return f"{len(inputs)} inputs ({', '.join(inputs)}) of {spec}"
