"""What may differ between two uses of one task. Values come from users, so every one is checked here, once."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from shes.envs.value_kinds import is_number, is_switch, is_whole
from shes.envs.worlds import INTEGRATORS
from shes.errors import ConfigError, UnknownNameError

__all__ = ["FURTHEST_M", "SPECS", "TARGET_SAMPLINGS", "TaskOptions"]

SPECS = {"shes": "euler", "hiro": "rk4"}
"""Specifications and their integrators."""
TARGET_SAMPLINGS = ("square", "free_cells")
FURTHEST_M = 1000.0
"""No target or goal is further away along an axis: every world ends before that, and squares must stay finite."""


@dataclass(frozen=True, kw_only=True)
class TaskOptions:
    """What may differ between two uses of one task."""

    spec: str = "shes"
    """Which published specification: `shes` (the SHES authors' environments) or `hiro` (Nachum et al. 2018, rllab)."""
    integrator: str = "default"
    """`euler`, `rk4`, `implicitfast`, or `default`: that of the specification, `euler` for shes and `rk4` for hiro."""
    reset_noise: float = 0.1
    """Half width of the uniform noise on qpos, standard deviation of the normal noise on qvel, at a reset.

    Deviation: 0.1 (the authors' environments: 0), so that ten evaluation episodes are not ten equal ones.
    """
    evaluation: bool = False
    """Whether evaluation's targets are used in place of training's, where the task has targets."""
    target_sampling: str = "square"
    """Maze, training: the target is uniform in the `square` [-4, 20] x [-4, 20] m, or there in `free_cells` only."""
    target: tuple[float, ...] | None = None
    """Maze, Push, Fall, training: a fixed target in metres in place of the task's own."""
    evaluation_target: tuple[float, ...] | None = None
    """Maze, Push, Fall: the target of evaluation in metres in place of the task's own."""
    observe_block: bool | None = None
    """Push, Fall: whether the block is observed; in shes it is, in hiro it is not, unless this says so."""
    fall_penalty: bool = True
    """Gather, hiro: whether the step of a fall pays -10 in place of its pickups."""
    goal_interval: int = 25
    """Flagrun: control steps that a goal is held."""
    goal_range: float = 4.0
    """Flagrun: a goal is drawn within this of the robot along each axis, in metres."""

    def __post_init__(self) -> None:
        """Check every value; NumPy's numbers become Python's, lists and arrays of coordinates tuples.

        Raises:
            ConfigError: A value is out of range or of another kind.
            UnknownNameError: `spec`, `integrator` or `target_sampling` is not known.
        """
        integrators = ("default", *INTEGRATORS)
        self._set("spec", _name("spec", "spec", self.spec, SPECS, "Change spec (--spec)."))
        self._set(
            "integrator",
            _name("integrator", "integrator", self.integrator, integrators, "Set integrator (--integrator)."),
        )
        if self.integrator == "default":
            self._set("integrator", SPECS[self.spec])
        sampling = _name(
            "target_sampling", "target sampling", self.target_sampling, TARGET_SAMPLINGS, "Set --target-sampling."
        )
        self._set("target_sampling", sampling)
        noise = self.reset_noise
        if not (is_number(noise) and 0 <= noise < 1):
            raise ConfigError(f"reset_noise must be in [0, 1), got {noise!r}. Set it (--reset-noise).")
        self._set("reset_noise", float(noise))
        self._set("evaluation", _switch("evaluation", self.evaluation, "Set evaluation=True or False."))
        self._set("fall_penalty", _switch("fall_penalty", self.fall_penalty, "Set it (--fall-penalty)."))
        if self.observe_block is not None:
            fix = "Set it (--observe-block), or leave it to the specification (None)."
            self._set("observe_block", _switch("observe_block", self.observe_block, fix))
        for name in ("target", "evaluation_target"):
            self._set(name, _place(name, getattr(self, name)))
        interval = self.goal_interval
        if not (is_whole(interval) and interval >= 1):
            raise ConfigError(
                f"goal_interval must be a whole number of at least 1, got {interval!r}. Set --controller-interval."
            )
        self._set("goal_interval", int(interval))
        reach = self.goal_range
        if not (is_number(reach) and 1 <= reach <= FURTHEST_M):
            raise ConfigError(
                f"goal_range must be at least 1 m, and at most {FURTHEST_M:g}, got {reach!r}. Set --goal-distance."
            )
        self._set("goal_range", float(reach))

    def _set(self, name: str, value: Any) -> None:
        """Give a field its plain value, while the options are made."""
        object.__setattr__(self, name, value)


def _name(option: str, kind: str, value: Any, known: Collection[str], fix: str) -> str:
    """Return `value`, one of the `known` names."""
    if not isinstance(value, str):
        raise ConfigError(f"{option} must be one of {', '.join(known)}, got {value!r}. {fix}")
    if value not in known:
        raise UnknownNameError(kind, value, known, fix)
    return str(value)


def _switch(option: str, value: Any, fix: str) -> bool:
    """Return `value`, True or False."""
    if not is_switch(value):
        raise ConfigError(f"{option} must be True or False, got {value!r}. {fix}")
    return bool(value)


def _place(option: str, value: Any) -> tuple[float, ...] | None:
    """Return `value`, coordinates or None, as Python's numbers."""
    if value is None:
        return None
    is_list = isinstance(value, Sequence) or (isinstance(value, np.ndarray) and value.ndim == 1)
    coordinates: list[Any] = list(value) if is_list else [None]
    if not all(is_number(each) and -FURTHEST_M <= each <= FURTHEST_M for each in coordinates):
        raise ConfigError(
            f"{option} must be coordinates in metres, numbers from {-FURTHEST_M:g} to {FURTHEST_M:g}, got {value!r}. "
            f"Set --{option.replace('_', '-')}, in Python {option}=(0, 16)."
        )
    return tuple(float(each) for each in coordinates)
