"""What each setting of a run may be, and what says so when it is not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from shes.algorithms.evolution.settings import SCHEDULED
from shes.algorithms.registry import ALGORITHMS
from shes.envs.bodies.symmetry import SYMMETRIES
from shes.envs.tasks.options import SPECS, TARGET_SAMPLINGS
from shes.envs.worlds import INTEGRATORS
from shes.errors import ConfigError, UnknownNameError
from shes.es.mirror import MIRRORINGS
from shes.es.novelty import NOVELTY_RULES
from shes.es.optimizers import OPTIMIZERS
from shes.es.perturbation import PERTURBATIONS
from shes.es.ranking import TIES
from shes.es.schedules import SCHEDULES
from shes.es.shaping import FITNESS_SHAPINGS
from shes.hierarchy.goals import GOAL_ENCODINGS
from shes.hierarchy.outputs import CONTROLLER_OUTPUTS
from shes.hierarchy.population import COMMON_RANDOM_NUMBERS
from shes.hierarchy.rewards import PRIMITIVE_REWARDS
from shes.policies.mlp import BIAS_INITIALISATIONS, OUTPUT_INITIALISATIONS
from shes.registry import Registry
from shes.sim.warp_device import DEVICES

__all__ = [
    "BACKENDS",
    "NAMES",
    "PRIMITIVE_VIEWS",
    "SCHEDULED",
    "check_value",
    "choices",
    "flag",
    "out_of_range",
]

BACKENDS = ("processes", "serial")
PRIMITIVE_VIEWS = ("observation", "proprioception", "egocentric")
"""What a primitive sees: what its environment shows it, the robot's own coordinates alone, or these in the robot's
own frame and without its place."""
CONTROLLER_VIEWS = ("observation", "egocentric")
"""What a controller sees of the robot: what its environment shows, or that in the robot's own frame."""
PRIMITIVE_ESTIMATES = ("episode", "interval")
"""How a primitive is judged: by whole episodes, or by intervals that branch off the same state."""
WEIGHT_DECAY_FORMS = ("gradient", "decoupled")
"""Where the weight decay enters: in the gradient, before the optimizer, or beside the optimizer's step."""

_CHOICES: dict[str, tuple[str, ...]] = {
    "backend": BACKENDS,
    "biases": BIAS_INITIALISATIONS,
    "common_random_numbers": COMMON_RANDOM_NUMBERS,
    "controller_view": CONTROLLER_VIEWS,
    "device": ("cpu", *DEVICES),
    "episodes_schedule": tuple(SCHEDULES),
    "fitness_shaping": tuple(FITNESS_SHAPINGS),
    "integrator": ("default", *INTEGRATORS),
    "learning_rate_schedule": tuple(SCHEDULES),
    "mirrored": MIRRORINGS,
    "novelty": ("none", *NOVELTY_RULES),
    "optimizer": tuple(OPTIMIZERS),
    "output_weights": OUTPUT_INITIALISATIONS,
    "perturbation": tuple(PERTURBATIONS),
    "primitive_estimate": PRIMITIVE_ESTIMATES,
    "primitive_fitness_shaping": tuple(FITNESS_SHAPINGS),
    "primitive_view": PRIMITIVE_VIEWS,
    "rank_ties": TIES,
    "sigma_schedule": tuple(SCHEDULES),
    "spec": tuple(SPECS),
    "symmetry": SYMMETRIES,
    "target_sampling": TARGET_SAMPLINGS,
    "weight_decay_form": WEIGHT_DECAY_FORMS,
}
_REGISTRIES: dict[str, Registry[Any]] = {
    "algorithm": ALGORITHMS,
    "controller_output": CONTROLLER_OUTPUTS,
    "goal_encoding": GOAL_ENCODINGS,
    "primitive_reward": PRIMITIVE_REWARDS,
}
"""Names that users may add to."""
_AT_LEAST: dict[str, int] = {
    "chunk_size": 0,
    "controller_interval": 1,
    "env_steps": 1,
    "episodes_end": 1,
    "episodes_per_policy": 1,
    "evaluation_episodes": 1,
    "evaluation_horizon": 1,
    "evaluation_interval": 1,
    "generations": 1,
    "horizon": 1,
    "intervals": 1,
    "keep_checkpoints": 1,
    "nconmax": 1,
    "njmax": 1,
    "novelty_neighbours": 1,
    "noise_table_size": 2,
    "num_workers": 0,
    "population_size": 1,
    "primitive_population_size": 2,
    "schedule_generations": 1,
    "seed": 0,
}
_POSITIVE = (
    "clock_frequency",
    "goal_distance",
    "learning_rate",
    "minutes",
    "primitive_learning_rate",
    "primitive_sigma",
    "sigma",
    "sigma_end",
)
_NOT_NEGATIVE = (
    "controller_weight_decay",
    "evaluation_reset_noise",
    "fall_price",
    "learning_rate_end",
    "reset_noise",
    "weight_decay",
)
_BETWEEN: dict[str, tuple[str, Callable[[float], bool]]] = {
    "momentum": ("at least 0 and less than 1", lambda number: 0 <= number < 1),
    "statistics_fraction": ("between 0 and 1", lambda number: 0 <= number <= 1),
    "top_fraction": ("more than 0 and less than 1", lambda number: 0 < number < 1),
}
_SWITCHES = ("fall_penalty", "freeze_primitive", "hide_position", "hold_tied", "minimum_goal_distance", "observe_block")
_PLACES = ("evaluation_target", "target")
_HIDDEN = ("hidden", "primitive_hidden")
_OPTIONAL = (
    "clock_frequency",
    "controller_weight_decay",
    "env_steps",
    "evaluation_horizon",
    "minutes",
    "nconmax",
    "njmax",
    "observe_block",
    "primitive_hidden",
    "primitive_learning_rate",
    "primitive_population_size",
    "primitive_sigma",
    *_PLACES,
    *(end for _, end in SCHEDULED.values()),
)

NAMES = (*_REGISTRIES, "preset", "controller_checkpoint", "primitive_checkpoint", *_CHOICES)
"""Settings that are names."""


def flag(name: str) -> str:
    """Return the flag of `train` that sets field `name`."""
    return "--" + {"num_workers": "workers"}.get(name, name).replace("_", "-")


def choices(name: str) -> tuple[str, ...]:
    """Return the names that setting `name` may have; none where it is no name."""
    return tuple(_CHOICES.get(name) or _REGISTRIES.get(name, ()))


def check_value(name: str, value: Any) -> None:
    """Refuse a value that setting `name` cannot have; those of `NAMES` must be strings already.

    Raises:
        ConfigError: It is out of range.
        UnknownNameError: It is a name that is not known.
    """
    if value is None and name in _OPTIONAL:
        return
    if name in _REGISTRIES:
        _REGISTRIES[name].find(str(value))
    if name in _CHOICES and value not in _CHOICES[name]:
        raise UnknownNameError(name.replace("_", " "), str(value), _CHOICES[name], f"Set {flag(name)}.")
    if name in _HIDDEN:
        sizes = value if isinstance(value, tuple) else (None,)
        if any(not isinstance(size, int) or isinstance(size, bool) or size < 1 for size in sizes):
            raise out_of_range(name, value, f"positive whole numbers, e.g. {flag(name)} 64 64")
    if name in _SWITCHES and not isinstance(value, bool):
        raise out_of_range(name, value, "true or false")
    if name in _PLACES and not _is_place(value):
        raise out_of_range(name, value, f"coordinates in metres, e.g. {flag(name)} 0 16")
    _check_number(name, value)


def _check_number(name: str, value: Any) -> None:
    """Refuse a number that is none, or out of its range."""
    is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    is_whole = is_number and isinstance(value, int | np.integer)
    number: float = float(str(value)) if is_number else float("nan")
    if name in _AT_LEAST and not (is_whole and number >= _AT_LEAST[name]):
        raise out_of_range(name, value, f"a whole number of at least {_AT_LEAST[name]}")
    if name in _POSITIVE and not 0 < number < float("inf"):
        raise out_of_range(name, value, "a positive number")
    if name in _NOT_NEGATIVE and not 0 <= number < float("inf"):
        raise out_of_range(name, value, "zero or a positive number")
    if name in _BETWEEN and not _BETWEEN[name][1](number):
        raise out_of_range(name, value, _BETWEEN[name][0])


def _is_place(value: Any) -> bool:
    """Tell whether `value` is a tuple of finite numbers."""
    items: tuple[Any, ...] = value if isinstance(value, tuple) else ()
    are_numbers = [isinstance(item, int | float) and not isinstance(item, bool) for item in items]
    return len(items) > 0 and all(are_numbers) and bool(np.isfinite(items).all())


def out_of_range(name: str, value: Any, allowed: str) -> ConfigError:
    """Return the error of a setting whose value is not `allowed`."""
    return ConfigError(f"{name} must be {allowed}, got {value!r}. Set {flag(name)}.")
