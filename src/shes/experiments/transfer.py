"""Transfer: a run that begins with the primitive of another one. Source: SHES paper II-D; algorithm specification, 6.

The primitive brings what it was trained to observe: goal encoding, clock, view, symmetry, sizes of its layers.
From then on these are settings of the new run, which needs the other's folder no more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from shes.errors import CheckpointError, ConfigError
from shes.es.level import LevelState, TrainState
from shes.experiments.build import build_task, primitive_inputs
from shes.experiments.config import TrainConfig
from shes.experiments.run_folder import RunFolder
from shes.experiments.settings import flag

__all__ = ["Transferred", "brought_settings", "check_robot", "transfer_primitive"]

_BROUGHT = ("goal_encoding", "clock_frequency", "hide_position", "symmetry")


@dataclass(frozen=True, kw_only=True)
class Transferred:
    """Where a run has its primitive from."""

    run: str
    """The run folder, or the name of a shipped agent."""
    env: str
    """Its environment."""
    checkpoint: str
    """The checkpoint asked for: `best`, `last` or the number of a generation."""
    generation: int
    """The generation that this was."""


def _read(path: str, checkpoint: str) -> tuple[TrainConfig, LevelState, Transferred]:
    """Return the settings of the run at `path`, its primitive, and what is told of them.

    Raises:
        RunFolderError: `path` is neither a run folder nor a shipped agent.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: The run has no primitive.
    """
    folder = RunFolder.open(path)
    config = folder.read_config()
    if not folder.checkpoint_path(checkpoint).is_file():
        there = _checkpoint_names(folder)
        fix = (
            "Leave --primitive-checkpoint away." if there == ["best"] else "Set --primitive-checkpoint to one of these."
        )
        raise CheckpointError(f"{path} has no checkpoint {checkpoint!r}; it has {', '.join(there) or 'none'}. {fix}")
    state = folder.load(checkpoint).state
    levels = {level.name: level for level in state.levels}
    if "primitive" not in levels:
        raise ConfigError(
            f"{path} has no primitive: its levels are {', '.join(levels)}. Name a run with --primitive that trained "
            "one: shes train ant-flagrun, or a run of two levels with --primitive-view proprioception."
        )
    told = Transferred(run=path, env=config.env, checkpoint=checkpoint, generation=state.generation)
    return config, levels["primitive"], told


def _checkpoint_names(folder: RunFolder) -> list[str]:
    """Return what --primitive-checkpoint may name in `folder`."""
    stems = sorted(file.stem for file in folder.checkpoints.glob("*.npz"))
    prefix = "generation_"
    return [f"{int(stem.removeprefix(prefix))}" if stem.startswith(prefix) else stem for stem in stems]


def brought_settings(path: str, checkpoint: str, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that the primitive of the run at `path` brings with it.

    Args:
        path: The run folder, or the name of a shipped agent.
        checkpoint: `best`, `last` or the number of a generation.
        asked: Settings that somebody asked for.

    Raises:
        RunFolderError: `path` is neither a run folder nor a shipped agent.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: The run has no primitive, or a setting was asked for that the primitive was not trained with.
    """
    if not isinstance(path, str) or not path:
        raise ConfigError(f"primitive must be the path of a run folder, got {path!r}. Set --primitive.")
    source, _, _ = _read(path, checkpoint)
    brought: dict[str, Any] = {name: getattr(source, name) for name in _BROUGHT}
    brought["primitive_hidden"] = source.hidden if source.primitive_hidden is None else source.primitive_hidden
    is_alone = source.level_names == ("primitive",)
    is_plain = is_alone and source.primitive_view == "observation"
    brought["primitive_view"] = "proprioception" if is_plain else source.primitive_view
    for name in sorted(brought.keys() & asked.keys()):
        wanted = tuple(asked[name]) if isinstance(asked[name], list) else asked[name]
        if wanted != brought[name]:
            raise ConfigError(
                f"{name} is {wanted!r}, but the primitive of {path} was trained with {brought[name]!r}. "
                f"Leave {flag(name)} away: it comes with the primitive."
            )
    return brought


def check_robot(config: TrainConfig) -> None:
    """Refuse a primitive of another robot: before the parts of the run are built by the settings that it brings.

    Raises:
        RunFolderError: There is no such run folder.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: The primitive that `config` names was trained with another robot.
    """
    if config.primitive is None:
        return
    source, _, _ = _read(config.primitive, config.primitive_checkpoint)
    (their_robot, theirs), (our_robot, ours) = _robot(source), _robot(config)
    # What an external robot is like, only the layouts can tell; but it has no egocentric view.
    is_known = None not in (their_robot, our_robot) or source.primitive_view == "egocentric"
    if is_known and their_robot != our_robot:
        raise ConfigError(
            f"the primitive of {config.primitive} does not fit {config.env}: it was trained on {source.env} for "
            f"{theirs}, but {config.env} has {ours}. Name a primitive of the same robot with --primitive, or leave it "
            "away."
        )


def _robot(config: TrainConfig) -> tuple[str | None, str]:
    """Return the name of the robot of `config`, None for an external one, and what it is in words."""
    task = build_task(config, 1, is_evaluation=False)
    task.close()
    name = None if task.robot is None else task.robot.name
    who = "an external robot" if name is None else f"the {name}"
    return name, f"{who} with {task.action_size} controls of up to {task.control_limit:g}"


def transfer_primitive(config: TrainConfig, state: TrainState) -> tuple[TrainState, Transferred | None]:
    """Return `state` with the primitive that `config` names, if it names one, and where that is from.

    The primitive comes with its parameters and its observation statistics.

    Raises:
        RunFolderError: There is no such run folder.
        CheckpointError: The checkpoint is missing or damaged.
        ConfigError: The primitive does not fit: it observes, or controls, something else.
    """
    if config.primitive is None:
        return state, None
    source, primitive, told = _read(config.primitive, config.primitive_checkpoint)
    theirs, ours = _layout(source), _layout(config)
    if theirs != ours:
        raise ConfigError(
            f"the primitive of {config.primitive} does not fit {config.env}.\n"
            f"It was trained on {source.env}: {theirs}.\n"
            f"Here there is: {ours}.\n"
            "Name a primitive of the same robot, trained with the same --spec by shes train ant-flagrun or "
            "point-flagrun, or by a run of two levels with --primitive-view proprioception (for the point of Fall, "
            "which has a height)."
        )
    levels = tuple(
        replace(level, theta=primitive.theta, statistics=primitive.statistics) if level.name == "primitive" else level
        for level in state.levels
    )
    return replace(state, levels=levels), told


def _layout(config: TrainConfig) -> str:
    """Return what the primitive of `config` observes and controls, in words."""
    inputs = primitive_inputs(config)
    task = build_task(config, 1, is_evaluation=False)
    task.close()
    symmetry = "" if config.symmetry == "none" else f" ({config.symmetry} symmetry)"
    return (
        f"{len(inputs)} inputs{symmetry} ({', '.join(inputs)}) of specification {config.spec} and {task.action_size} "
        f"controls of up to {task.control_limit:g}"
    )
