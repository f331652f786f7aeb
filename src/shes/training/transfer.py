"""Transfer: a run that begins with the primitive or the controller of another. Source: SHES paper II-D.

A level brings what it was trained to observe, and the sizes of its layers: a primitive its goal encoding, clock, view
and symmetry; a controller its view and its output. From then on these are settings of the new run, which needs the
other's folder no more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from shes.errors import CheckpointError, ConfigError
from shes.es.level import LevelState, TrainState
from shes.runs.config import RunSettings, TrainConfig, method
from shes.runs.folder import RunFolder
from shes.settings import flag
from shes.training.build import build_task, controller_inputs, primitive_inputs, primitive_layers

__all__ = ["TRANSFERRED", "Transferred", "brought_settings", "transfer"]

TRANSFERRED = ("primitive", "controller")
"""Levels that may come from another run; the setting of this name says from which."""
_BROUGHT = {
    "primitive": ("goal_encoding", "clock_frequency", "hide_position", "symmetry"),
    "controller": ("controller_output", "controller_view", "hidden"),
}
"""Settings that a level was trained with, and that come with it."""
_SUGGESTED = {
    "primitive": (),
    "controller": ("controller_interval", "goal_distance", "minimum_goal_distance"),
}
"""Settings that come along unless somebody asks for another value."""


@dataclass(frozen=True, kw_only=True)
class Transferred:
    """Where a run has a level from."""

    run: str
    """The run folder, or the name of a shipped agent."""
    env: str
    """Its environment."""
    checkpoint: str
    """The checkpoint asked for: `best`, `last` or the number of a generation."""
    generation: int
    """The generation that this was."""


def _read(level: str, path: str, checkpoint: str) -> tuple[TrainConfig, LevelState, Transferred]:
    """Return the settings of the run at `path`, its level of that name, and what is told of them.

    Raises:
        RunFolderError: `path` is neither a run folder nor a shipped agent.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: The run has no such level.
    """
    folder = RunFolder.open(path)
    config = folder.read_config()
    if not folder.checkpoint_path(checkpoint).is_file():
        there = sorted(file.stem for file in folder.checkpoints.glob("*.npz"))
        raise CheckpointError(
            f"{path} has no checkpoint {checkpoint!r}; there are {', '.join(there) or 'none'}. Set "
            f"--{level}-checkpoint to best, last or the number of a generation."
        )
    state = folder.load(checkpoint).state
    levels = {each.name: each for each in state.levels}
    if level not in levels:
        trained_by = {
            "primitive": "shes train ant-flagrun, or a run of two levels with --primitive-view proprioception",
            "controller": "shes train ant-gather, or another run of two levels",
        }[level]
        raise ConfigError(
            f"{path} has no {level}: its levels are {', '.join(levels)}. Name a run with --{level} that trained "
            f"one: {trained_by}."
        )
    told = Transferred(run=path, env=config.run.env, checkpoint=checkpoint, generation=state.generation)
    return config, levels[level], told


def brought_settings(
    level: str, path: str, checkpoint: str, values: Mapping[str, Any], asked: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the settings that a level of the run at `path` brings with it.

    Args:
        level: `primitive` or `controller`.
        path: The run folder, or the name of a shipped agent.
        checkpoint: `best`, `last` or the number of a generation.
        values: The settings of the run that it comes to, so far.
        asked: Those among them that somebody asked for.

    Raises:
        RunFolderError: `path` is neither a run folder nor a shipped agent.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: The run has no such level, or a setting was asked for that the level was not trained with.
    """
    if not isinstance(path, str) or not path:
        raise ConfigError(f"{level} must be the path of a run folder, got {path!r}. Set --{level}.")
    source, _, _ = _read(level, path, checkpoint)
    theirs = source.settings
    brought: dict[str, Any] = {name: theirs[name] for name in _BROUGHT[level]}
    if level == "primitive":
        is_alone = method(RunSettings.of(values)) == "primitive"
        brought["hidden" if is_alone else "primitive_hidden"] = primitive_layers(source)
        is_plain = source.level_names == ("primitive",) and source.hierarchy.primitive_view == "observation"
        brought["primitive_view"] = "proprioception" if is_plain else source.hierarchy.primitive_view
    for name in sorted(brought.keys() & asked.keys()):
        wanted = tuple(asked[name]) if isinstance(asked[name], list) else asked[name]
        if wanted != brought[name]:
            raise ConfigError(
                f"{name} is {wanted!r}, but the {level} of {path} was trained with {brought[name]!r}. "
                f"Leave {flag(name)} away: it comes with the {level}."
            )
    return brought | {name: theirs[name] for name in _SUGGESTED[level] if name not in asked}


def transfer(config: TrainConfig, state: TrainState) -> tuple[TrainState, dict[str, Transferred]]:
    """Return `state` with the levels that `config` names of other runs, and where each of these is from.

    A level comes with its parameters and its observation statistics.

    Raises:
        RunFolderError: There is no such run folder.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: The level does not fit: it observes, or controls, something else.
    """
    origins: dict[str, Transferred] = {}
    for name in TRANSFERRED:
        path = config.settings.get(name)
        if path is None:
            continue
        source, level, told = _read(name, path, config.settings[f"{name}_checkpoint"])
        _check_fit(name, path, source, config)
        levels = tuple(
            replace(each, theta=level.theta, statistics=level.statistics) if each.name == name else each
            for each in state.levels
        )
        state, origins[name] = replace(state, levels=levels), told
    return state, origins


def _check_fit(level: str, path: str, source: TrainConfig, config: TrainConfig) -> None:
    """Refuse a level of the run at `path` that observes, or controls, something else than that of `config`.

    Raises:
        ConfigError: It does.
    """
    layout, advice = {
        "primitive": (
            _primitive_layout,
            (
                "Name a primitive of the same robot, trained with the same --spec by shes train ant-flagrun or "
                "point-flagrun, or by a run of two levels with --primitive-view proprioception (for the point of Fall, "
                "which has a height)."
            ),
        ),
        "controller": (_controller_layout, "Name a controller of the same task, trained with the same --spec."),
    }[level]
    theirs, ours = layout(source), layout(config)
    if theirs != ours:
        raise ConfigError(
            f"the {level} of {path} does not fit {config.run.env}.\n"
            f"It was trained on {source.run.env}: {theirs}.\n"
            f"Here there is: {ours}.\n"
            f"{advice}"
        )


def _primitive_layout(config: TrainConfig) -> str:
    """Return what the primitive of `config` observes and controls, in words."""
    inputs = primitive_inputs(config)
    task = build_task(config, 1, is_evaluation=False)
    task.close()
    kind = config.hierarchy.symmetry
    symmetry = "" if kind == "none" else f" ({kind} symmetry)"
    return (
        f"{len(inputs)} inputs{symmetry} ({', '.join(inputs)}) of specification {config.environment.spec} and "
        f"{task.action_size} controls of up to {task.control_limit:g}"
    )


def _controller_layout(config: TrainConfig) -> str:
    """Return what the controller of `config` observes and puts out, in words."""
    inputs = controller_inputs(config)
    told = f"specification {config.environment.spec}, output {config.hierarchy.controller_output}"
    return f"{len(inputs)} inputs ({', '.join(inputs)}) of {told}"
