"""Every setting of a training run. It stops here: the rooms below take plain arguments."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from shes.envs.external.description import ExternalDescription
from shes.envs.registry import check_external_name, find_description
from shes.envs.task import SPECS, TARGET_SAMPLINGS
from shes.envs.worlds import INTEGRATORS
from shes.errors import ConfigError, UnknownNameError
from shes.es.mirror import MIRRORINGS, check_population
from shes.es.ranking import TIES
from shes.hierarchy.goals import GOAL_ENCODINGS, check_goal_encoding
from shes.hierarchy.rewards import PRIMITIVE_REWARDS, check_primitive_reward
from shes.policies.mlp import BIAS_INITIALISATIONS

__all__ = ["BACKENDS", "EXECUTION_FIELDS", "HEADINGS", "WITHOUT_FLAG", "TrainConfig", "check_fields", "choices", "flag"]

BACKENDS = ("processes", "serial")

EXECUTION_FIELDS = frozenset(
    {"preset", "backend", "num_workers", "chunk_size", "generations", "minutes", "keep_checkpoints"}
)
"""Settings that say how, where and how long, and never change a number of a generation."""

WITHOUT_FLAG = frozenset({"env", "external"})
"""Settings that `shes train` takes as its first word: a name, or a file that describes an external environment."""

HEADINGS: dict[str, str] = {
    "env": "run",
    "backend": "workers",
    "population_size": "population and update",
    "hidden": "networks",
    "controller_interval": "hierarchy",
    "horizon": "episodes and environment",
    "evaluation_interval": "evaluation, checkpoints, memory",
}
"""Where the sections of `TrainConfig` begin, and what the help of `shes train` calls them."""

_CHOICES: dict[str, tuple[str, ...]] = {
    "backend": BACKENDS,
    "biases": BIAS_INITIALISATIONS,
    "integrator": ("default", *INTEGRATORS),
    "mirrored": MIRRORINGS,
    "rank_ties": TIES,
    "spec": tuple(SPECS),
    "target_sampling": TARGET_SAMPLINGS,
}
_REGISTERED: dict[str, Callable[[str], None]] = {
    "goal_encoding": check_goal_encoding,
    "primitive_reward": check_primitive_reward,
}
"""Names that users may add to, and what refuses an unknown one."""
_REGISTRIES: dict[str, Mapping[str, Any]] = {
    "goal_encoding": GOAL_ENCODINGS,
    "primitive_reward": PRIMITIVE_REWARDS,
}
_AT_LEAST: dict[str, int] = {
    "chunk_size": 0,
    "controller_interval": 1,
    "episodes_per_policy": 1,
    "evaluation_episodes": 1,
    "evaluation_horizon": 1,
    "evaluation_interval": 1,
    "generations": 1,
    "horizon": 1,
    "keep_checkpoints": 1,
    "noise_table_size": 2,
    "num_workers": 0,
    "population_size": 1,
    "seed": 0,
}
_POSITIVE = ("goal_distance", "learning_rate", "minutes", "sigma")
_NOT_NEGATIVE = ("evaluation_reset_noise", "reset_noise", "weight_decay")
_FRACTIONS = ("statistics_fraction",)
_SWITCHES = ("common_random_numbers", "fall_penalty", "minimum_goal_distance", "observe_block")
_PLACES = ("evaluation_target", "target")
_OPTIONAL = ("evaluation_horizon", "minutes", "observe_block", *_PLACES)


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """Settings of a training run. Table and sections are those of the SHES paper."""

    # Deviation: the defaults are the preset `laptop`, not the paper's Table I; the docstrings name its values.

    env: str
    """Environment; `shes envs` lists them."""
    preset: str = "laptop"
    """What the other settings start from: paper, laptop or smoke."""
    external: ExternalDescription | None = None
    """What describes the environment if Gymnasium makes it; that of its name if none."""
    seed: int = 1
    """Seed of every random draw."""
    generations: int = 1000
    """Generations after which the run ends (Table I: 3000)."""
    minutes: float | None = None
    """Minutes after which this call ends, whichever comes first."""

    backend: str = "processes"
    """Where the work is done: processes (on this machine) or serial (in this process)."""
    num_workers: int = 0
    """Worker processes; 0 is one for every core. Never changes a number."""
    chunk_size: int = 0
    """Policies that a worker runs in lockstep; 0 chooses. Never changes a number."""

    population_size: int = 240
    """Policies in a generation, mirrored ones included (Table I: 1000)."""
    episodes_per_policy: int = 1
    """Episodes that a policy's fitness is the mean of (Table I: 5)."""
    sigma: float = 0.07
    """Standard deviation of the perturbations (Table I: 0.02)."""
    learning_rate: float = 0.01
    """Adam's learning rate (Table I: 0.01)."""
    weight_decay: float = 0.005
    """Coefficient of the parameters subtracted from the gradient estimate (authors' code: 0.005)."""
    mirrored: str = "quad"
    """How the members of a group mirror its noise: quad, pair or none (section II-F)."""
    rank_ties: str = "average"
    """How equal fitnesses rank: average or index."""
    common_random_numbers: bool = True
    """Whether the members of a group share their episodes' seeds."""
    statistics_fraction: float = 1.0
    """Share of the groups whose observations enter the observation statistics."""

    hidden: tuple[int, ...] = (32,)
    """Hidden layers of both policies (paper: 256 256 256); no number makes them linear."""
    biases: str = "zero"
    """How biases start: zero or glorot_normal."""
    controller_interval: int = 25
    """Steps that a goal is held (c in Table I: 25)."""
    goal_distance: float = 4.0
    """Metres that a controller's output of 1 stands for (Table I)."""
    minimum_goal_distance: bool = True
    """Whether goals nearer than 1 m are pushed outward."""
    goal_encoding: str = "angle"
    """What the primitive is told about its goal: angle (section II-C)."""
    primitive_reward: str = "progress"
    """What the primitive is paid: progress (section II-B, equation 1)."""

    horizon: int = 200
    """Control steps in an episode of training (Table I: 500)."""
    evaluation_horizon: int | None = None
    """Control steps in an episode of evaluation; the same as in training if none."""
    spec: str = "shes"
    """Published specification of the environment: shes, or hiro (Nachum et al. 2018, rllab)."""
    integrator: str = "default"
    """MuJoCo's integrator; default is that of the specification: euler for shes, rk4 for hiro."""
    reset_noise: float = 0.1
    """Noise on the robot's pose and velocity at a reset, in training."""
    evaluation_reset_noise: float = 0.1
    """The same in evaluation."""
    target_sampling: str = "square"
    """Maze: training's targets are uniform in a square that covers walls too, or there in free_cells only."""
    target: tuple[float, ...] | None = None
    """Maze, push, fall: a fixed target of training, in metres, in place of the task's own."""
    evaluation_target: tuple[float, ...] | None = None
    """Maze, push, fall: the target of evaluation, in metres, in place of the task's own."""
    observe_block: bool | None = None
    """Push, fall: whether the block is observed; none leaves it to the specification (shes: yes, hiro: no)."""
    fall_penalty: bool = True
    """Gather, hiro: whether the step of a fall pays -10 in place of its pickups."""
    evaluation_interval: int = 10
    """Generations between evaluations of the mean policies (there is one after the first generation, too)."""
    evaluation_episodes: int = 50
    """Episodes of an evaluation."""
    keep_checkpoints: int = 50
    """Generations between checkpoints that are kept beside `last` and `best`."""
    noise_table_size: int = 25_000_000
    """Normals in the shared noise table, 4 bytes each (authors' code: 250 million)."""

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ConfigError: A value is out of range.
            UnknownNameError: A name is in no registry.
        """
        for field in fields(self):
            object.__setattr__(self, field.name, _plain(getattr(self, field.name)))
        for name in ("env", *_REGISTERED, "preset", *_CHOICES):
            if not isinstance(getattr(self, name), str):
                raise _out_of_range(name, getattr(self, name), "a name")
        self._find_description()
        for name, check in _REGISTERED.items():
            check(getattr(self, name))
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise UnknownNameError(name.replace("_", " "), str(getattr(self, name)), choices, f"Set {flag(name)}.")
        for name in (field.name for field in fields(self)):
            self._check_number(name, getattr(self, name))
        sizes = self.hidden if isinstance(self.hidden, tuple) else (None,)
        if any(not isinstance(size, int) or isinstance(size, bool) or size < 1 for size in sizes):
            raise _out_of_range("hidden", self.hidden, "positive whole numbers, e.g. --hidden 64 64")
        if self.seed >= 2**63:
            raise _out_of_range("seed", self.seed, "less than 2**63")
        check_population(self.population_size, self.mirrored, 2)

    def _find_description(self) -> None:
        """Take in what describes an external environment, so that nobody has to say it again."""
        if self.external is None:
            object.__setattr__(self, "external", find_description(self.env))
        elif not isinstance(self.external, ExternalDescription):
            raise ConfigError(f"external must be an ExternalDescription, got {self.external!r}.")
        else:
            check_external_name(self.env)

    @staticmethod
    def _check_number(name: str, value: Any) -> None:
        """Refuse a number that is none, or out of its range."""
        if value is None and name in _OPTIONAL:
            return
        is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
        is_whole = is_number and isinstance(value, int | np.integer)
        number: float = float(str(value)) if is_number else float("nan")
        if name in _AT_LEAST and not (is_whole and number >= _AT_LEAST[name]):
            raise _out_of_range(name, value, f"a whole number of at least {_AT_LEAST[name]}")
        if name in _POSITIVE and not 0 < number < float("inf"):
            raise _out_of_range(name, value, "a positive number")
        if name in _NOT_NEGATIVE and not 0 <= number < float("inf"):
            raise _out_of_range(name, value, "zero or a positive number")
        if name in _FRACTIONS and not 0 <= number <= 1:
            raise _out_of_range(name, value, "between 0 and 1")
        if name in _SWITCHES and not isinstance(value, bool):
            raise _out_of_range(name, value, "true or false")
        if name in _PLACES and not _is_place(value):
            raise _out_of_range(name, value, f"coordinates in metres, e.g. {flag(name)} 0 16")

    @property
    def workers(self) -> int:
        """Worker processes asked for: `num_workers`, or one for every core that this process may use."""
        if self.num_workers:
            return self.num_workers
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON holds them."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        values["external"] = None if self.external is None else self.external.to_dict()
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}

    def numbers(self) -> dict[str, Any]:
        """Return the settings that change the numbers of a generation."""
        return {name: value for name, value in self.to_dict().items() if name not in EXECUTION_FIELDS}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> TrainConfig:
        """Return the configuration that `to_dict` wrote.

        Raises:
            ConfigError: A key is unknown or missing, or a value is out of range.
        """
        check_fields(values)
        if "env" not in values:
            raise ConfigError("the configuration names no environment (key 'env').")
        settings: dict[str, Any] = {
            n: tuple(value) if isinstance(value, list) else value for n, value in values.items()
        }
        if settings.get("external") is not None:
            settings["external"] = ExternalDescription.from_dict(settings["external"])
        return cls(**settings)


def flag(name: str) -> str:
    """Return the flag of `train` that sets field `name`."""
    return "--" + {"num_workers": "workers"}.get(name, name).replace("_", "-")


def choices(name: str) -> tuple[str, ...]:
    """Return the names that setting `name` may have; none where it is no name."""
    return tuple(_CHOICES.get(name) or _REGISTRIES.get(name, ()))


def check_fields(names: Mapping[str, Any]) -> None:
    """Refuse names that are no settings.

    Raises:
        ConfigError: A name is unknown; the message names the nearest.
    """
    known = [field.name for field in fields(TrainConfig)]
    for name in names:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f" Did you mean {close[0]!r}?" if close else ""
            raise ConfigError(f"unknown setting {name!r}.{hint} Settings: {', '.join(known)}.")


def _plain(value: Any) -> Any:
    """Return a NumPy number as Python's own, and a list as a tuple: JSON gives back what it was given."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return tuple(_plain(item) for item in value) if isinstance(value, list | tuple) else value


def _is_place(value: Any) -> bool:
    """Tell whether `value` is a tuple of finite numbers."""
    items: tuple[Any, ...] = value if isinstance(value, tuple) else ()
    are_numbers = [isinstance(item, int | float) and not isinstance(item, bool) for item in items]
    return len(items) > 0 and all(are_numbers) and bool(np.isfinite(items).all())


def _out_of_range(name: str, value: Any, allowed: str) -> ConfigError:
    return ConfigError(f"{name} must be {allowed}, got {value!r}. Set {flag(name)}.")
